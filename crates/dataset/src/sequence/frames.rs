//! From the two image files of an entry to a frame.

use crate::decode::{DepthCode, decode_colour, decode_depth};
use crate::orientation::Orientation;
use crate::resample::Resampler;
use crate::video::Video;
use crate::{DatasetError, Entry};
use i2slam_geometry::Image;
use std::path::Path;
use std::sync::Arc;

/// Mean colour value below which a frame counts as black (two steps of 8 bits).
const BLACK: f64 = 2.0 / 255.0;

/// Mean colour value above which a frame counts as white.
const WHITE: f64 = 253.0 / 255.0;

/// One RGB-D frame, ready to use.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Place in the associated stream, before the choice by range and stride.
    pub index: usize,
    /// Time stamp of the colour image [s].
    pub timestamp: f64,
    /// Time stamp of the depth image [s]; the colour's where depth has none of its own.
    pub depth_timestamp: f64,
    /// 3 planes R, G, B in `[0, 1]`, as recorded (display space).
    pub colour: Arc<Image<f32>>,
    /// 1 plane, depth along the optical axis [m], 0 where invalid.
    pub depth: Arc<Image<f32>>,
    /// What is odd about the frame: no valid depth, a black or a white picture.
    pub warnings: Vec<String>,
}

impl Frame {
    /// A frame without depth, whose image is empty.
    pub fn colour_only(index: usize, timestamp: f64, colour: impl Into<Arc<Image<f32>>>) -> Self {
        Self {
            index,
            timestamp,
            depth_timestamp: timestamp,
            colour: colour.into(),
            depth: Arc::default(),
            warnings: Vec::new(),
        }
    }
}

/// Everything that turns files into frames, fixed when the sequence is opened.
#[derive(Clone, Debug)]
pub(crate) struct Preparation {
    pub(crate) resampler: Resampler,
    /// Depth image value of one metre.
    pub(crate) depth_scale: f64,
    /// Depth beyond this is invalid [m]; infinite for none.
    pub(crate) max_depth: f64,
    /// How depth values are written.
    pub(crate) depth_code: DepthCode,
    /// A depth image value beside 0 that means "no reading".
    pub(crate) invalid_depth: Option<u16>,
    /// Depth is not read.
    pub(crate) colour_only: bool,
    /// How pictures are shown.
    pub(crate) orientation: Orientation,
    /// What decodes the pictures, if they are those of a video.
    pub(crate) video: Option<Arc<Video>>,
}

impl Preparation {
    /// Reads both images of an entry.
    pub(crate) fn load(&self, entry: &Entry) -> Result<Frame, DatasetError> {
        let colour = match self.video.as_deref().filter(|video| video.is(&entry.colour)) {
            Some(video) => video.picture(entry.place)?,
            None => self.orientation.shown(decode_colour(&entry.colour, entry.colour_part())?),
        };
        let (colour_size, _) = self.resampler.recorded_sizes();
        check_size(&entry.colour, (colour.width, colour.height), colour_size, "colour")?;
        let colour = self.resampler.colour(&colour);
        let mut warnings = Vec::new();
        let depth = match entry.depth.as_deref().filter(|_| !self.colour_only) {
            Some(path) => {
                let depth = self.depth(path, entry)?;
                warnings.extend(depth_warning(&depth));
                depth
            }
            None => Image::new(self.resampler.camera.width, self.resampler.camera.height, 1),
        };
        warnings.extend(colour_warning(&colour));
        Ok(Frame {
            index: entry.index,
            timestamp: entry.timestamp,
            depth_timestamp: entry.depth_timestamp,
            colour: Arc::new(colour),
            depth: Arc::new(depth),
            warnings,
        })
    }

    /// The delivered depth [m] of an entry.
    fn depth(&self, path: &Path, entry: &Entry) -> Result<Image<f32>, DatasetError> {
        let mut depth = decode_depth(path, entry.depth_part(), self.depth_code)?;
        let (colour_size, depth_size) = self.resampler.recorded_sizes();
        let like = if depth_size == colour_size { "colour" } else { "depth" };
        check_size(path, (depth.width, depth.height), depth_size, like)?;
        if let Some(invalid) = self.invalid_depth {
            depth.data.iter_mut().filter(|value| **value == invalid).for_each(|value| *value = 0);
        }
        Ok(self.resampler.depth(&depth, self.depth_scale, self.max_depth))
    }
}

/// Refuses an image of another size than the first one of its kind.
fn check_size(
    path: &Path,
    found: (usize, usize),
    expected: (usize, usize),
    kind: &str,
) -> Result<(), DatasetError> {
    if found == expected {
        return Ok(());
    }
    let reference = format!("the first {kind} image");
    Err(DatasetError::Size { path: path.to_path_buf(), found, expected, reference })
}

fn depth_warning(depth: &Image<f32>) -> Option<String> {
    depth.data.iter().all(|&z| z == 0.0).then(|| "no pixel has a valid depth".to_owned())
}

fn colour_warning(colour: &Image<f32>) -> Option<String> {
    let sum: f64 = colour.data.iter().map(|&v| f64::from(v)).sum();
    let mean = sum / colour.data.len() as f64;
    if mean < BLACK {
        Some("the colour image is black".to_owned())
    } else if mean > WHITE {
        Some("the colour image is white".to_owned())
    } else {
        None
    }
}

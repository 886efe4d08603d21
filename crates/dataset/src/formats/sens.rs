//! ScanNet's `.sens`: calibration, poses and compressed images of a whole sequence in one file.
//!
//! Little-endian, version 4: a header, then for every frame the pose `world_from_camera` (16
//! `f32` in rows), two time stamps [µs], two sizes [bytes], and the two images.

mod read;

use super::poses::{rigid, stamped};
use super::scannet::{border_warning, from_matrices, of_matrix};
use super::{Layout, Listing};
use crate::calibration::{Calibration, DepthGrid, Traits};
use crate::decode::DepthCode;
use crate::{DatasetError, Entry, OpenOptions, Parts};
use i2slam_geometry::Pose;
use read::{Frame, Header, Reader};
use std::path::{Path, PathBuf};

/// Gaps between time stamps that a video can have [s].
const SENSIBLE_GAP: std::ops::RangeInclusive<f64> = 1e-3..=1.0;

/// The table of contents of a `.sens` file.
pub(crate) struct Stream {
    path: PathBuf,
    header: Header,
    frames: Vec<Frame>,
    /// What is odd about the file.
    warnings: Vec<String>,
}

/// The only `.sens` file in a folder.
pub(super) fn find(folder: &Path) -> Option<PathBuf> {
    let files = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files = files.map(|entry| entry.path()).filter(|path| is_sens(path));
    let first = files.next()?;
    files.next().is_none().then_some(first)
}

fn is_sens(path: &Path) -> bool {
    path.extension().is_some_and(|e| e.eq_ignore_ascii_case("sens")) && path.is_file()
}

impl Stream {
    /// Reads the header and where every frame lies.
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        if !is_sens(path) {
            let found = "a file that is no .sens and no video".into();
            let path = path.to_path_buf();
            return Err(DatasetError::UnknownLayout { path, found, has_colour: false });
        }
        let mut reader = Reader::open(path)?;
        let header = reader.header()?;
        let (mut frames, mut warnings) = (Vec::new(), Vec::new());
        for number in 0..header.frames {
            match reader.frame()? {
                Some(frame) => frames.push(frame),
                None => {
                    let all = header.frames;
                    warnings.push(format!("the file ends within frame {number} of {all}"));
                    break;
                }
            }
        }
        if frames.is_empty() {
            let expected = "at least one whole frame";
            return Err(DatasetError::Empty { path: path.to_path_buf(), expected });
        }
        Ok(Self { path: path.to_path_buf(), header, frames, warnings })
    }

    pub(super) fn traits(&self) -> Traits {
        Traits {
            depth_scale: self.header.depth_scale,
            frame_rate: Some(30.0),
            grid: DepthGrid::Depth(None),
            invalid_depth: None,
        }
    }

    pub(super) fn calibration(&self) -> Result<Calibration, DatasetError> {
        let colour = of_matrix(&self.header.intrinsic_colour);
        let colour = colour.ok_or_else(|| DatasetError::Metadata {
            path: self.path.clone(),
            reason: "the intrinsics of the colour camera are no numbers above 0".into(),
        })?;
        let depth = of_matrix(&self.header.intrinsic_depth);
        let source = self.path.display().to_string();
        let found = from_matrices(colour, depth, &source, self.traits());
        Ok(Calibration { size: Some(self.header.colour_size), ..found })
    }

    /// The frames, none thinned: published numbers count frames.
    pub(super) fn list(
        &self,
        options: &OpenOptions,
        frame_rate: f64,
    ) -> Result<Listing, DatasetError> {
        let times = self.times();
        let time = |i: usize| times.as_ref().map_or(i as f64 / frame_rate, |t| t[i].0);
        let depth_time = |i: usize| times.as_ref().map_or(i as f64 / frame_rate, |t| t[i].1);
        let entry = |(index, frame): (usize, &Frame)| Entry {
            index,
            place: index,
            timestamp: time(index),
            depth_timestamp: depth_time(index),
            colour: self.path.clone(),
            depth: Some(self.path.clone()),
            parts: Some(Parts { colour: frame.colour.clone(), depth: frame.depth.clone() }),
        };
        let entries: Vec<Entry> = self.frames.iter().enumerate().map(entry).collect();
        let poses = self.frames.iter().enumerate().map(|(i, frame)| (time(i), pose(frame)));
        let (poses, warning) = stamped(poses);
        let mut listing = Listing { poses, ..Listing::new(Layout::Sens, entries) };
        listing.depth_code = self.depth_code();
        listing.warnings = self.warnings.clone();
        if times.is_none() {
            let rate = format!("no usable time stamps: {frame_rate} frames a second assumed");
            listing.warnings.push(rate);
        }
        listing.warnings.extend(warning);
        listing.warnings.extend(border_warning(options));
        Ok(listing)
    }

    fn depth_code(&self) -> DepthCode {
        let (width, height) = self.header.depth_size;
        if self.header.depth_is_compressed {
            DepthCode::Zlib { width, height }
        } else {
            DepthCode::Raw { width, height }
        }
    }

    /// Times of colour and depth [s] after the first colour image, if they can be those of a
    /// video: rising, and not as far apart as another unit would make them.
    fn times(&self) -> Option<Vec<(f64, f64)>> {
        let first = self.frames.first()?.stamps.0 as f64;
        let seconds = |stamp: u64| (stamp as f64 - first) * 1e-6;
        let times: Vec<(f64, f64)> =
            self.frames.iter().map(|f| (seconds(f.stamps.0), seconds(f.stamps.1))).collect();
        let mut gaps: Vec<f64> = times.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
        gaps.sort_by(f64::total_cmp);
        let rising = *gaps.first()? > 0.0;
        let together = times.iter().all(|(colour, depth)| (colour - depth).abs() <= 1.0);
        let sensible = rising && SENSIBLE_GAP.contains(gaps.get(gaps.len() / 2)?);
        sensible.then(|| match together {
            true => times,
            false => times.into_iter().map(|(colour, _)| (colour, colour)).collect(),
        })
    }
}

fn pose(frame: &Frame) -> Option<Pose<f64>> {
    rigid(&frame.world_from_camera)
}

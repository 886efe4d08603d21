//! `input.json`: the sequence of a run, and how it was read.

use crate::storage::read_text;
use crate::{ResultError, ResultFolder, Storage};
use i2slam::dataset::{EstimatedCamera, OpenOptions, is_stream};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The sequence of a run, and the options by which it was read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunInput {
    /// Absolute path of the dataset, or the address of a stream.
    pub dataset: PathBuf,
    /// Absolute path of the given camera file.
    pub camera: Option<PathBuf>,
    /// Given `[fx, fy, cx, cy]` [px]; they go before camera files.
    pub intrinsics: Option<[f64; 4]>,
    /// Given horizontal field of view [degrees].
    #[serde(default)]
    pub field_of_view: Option<f64>,
    /// Intrinsics and distortion estimated from the pictures.
    #[serde(default)]
    pub estimated_camera: Option<EstimatedCamera>,
    /// Whether unknown intrinsics were guessed.
    #[serde(default)]
    pub guess_camera: bool,
    /// Given depth image value of one metre.
    pub depth_scale: Option<f64>,
    /// First frame and the one after the last, by position in the associated stream.
    pub frames: Option<[usize; 2]>,
    /// Every N-th frame was read.
    pub stride: usize,
    /// Size of the processed pictures over that of the recorded ones.
    pub scale: f64,
    /// Limit of the longer side of processed pictures [px].
    #[serde(default)]
    pub max_side: Option<usize>,
    /// Border removed before scaling [px].
    pub crop_border: usize,
    /// Larger depth is invalid [m].
    pub max_depth: Option<f64>,
    /// Largest time difference between colour and depth of a frame [s].
    pub association_tolerance: f64,
    /// Smallest time difference between frames; others were left out [s].
    pub minimum_gap: f64,
    /// Whether depth was ignored.
    #[serde(default)]
    pub colour_only: bool,
    /// Whether pictures were turned by their EXIF orientation.
    #[serde(default)]
    pub turn_pictures: bool,
}

impl RunInput {
    /// The description of `dataset` read with these options.
    pub fn new(dataset: &Path, options: &OpenOptions) -> Self {
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        Self {
            // The address of a stream is no path.
            dataset: if is_stream(dataset) { dataset.to_owned() } else { absolute(dataset) },
            camera: options.camera.as_deref().map(absolute),
            intrinsics: options.intrinsics,
            field_of_view: options.field_of_view,
            estimated_camera: options.estimated_camera,
            guess_camera: options.guess_camera,
            depth_scale: options.depth_scale,
            frames: options.frames.as_ref().map(|range| [range.start, range.end]),
            stride: options.stride,
            scale: options.scale,
            max_side: options.max_side,
            crop_border: options.crop_border,
            max_depth: options.max_depth,
            association_tolerance: options.association_tolerance,
            minimum_gap: options.minimum_gap,
            colour_only: options.colour_only,
            turn_pictures: options.turn_pictures,
        }
    }

    /// The options that read the same frames again.
    pub fn options(&self) -> OpenOptions {
        OpenOptions {
            camera: self.camera.clone(),
            intrinsics: self.intrinsics,
            field_of_view: self.field_of_view,
            estimated_camera: self.estimated_camera,
            guess_camera: self.guess_camera,
            depth_scale: self.depth_scale,
            frames: self.frames.map(|[start, end]| start..end),
            stride: self.stride,
            scale: self.scale,
            max_side: self.max_side,
            crop_border: self.crop_border,
            max_depth: self.max_depth,
            association_tolerance: self.association_tolerance,
            minimum_gap: self.minimum_gap,
            colour_only: self.colour_only,
            turn_pictures: self.turn_pictures,
        }
    }

    /// Reads `input.json` of a result folder; `None` if there is no such file.
    pub fn load(folder: &Path) -> Result<Option<Self>, ResultError> {
        let path = folder.join("input.json");
        if !path.is_file() {
            return Ok(None);
        }
        let input = serde_json::from_str(&read_text(&path)?);
        input.map(Some).map_err(|e| ResultError::Format { path, message: e.to_string() })
    }

    /// Writes `input.json`.
    pub fn save<S: Storage>(&self, folder: &ResultFolder<S>) -> Result<(), ResultError> {
        folder.write("input.json", |out| {
            serde_json::to_writer_pretty(&mut *out, self)?;
            writeln!(out)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn options_survive_a_round_trip() {
        let scratch = TemporaryFolder::new("input");
        let options = OpenOptions {
            intrinsics: Some([500.0, 501.0, 320.25, 240.0]),
            frames: Some(10..90),
            stride: 2,
            scale: 0.5,
            max_side: Some(640),
            estimated_camera: Some(EstimatedCamera {
                intrinsics: [410.25, 410.5, 319.5, 239.5],
                distortion: [-0.2, 0.03],
            }),
            guess_camera: true,
            colour_only: true,
            turn_pictures: true,
            ..OpenOptions::default()
        };
        assert_eq!(RunInput::load(&scratch.0).expect("nothing"), None);
        let folder = ResultFolder::create(&scratch.0).expect("a folder");
        let input = RunInput::new("data/room".as_ref(), &options);
        assert!(input.dataset.is_absolute());
        input.save(&folder).expect("room");
        let back = RunInput::load(&scratch.0).expect("a file").expect("an input");
        assert_eq!((&back, back.options()), (&input, options));
        folder.write_text("input.json", "{}").expect("room");
        let message = RunInput::load(&scratch.0).expect_err("no input").to_string();
        assert!(message.contains("input.json") && message.contains("dataset"), "{message}");
    }
}

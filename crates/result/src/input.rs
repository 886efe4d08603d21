//! `input.json`: the sequence of a run, and how it was read.

use crate::ResultError;
use crate::error::read_text;
use i2slam::dataset::{OpenOptions, is_stream, path_text};
use i2slam_storage::OutputFolder;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The sequence of a run, and the options by which it was read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunInput {
    /// Absolute path of the dataset, or the address of a stream.
    #[serde(with = "path_text")]
    pub dataset: PathBuf,
    /// The options; paths are absolute.
    #[serde(flatten)]
    pub options: OpenOptions,
}

impl RunInput {
    /// The description of `dataset` read with these options.
    pub fn new(dataset: &Path, options: &OpenOptions) -> Self {
        let absolute = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let camera = options.camera.as_deref().map(absolute);
        Self {
            // The address of a stream is no path.
            dataset: if is_stream(dataset) { dataset.to_owned() } else { absolute(dataset) },
            options: OpenOptions { camera, ..options.clone() },
        }
    }

    /// Reads `input.json` of a result folder; `None` if there is no such file.
    pub fn load(folder: &Path) -> Result<Option<Self>, ResultError> {
        let path = folder.join("input.json");
        if !path.is_file() {
            return Ok(None);
        }
        let input = serde_json::from_str(&read_text(&path)?);
        input.map(Some).map_err(|e| ResultError::format(&path, e.to_string()))
    }

    /// Writes `input.json`.
    pub fn save(&self, folder: &OutputFolder) -> Result<(), ResultError> {
        Ok(folder.write("input.json", |out| {
            serde_json::to_writer_pretty(&mut *out, self)?;
            writeln!(out)
        })?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam::dataset::EstimatedCamera;
    use i2slam_check::TemporaryFolder;
    use std::fs;

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
        let mut folder = OutputFolder::extend(&scratch.0, "i2slam run", &[]).expect("a folder");
        let write = |text: &str| fs::write(scratch.join("input.json"), text).expect("room");
        let input = RunInput::new("data/room".as_ref(), &options);
        assert!(input.dataset.is_absolute());
        input.save(&folder).expect("room");
        folder.commit().expect("room");
        let back = RunInput::load(&scratch.0).expect("a file").expect("an input");
        assert_eq!((&back, &back.options), (&input, &options));
        // Missing keys take their defaults.
        let earlier = r#"{"dataset": "/room", "frames": [3, 9], "stride": 2, "scale": 0.5}"#;
        write(earlier);
        let back = RunInput::load(&scratch.0).expect("a file").expect("an input");
        assert_eq!((back.options.frames, back.options.max_side), (Some(3..9), None));
        write("{}");
        let message = RunInput::load(&scratch.0).expect_err("no input").to_string();
        assert!(message.contains("input.json") && message.contains("dataset"), "{message}");
    }
}

//! Keyframes from files of other programs.

use super::{EstimatedDepth, KeyframeSource, PictureError, PosedKeyframe};
use i2slam_dataset::DatasetError;
use i2slam_dataset::import::ImportedKeyframes;
use i2slam_geometry::Camera;
use std::path::Path;

pub use i2slam_dataset::import::{ImportDepth, ImportFormat, ImportOptions};

/// Source of the keyframes in files of another program.
#[derive(Clone, Debug)]
pub struct Import {
    files: ImportedKeyframes,
    next: usize,
}

/// Opens keyframes of any [kind](ImportFormat), recognised by its files, with the `pictures` of a
/// sequence; `None`: those next to the poses, or in the same file.
///
/// # Errors
///
/// Files that cannot be read or hold fewer than two keyframes, and pictures that cannot be opened.
pub fn import(
    path: &Path,
    pictures: Option<&Path>,
    options: &ImportOptions,
) -> Result<Import, DatasetError> {
    Ok(Import { files: ImportedKeyframes::open(path, pictures, options)?, next: 0 })
}

impl Import {
    /// The opened files: kind, camera, poses, omissions, warnings.
    pub fn files(&self) -> &ImportedKeyframes {
        &self.files
    }
}

impl KeyframeSource for Import {
    fn camera(&self) -> &Camera<f64> {
        &self.files.camera
    }

    fn next_keyframe(&mut self) -> Option<Result<PosedKeyframe, PictureError>> {
        let place = self.next;
        if place >= self.files.len() {
            return None;
        }
        self.next += 1;
        let keyframe = match self.files.load(place) {
            Ok(keyframe) => keyframe,
            Err(error) => return Some(Err(error.into())),
        };
        let variance = keyframe.variance;
        Some(Ok(PosedKeyframe {
            index: keyframe.index,
            timestamp: keyframe.timestamp,
            colour: keyframe.colour,
            world_from_camera: keyframe.world_from_camera,
            before: None,
            after: None,
            exposure_motion: None,
            depth: keyframe.depth.map(|depth| EstimatedDepth { depth, variance }),
            is_keyframe: true,
            fills_depth: true,
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;
    use std::fs;

    fn picture(path: &Path) {
        let file = fs::File::create(path).expect("a file");
        let mut encoder = png::Encoder::new(file, 16, 12);
        encoder.set_color(png::ColorType::Rgb);
        let mut writer = encoder.write_header().expect("a header");
        writer.write_image_data(&[90; 3 * 16 * 12]).expect("data");
    }

    /// Three pictures, of which the second is damaged, and their poses.
    fn folder() -> TemporaryFolder {
        let scratch = TemporaryFolder::new("import");
        fs::create_dir_all(scratch.0.join("rgb")).expect("a folder");
        let (mut list, mut poses) = (String::new(), String::new());
        for i in 0..3 {
            list += &format!("{i}.0 rgb/{i}.png\n");
            poses += &format!("{i}.0 0.{i} 0 0 0 0 0 1\n");
            picture(&scratch.0.join(format!("rgb/{i}.png")));
        }
        fs::write(scratch.0.join("rgb/1.png"), "no picture").expect("room");
        fs::write(scratch.0.join("rgb.txt"), list).expect("room");
        fs::write(scratch.0.join("poses.txt"), poses).expect("room");
        let camera = r#"{"fx":14,"fy":14,"cx":8,"cy":6}"#;
        fs::write(scratch.0.join("camera.json"), camera).expect("room");
        scratch
    }

    #[test]
    fn keyframes_come_in_order_and_one_that_cannot_be_read_stops_none() {
        let scratch = folder();
        let options = ImportOptions::default();
        let mut source = import(&scratch.0.join("poses.txt"), Some(&scratch.0), &options);
        let source = source.as_mut().expect("opens");
        assert_eq!((source.files().len(), source.camera().width), (3, 16));
        let first = source.next_keyframe().expect("one").expect("reads");
        assert_eq!((first.index, first.timestamp, first.depth.is_none()), (0, 0.0, true));
        let second = source.next_keyframe().expect("one").expect_err("damaged");
        assert!(second.to_string().contains("1.png"), "{second}");
        let third = source.next_keyframe().expect("one").expect("reads");
        assert_eq!(third.world_from_camera.translation.x, 0.2);
        assert!(source.next_keyframe().is_none());
    }
}

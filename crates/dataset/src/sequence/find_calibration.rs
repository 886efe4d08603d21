//! Search for the calibration of a sequence, from flags to assumptions.

use crate::camera::{Calibration, Distortion, FieldOfView, FormatDefaults};
use crate::formats::{DetectedLayout, published_calibration, read_camera};
use crate::text::is_present;
use crate::{DatasetError, OpenOptions};
use i2slam_storage::Manifest;
use std::path::Path;

/// Finds the calibration, in this order: flags, the camera file of the options, the folder's
/// `camera.json`, the layout's own files, the folder's name. An estimated camera replaces any.
pub(super) fn find_calibration(
    folder: &Path,
    layout: &DetectedLayout,
    options: &OpenOptions,
) -> Result<Calibration, DatasetError> {
    let beside = folder.join("camera.json");
    let defaults = layout.defaults().with_depth_on_colour_camera();
    let mut found = if let Some(k) = options.intrinsics {
        let (lens, source) = (Distortion::default(), "the given intrinsics");
        Calibration::from_opencv(k, lens, source, defaults)
    } else if let Some(path) = &options.camera {
        read_camera(path, defaults)?
    } else if let Some(degrees) = options.field_of_view {
        let source = format!("the given field of view of {degrees} degrees");
        Calibration::from_view(FieldOfView::Width(degrees), source, defaults)
    } else if layout.is_video() {
        // A camera.json in the folder of a video need not belong to it.
        assumed_calibration(folder, options, defaults)?
    } else if is_present(&beside) && !is_result(folder) {
        read_camera(&beside, defaults)?
    } else {
        match layout.calibration()?.or_else(|| published_calibration(folder)) {
            Some(found) => found,
            None => assumed_calibration(folder, options, defaults)?,
        }
    };
    if found.is_guess && !options.guess_camera {
        let file = options.camera.as_deref().unwrap_or(&beside);
        let reason = "has no fx, fy, cx, cy, the camera's focal lengths and centre in pixels";
        return Err(DatasetError::file(file, reason));
    }
    if let Some(scale) = options.depth_scale {
        found.format.depth_scale = scale;
    }
    if let Some(camera) = &options.estimated_camera {
        found = found.replaced_by(camera);
    }
    Ok(found)
}

/// Whether a result was written into the folder: its `camera.json` is that of its map.
fn is_result(folder: &Path) -> bool {
    Manifest::of(folder).is_some_and(|manifest| manifest.command == "i2slam run")
}

/// A usual field of view, if the options allow a guess.
fn assumed_calibration(
    folder: &Path,
    options: &OpenOptions,
    defaults: FormatDefaults,
) -> Result<Calibration, DatasetError> {
    if !options.guess_camera {
        let causes = DetectedLayout::unused_files(folder);
        return Err(DatasetError::NoCamera { folder: folder.to_path_buf(), causes });
    }
    Ok(Calibration::assumed(defaults))
}

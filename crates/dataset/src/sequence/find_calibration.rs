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
    path: &Path,
    layout: &DetectedLayout,
    options: &OpenOptions,
) -> Result<Calibration, DatasetError> {
    let folder = if path.is_dir() { path } else { path.parent().unwrap_or(path) };
    let beside = folder.join("camera.json");
    let usual = layout.defaults().with_depth_on_colour_camera();
    // A camera.json in the folder of a file need not belong to it.
    let given = !layout.is_file(path) && is_present(&beside) && !is_of_result(folder);
    let given = given.then(|| read_camera(&beside, usual));
    // It gives frame rate and scale of depth, whatever gives the camera.
    let defaults = match &given {
        Some(Ok(found)) => found.format,
        _ => usual,
    };
    let mut found = if let Some(k) = options.intrinsics {
        let (lens, source) = (Distortion::default(), "the given intrinsics");
        Calibration::from_opencv(k, lens, source, defaults)
    } else if let Some(path) = &options.camera {
        read_camera(path, defaults)?
    } else if let Some(degrees) = options.field_of_view {
        let source = format!("the given field of view of {degrees} degrees");
        Calibration::from_view(FieldOfView::Width(degrees), source, defaults)
    } else if layout.is_video() {
        assumed_calibration((path, layout), options, defaults)?
    } else {
        match given.transpose()? {
            Some(found) if !found.is_guess => found,
            // It gives a frame rate or the scale of depth alone.
            Some(rates) => match known_calibration(folder, layout)? {
                Some(found) => with_rates(found, rates.format, usual),
                None => rates,
            },
            None => match known_calibration(folder, layout)? {
                Some(found) => found,
                None => assumed_calibration((folder, layout), options, defaults)?,
            },
        }
    };
    if found.is_guess && !options.guess_camera {
        let file = options.camera.as_deref().unwrap_or(&beside);
        let reason = "has no fx, fy, cx, cy, the camera's focal lengths and centre in pixels";
        return Err(DatasetError::file(file, reason));
    }
    found.format = match layout.is_in_metres() {
        true if options.depth_scale.is_some() => {
            let reason = "the recording has depth in metres, which no scale belongs to";
            return Err(DatasetError::option("depth_scale", reason));
        }
        true => found.format.with_given_scale(Some(usual.depth_scale)),
        false => found.format.with_given_scale(options.depth_scale),
    };
    if let Some(camera) = &options.estimated_camera {
        found = found.replaced_by(camera);
    }
    Ok(found)
}

/// That of the layout's own files, else of the folder's name.
fn known_calibration(
    folder: &Path,
    layout: &DetectedLayout,
) -> Result<Option<Calibration>, DatasetError> {
    Ok(layout.calibration()?.or_else(|| published_calibration(folder)))
}

/// With the frame rate and the scale of depth that a file gives, where they are not the `usual` ones.
fn with_rates(mut found: Calibration, given: FormatDefaults, usual: FormatDefaults) -> Calibration {
    found.format.frame_rate = given.frame_rate.or(found.format.frame_rate);
    if given.depth_scale != usual.depth_scale {
        found.format.depth_scale = given.depth_scale;
    }
    found.format.is_scale_assumed &= given.is_scale_assumed;
    found
}

/// True if `camera.json` is part of a result that was written into the folder, and that of its map.
fn is_of_result(folder: &Path) -> bool {
    let manifest = Manifest::of(folder).filter(|manifest| manifest.command == "i2slam run");
    manifest.is_some_and(|manifest| manifest.files.contains_key("camera.json"))
}

/// A usual field of view, if the options allow a guess.
fn assumed_calibration(
    (path, layout): (&Path, &DetectedLayout),
    options: &OpenOptions,
    defaults: FormatDefaults,
) -> Result<Calibration, DatasetError> {
    if !options.guess_camera {
        let (is_video, causes) = (layout.is_video(), DetectedLayout::unused_files(path));
        return Err(DatasetError::NoCamera { path: path.to_path_buf(), is_video, causes });
    }
    Ok(Calibration::assumed(defaults))
}

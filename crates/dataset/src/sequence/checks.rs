//! What can be said of a sequence before it runs.

use crate::calibration::{Calibration, DepthGrid};
use crate::decode::{DepthCode, decode_depth, depth_size, image_size};
use crate::orientation::Orientation;
use crate::prepare::Preparation;
use crate::resample::{Recorded, Resampler};
use crate::video::Video;
use crate::{DatasetError, Entry};
use i2slam_geometry::Camera;

/// Depth images looked at to judge the depth scale.
const DEPTH_PROBES: usize = 3;

/// Colour images tried for the size of the frames.
const SIZE_PROBES: usize = 16;

/// Sides of pictures of one shape may differ in their ratio by this share.
const SAME_SHAPE: f64 = 0.01;

/// Median depths that a sensible depth scale gives [m].
const SENSIBLE_DEPTH: std::ops::RangeInclusive<f64> = 0.05..=20.0;

/// The cameras that recorded colour and depth, and the grid that frames are delivered on.
pub(crate) fn recorded(
    entries: &[Entry],
    calibration: &Calibration,
    code: DepthCode,
    (orientation, video): (Orientation, Option<&Video>),
) -> Result<Recorded, DatasetError> {
    let colour = match video {
        Some(video) => of_video(entries, calibration, video)?,
        None => calibration.camera(recorded_size(entries, calibration, orientation)?),
    };
    let (width, height) = (colour.width, colour.height);
    let sized = || {
        let sizes = entries.iter().take(SIZE_PROBES);
        let mut size = sizes
            .filter_map(|entry| depth_size(entry.depth.as_deref()?, entry.depth_part(), code).ok());
        size.next().unwrap_or((width, height))
    };
    Ok(match calibration.grid {
        DepthGrid::Colour => Recorded { colour, depth: colour, grid: colour },
        DepthGrid::Spread => {
            let (width, height) = sized();
            Recorded { colour, depth: colour.resized(width, height), grid: colour }
        }
        DepthGrid::Depth(own) => {
            let (width, height) = sized();
            let depth = match own {
                Some([fx, fy, cx, cy]) => Camera { width, height, fx, fy, cx, cy },
                None => colour.resized(width, height),
            };
            // Colour exported in the size of depth, with the intrinsics of its first size.
            let same_size = (colour.width, colour.height) == (depth.width, depth.height);
            let reduced = same_size && !is_central(&colour) && is_central(&depth);
            Recorded { colour: if reduced { depth } else { colour }, depth, grid: depth }
        }
    })
}

/// Whether the principal point lies in the middle half of the picture.
pub(crate) fn is_central(camera: &Camera<f64>) -> bool {
    let middle = |at: f64, size: usize| (0.25..=0.75).contains(&(at / size as f64));
    middle(camera.cx, camera.width) && middle(camera.cy, camera.height)
}

/// A warning if the intrinsics seem to be those of pictures of another size.
pub(crate) fn camera_warning(recorded: &Recorded, source: &str) -> Option<String> {
    let odd = [&recorded.colour, &recorded.depth].into_iter().find(|camera| !is_central(camera))?;
    Some(format!(
        "intrinsics of another size? The principal point of {source} lies at {:.1}, {:.1} in \
         pictures of {}x{}",
        odd.cx, odd.cy, odd.width, odd.height
    ))
}

/// The camera of a video. One that was calibrated at another size of the same shape is resized.
fn of_video(
    entries: &[Entry],
    calibration: &Calibration,
    video: &Video,
) -> Result<Camera<f64>, DatasetError> {
    let (width, height) = video.size;
    let Some(size) = calibration.size else { return Ok(calibration.camera(video.size)) };
    let across = width as f64 / size.0 as f64;
    if (across * size.1 as f64 / height as f64 - 1.0).abs() > SAME_SHAPE {
        let path = entries.first().map(|entry| entry.colour.clone()).unwrap_or_default();
        let reference = format!("{} says (or any size of that shape)", calibration.source);
        return Err(DatasetError::Size { path, found: video.size, expected: size, reference });
    }
    Ok(calibration.camera(size).resized(width, height))
}

/// Width and height [px] of the first readable colour image as it is shown, agreeing with the
/// camera's.
fn recorded_size(
    entries: &[Entry],
    calibration: &Calibration,
    orientation: Orientation,
) -> Result<(usize, usize), DatasetError> {
    let mut first_error = None;
    for entry in entries.iter().take(SIZE_PROBES) {
        let found = match image_size(&entry.colour, entry.colour_part()) {
            Ok(size) => orientation.size(size),
            Err(error) => {
                first_error.get_or_insert(error);
                continue;
            }
        };
        let expected = calibration.size.unwrap_or(found);
        if found != expected || found.0 < 2 || found.1 < 2 {
            let reference = match calibration.size {
                Some(_) => format!("{} says", calibration.source),
                None => "the smallest picture".into(),
            };
            let expected = calibration.size.unwrap_or((2, 2));
            let path = entry.colour.clone();
            return Err(DatasetError::Size { path, found, expected, reference });
        }
        return Ok(found);
    }
    Err(first_error.unwrap_or(DatasetError::NoSuchFrame { position: 0, frames: 0 }))
}

/// A warning if the median depth over the first frames cannot be right.
pub(crate) fn depth_scale_warning(entries: &[Entry], how: &Preparation) -> Option<String> {
    let (depth_scale, code, invalid) = (how.depth_scale, how.depth_code, how.invalid_depth);
    let mut values: Vec<u16> = Vec::new();
    for entry in entries.iter().take(DEPTH_PROBES).filter(|_| !how.colour_only) {
        let Some(path) = entry.depth.as_deref() else { continue };
        let Ok(depth) = decode_depth(path, entry.depth_part(), code) else { continue };
        let valid = |v: &&u16| **v > 0 && Some(**v) != invalid;
        values.extend(depth.data.iter().step_by(7).filter(valid));
    }
    let middle = values.len() / 2;
    values.sort_unstable();
    let median = *values.get(middle)?;
    let metres = f64::from(median) / depth_scale;
    (!SENSIBLE_DEPTH.contains(&metres)).then(|| {
        format!(
            "wrong depth scale? The median depth over the first frames is {metres:.4} m (depth \
             image value {median} at {depth_scale} for one metre); usual are 5000 (TUM) and 1000 \
             (millimetres)"
        )
    })
}

/// A warning if removing the lens distortion leaves pixels that were never recorded.
pub(crate) fn cover_warning(resampler: &Resampler) -> Option<String> {
    let covered = resampler.covered.as_ref()?;
    let missing = covered.data.iter().filter(|&&c| !c).count();
    let percent = 100.0 * missing as f64 / covered.data.len() as f64;
    Some(format!(
        "removing the lens distortion leaves {percent:.1} % of every frame unrecorded at its \
         edges (depth 0, colour repeated); crop_border {} removes it",
        resampler.full_cover_border
    ))
}

//! Checks when a sequence is opened: image sizes, intrinsics, depth scale, coverage.

use super::frames::FrameLoader;
use crate::DatasetError;
use crate::camera::{
    Calibration, DepthGrid, FormatDefaults, Orientation, has_central_principal_point,
};
use crate::formats::FrameEntry;
use crate::image::{self, DepthEncoding, RecordingCameras, Resampler};
use crate::video::Video;
use i2slam_compute::median;
use i2slam_geometry::Camera;
use std::path::{Path, PathBuf};

/// Depth images read to check the depth scale.
const DEPTH_PROBES: usize = 3;

/// Colour images tried for the size of the frames, in case the first are damaged.
const SIZE_PROBES: usize = 16;

/// Relative difference up to which aspect ratios count as equal.
const ASPECT_TOLERANCE: f64 = 0.01;

/// Plausible median depth [m].
const PLAUSIBLE_DEPTH: std::ops::RangeInclusive<f64> = 0.05..=20.0;

/// Plausible horizontal field of view of a camera without lens distortion [degrees]: from long
/// telephoto lenses to the widest that are rectilinear.
const PLAUSIBLE_VIEW: std::ops::RangeInclusive<f64> = 1.0..=165.0;

/// Determines the cameras of colour and depth and the grid that frames are delivered on.
pub(super) fn recording_cameras(
    entries: &[FrameEntry],
    calibration: &Calibration,
    code: DepthEncoding,
    (orientation, video): (Orientation, Option<&Video>),
) -> Result<RecordingCameras, DatasetError> {
    let colour = match video {
        Some(video) => video_camera(entries, calibration, video)?,
        None => calibration.camera(recorded_size(entries, calibration, orientation)?),
    };
    let (width, height) = (colour.width, colour.height);
    let depth_size = || {
        if let Some(size) = video.and_then(Video::depth_size) {
            return size;
        }
        let probes = entries.iter().filter_map(|entry| Some((entry, entry.depth_path()?)));
        let sizes = probes
            .take(SIZE_PROBES)
            .filter_map(|(entry, path)| image::depth_size(path, entry.depth_part(), code).ok());
        most_common(&sizes.collect::<Vec<_>>()).unwrap_or((width, height))
    };
    Ok(match calibration.format.grid {
        DepthGrid::Registered if video.is_some_and(|video| !video.has_registered_size()) => {
            return Err(unregistered(entries, (width, height), depth_size()));
        }
        DepthGrid::Registered => RecordingCameras { colour, depth: colour, grid: colour },
        DepthGrid::ResizedToColour => {
            let (width, height) = depth_size();
            RecordingCameras { colour, depth: colour.resized(width, height), grid: colour }
        }
        DepthGrid::OwnCamera(own) => {
            let (width, height) = depth_size();
            let depth = match own {
                Some([fx, fy, cx, cy]) => Camera { width, height, fx, fy, cx, cy },
                None => colour.resized(width, height),
            };
            // Colour was exported at the size of depth, but with intrinsics of its original size.
            let same_size = (colour.width, colour.height) == (depth.width, depth.height);
            let reduced = same_size
                && !has_central_principal_point(&colour)
                && has_central_principal_point(&depth);
            RecordingCameras { colour: if reduced { depth } else { colour }, depth, grid: depth }
        }
    })
}

/// The error for a video whose depth has another size than its colour [px].
fn unregistered(
    entries: &[FrameEntry],
    colour: (usize, usize),
    depth: (usize, usize),
) -> DatasetError {
    let path = entries.first().map(|entry| entry.colour.as_path()).unwrap_or(Path::new(""));
    let reason = format!(
        "its second video track, depth, is {}x{} px, expected {}x{} as the first, colour: depth has to \
         be registered to colour, pixel by pixel; --rgb leaves it out",
        depth.0, depth.1, colour.0, colour.1
    );
    DatasetError::file(path, reason)
}

/// A warning if the intrinsics seem to belong to another image size, or to be in another unit.
pub(super) fn camera_warning(recorded: &RecordingCameras, source: &str) -> Option<String> {
    let camera = &recorded.colour;
    let degrees = camera.horizontal_field_of_view().to_degrees();
    if !PLAUSIBLE_VIEW.contains(&degrees) {
        return Some(format!(
            "intrinsics that are not in pixels? By {source}, with a focal length of {} px and the principal \
             point at {}, {}, a picture of {}x{} shows {degrees:.1} degrees across",
            camera.fx, camera.cx, camera.cy, camera.width, camera.height
        ));
    }
    let odd = [&recorded.colour, &recorded.depth]
        .into_iter()
        .find(|camera| !has_central_principal_point(camera))?;
    Some(format!(
        "intrinsics of another size? The principal point of {source} lies at {:.1}, {:.1} in \
         pictures of {}x{}",
        odd.cx, odd.cy, odd.width, odd.height
    ))
}

/// Camera of a video; one calibrated at another size of the same aspect ratio is resized.
fn video_camera(
    entries: &[FrameEntry],
    calibration: &Calibration,
    video: &Video,
) -> Result<Camera<f64>, DatasetError> {
    let (width, height) = video.size;
    let Some(size) = calibration.size else { return Ok(calibration.camera(video.size)) };
    let across = width as f64 / size.0 as f64;
    if (across * size.1 as f64 / height as f64 - 1.0).abs() > ASPECT_TOLERANCE {
        let path = entries.first().map(|entry| entry.colour.clone()).unwrap_or_default();
        let reference = format!("{} says (or any size of that shape)", calibration.source);
        return Err(DatasetError::Size { path, found: video.size, expected: size, reference });
    }
    Ok(calibration.camera(size).resized(width, height))
}

/// Width and height [px] of the colour images in their orientation: the calibration's, which some of
/// the first must have, else that of most of the first. Images that cannot be read do not count.
fn recorded_size(
    entries: &[FrameEntry],
    calibration: &Calibration,
    orientation: Orientation,
) -> Result<(usize, usize), DatasetError> {
    let probes = entries.iter().take(SIZE_PROBES);
    let read = |entry: &FrameEntry| {
        let size = image::image_size(&entry.colour, entry.colour_part())?;
        Ok((entry.colour.clone(), orientation.apply_to_size(size)))
    };
    let (read, failed): (Vec<_>, Vec<_>) = probes.map(read).partition(Result::is_ok);
    let read: Vec<(PathBuf, (usize, usize))> = read.into_iter().flatten().collect();
    let sizes: Vec<(usize, usize)> = read.iter().map(|(_, size)| *size).collect();
    let Some(found) = most_common(&sizes) else {
        let first_error = failed.into_iter().find_map(Result::err);
        return Err(first_error.unwrap_or(DatasetError::NoSuchFrame { position: 0, frames: 0 }));
    };
    let size = calibration.size.filter(|known| sizes.contains(known)).unwrap_or(found);
    let expected = calibration.size.unwrap_or(size);
    if size == expected && size.0 >= 2 && size.1 >= 2 {
        return Ok(size);
    }
    let reference = match calibration.size {
        Some(_) => format!("{} says", calibration.source),
        None => "the smallest picture".into(),
    };
    let expected = calibration.size.unwrap_or((2, 2));
    let path = read.into_iter().find(|(_, other)| *other == size).map(|(path, _)| path);
    Err(DatasetError::Size { path: path.unwrap_or_default(), found: size, expected, reference })
}

/// The most common of some sizes; of several the first.
fn most_common(sizes: &[(usize, usize)]) -> Option<(usize, usize)> {
    let count = |size: &(usize, usize)| sizes.iter().filter(|other| *other == size).count();
    // `max_by_key` takes the last of equal ones.
    sizes.iter().rev().max_by_key(|size| count(size)).copied()
}

/// A warning if the scale of depth, and with it the unit of length, is assumed.
pub(super) fn assumed_scale_warning(format: &FormatDefaults) -> Option<String> {
    format.is_scale_assumed.then(|| {
        format!(
            "the depth scale is not given: {} is taken for one metre, and all lengths depend on it; \
             --depth-scale, or depth_scale in the camera file, gives it (1000 for millimetres)",
            format.depth_scale
        )
    })
}

/// A warning if the median depth of the first frames is implausible.
pub(super) fn depth_scale_warning(entries: &[FrameEntry], loader: &FrameLoader) -> Option<String> {
    let (depth_scale, invalid) = (loader.depth_scale, loader.invalid_depth);
    let mut values: Vec<u16> = Vec::new();
    let probes = entries.iter().filter_map(|entry| Some((entry, entry.depth.as_ref()?)));
    for (entry, depth) in probes.take(DEPTH_PROBES).filter(|_| !loader.colour_only) {
        let Ok(depth) = loader.recorded_depth(entry, depth) else { continue };
        let valid = |v: &&u16| **v > 0 && Some(**v) != invalid;
        values.extend(depth.data.iter().step_by(7).filter(valid));
    }
    let median = median(&mut values)?;
    let metres = f64::from(median) / depth_scale;
    // Hundreds of digits are no number to a reader.
    let shown = |value: f64, plain: String| match (1e-3..1e6).contains(&value) {
        true => plain,
        false => format!("{value:.1e}"),
    };
    (!PLAUSIBLE_DEPTH.contains(&metres)).then(|| {
        let metres = shown(metres, format!("{metres:.4}"));
        let scale = shown(depth_scale, depth_scale.to_string());
        format!(
            "wrong depth scale? The median depth over the first frames is {metres} m (depth \
             image value {median} at {scale} for one metre); usual are 5000 (TUM) and 1000 \
             (millimetres)"
        )
    })
}

/// A warning if undistortion leaves pixels that were never recorded.
pub(super) fn coverage_warning(resampler: &Resampler) -> Option<String> {
    let valid_mask = resampler.valid_mask.as_ref()?;
    let missing = valid_mask.data.iter().filter(|&&c| !c).count();
    let percent = 100.0 * missing as f64 / valid_mask.data.len() as f64;
    Some(format!(
        "removing the lens distortion leaves {percent:.1} % of every frame unrecorded at its \
         edges (depth 0, colour repeated); crop_border = {} under [input] in a file for --config \
         removes it",
        resampler.full_coverage_border
    ))
}

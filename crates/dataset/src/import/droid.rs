//! Keyframes of DROID-SLAM and NeRF-SLAM, with images in the same arrays or of a sequence.

use super::inverse_depth::{InverseDepth, VarianceKind};
use super::posed_images::{
    ReadKeyframes, UnmatchedCounts, match_by_number, match_by_time, open_images,
};
use super::source::{ArrayImages, DepthSource, ImageSource, KeyframePose, KeyframeSource};
use super::{ImportDepth, ImportFormat, ImportOptions};
use crate::formats::droid::{
    Arrays, TIMESTAMP_NAMES, Timestamps, open_poses, read_camera, read_poses, read_timestamps,
};
use crate::formats::npy::{DataType, NpyArray};
use crate::sequence::DEFAULT_FRAME_RATE;
use crate::{DatasetError, Sequence};
use i2slam_geometry::{Pose, StampedPose};
use std::collections::HashSet;
use std::path::Path;

/// Names of the array of images.
const IMAGE_NAMES: [&str; 2] = ["images", "cam0_images"];

/// DROID-SLAM's images have channels B, G, R.
const BGR_IMAGES: &str = IMAGE_NAMES[0];

// Names of the depth maps and their variances, those at full resolution first.
const INVERSE_DEPTHS: [&str; 6] =
    ["disps_up", "cam0_idepths_up", "idepths_up", "disps", "cam0_idepths", "idepths"];
const DEPTHS: [&str; 1] = ["depths"];
const DEPTH_VARIANCES: [&str; 4] =
    ["cam0_depths_cov_up", "depths_cov_up", "cam0_depths_cov", "depths_cov"];
const INVERSE_VARIANCES: [&str; 6] = [
    "cam0_idepths_cov_up",
    "idepths_cov_up",
    "disps_cov_up",
    "cam0_idepths_cov",
    "idepths_cov",
    "disps_cov",
];

/// Opens the arrays, with the images of a sequence or their own.
pub(super) fn open(
    path: &Path,
    pictures: Option<&Path>,
    options: &ImportOptions,
) -> Result<ReadKeyframes, DatasetError> {
    if pictures.is_none() && options.depth == ImportDepth::Pictures {
        let reason = "depth pictures are asked for, and no dataset with them is named";
        return Err(DatasetError::option("depth", reason));
    }
    let arrays = Arrays::open(path)?;
    let numbers = open_poses(&arrays)?;
    let frames = numbers.shape[0];
    let stamps = read_timestamps(&arrays, frames)?;
    let mut warnings = Vec::new();
    let records = used_records(frames, stamps.as_ref(), &mut warnings);
    let poses = read_poses(&numbers, &records)?;
    let depth = read_depth(&arrays, frames, options)?;
    if let Some(folder) = pictures {
        let stamps = stamps.ok_or_else(|| arrays.missing(&TIMESTAMP_NAMES))?;
        let sequence = open_images(folder, options, options.depth == ImportDepth::Pictures)?;
        warnings.extend(sequence.warnings.iter().cloned());
        let matched = match_with_sequence(&poses, &stamps, &sequence, options, &mut warnings);
        let kind = (ImportFormat::Droid, path);
        return Ok(ReadKeyframes::of_sequence(kind, (sequence, depth), matched, warnings));
    }
    let (keyframes, unmatched) = without_sequence(&poses, stamps.as_ref());
    let images = ImageSource::Arrays(Box::new(read_images(&arrays, frames, options)?));
    let (format, path) = (ImportFormat::Droid, path.to_path_buf());
    let source = KeyframeSource { images, depth };
    Ok(ReadKeyframes { format, path, source, keyframes, unmatched, warnings })
}

/// Indices of the arrays that hold a keyframe: runs write arrays with room for more keyframes, whose
/// time stamps are then all equal.
fn used_records(
    frames: usize,
    stamps: Option<&Timestamps>,
    warnings: &mut Vec<String>,
) -> Vec<usize> {
    let Some(stamps) = stamps else { return (0..frames).collect() };
    let stamps = stamps.numbers();
    let used = frames - unused_at_end(&stamps);
    let mut known = HashSet::new();
    let records: Vec<usize> =
        (0..used).filter(|&record| known.insert(stamps[record].to_bits())).collect();
    let repeated = frames - records.len();
    if repeated > 0 {
        warnings.push(format!(
            "{repeated} of {frames} places of the arrays left out: their time stamps repeat others, \
             as in arrays with room for more keyframes"
        ));
    }
    records
}

/// Number of equal time stamps at the end that lie before their predecessor.
fn unused_at_end(stamps: &[f64]) -> usize {
    let equal = stamps.iter().rev().take_while(|&stamp| Some(stamp) == stamps.last()).count();
    let before = stamps.len().checked_sub(equal + 1).map(|at| stamps[at]);
    let goes_back = before.is_some_and(|before| stamps.last().is_some_and(|&s| s < before));
    if equal > 1 && goes_back { equal } else { 0 }
}

/// Index in the arrays and pose.
type Record = (usize, Pose<f64>);

/// Matches poses with the images of a sequence.
fn match_with_sequence(
    poses: &[Record],
    stamps: &Timestamps,
    sequence: &Sequence,
    options: &ImportOptions,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, UnmatchedCounts) {
    match stamps {
        Timestamps::Frames(counts) => {
            let number = |record: usize| counts[record].saturating_mul(options.frames_per_stamp);
            let poses = poses.iter().map(|&(record, pose)| (record, number(record), pose));
            match_by_number(poses.collect(), sequence, warnings)
        }
        Timestamps::Seconds(times) => {
            let stamped = poses.iter().map(|&(record, world_from_camera)| {
                (record, StampedPose { timestamp: times[record], world_from_camera })
            });
            match_by_time(stamped.collect(), sequence, options, warnings)
        }
    }
}

/// Poses with images of the same arrays, in order of time.
fn without_sequence(
    poses: &[Record],
    stamps: Option<&Timestamps>,
) -> (Vec<KeyframePose>, UnmatchedCounts) {
    let index = |record: usize| match stamps {
        Some(Timestamps::Frames(counts)) => counts[record],
        _ => record,
    };
    let time = |record: usize| match stamps {
        Some(Timestamps::Seconds(times)) => times[record],
        _ => index(record) as f64 / DEFAULT_FRAME_RATE,
    };
    let keyframe = |&(record, world_from_camera): &Record| KeyframePose {
        index: index(record),
        timestamp: time(record),
        world_from_camera,
        position: record,
        record,
    };
    let mut keyframes: Vec<KeyframePose> = poses.iter().map(keyframe).collect();
    keyframes.sort_by(|a, b| a.timestamp.total_cmp(&b.timestamp));
    let reason = "the files hold no more".to_owned();
    let unmatched =
        UnmatchedCounts { with_image: poses.len(), reason, ..UnmatchedCounts::default() };
    (keyframes, unmatched)
}

/// Opens the images of the arrays.
fn read_images(
    arrays: &Arrays,
    frames: usize,
    options: &ImportOptions,
) -> Result<ArrayImages, DatasetError> {
    let planes = |rest: &[usize]| matches!(rest, [3, _, _] | [_, _, 3]);
    let images = arrays.find_shaped(&IMAGE_NAMES, frames, "3, height, width", planes)?;
    let images = images.ok_or_else(|| arrays.missing(&IMAGE_NAMES))?;
    if images.data_type != DataType::U8 {
        let reason = format!("pictures of type {:?}, expected U8 (0 to 255)", images.data_type);
        return Err(DatasetError::file(&images.path, reason));
    }
    let size = match images.shape[1..] {
        [3, height, width] | [height, width, 3] => (width, height),
        _ => (0, 0),
    };
    let camera = read_camera(arrays, frames, size)?;
    let source = arrays.path().display().to_string();
    let is_bgr = images.path.file_stem().is_some_and(|name| name == BGR_IMAGES);
    let is_rgb = options.arrays_are_rgb.unwrap_or(!is_bgr);
    ArrayImages::new(images, camera, source, is_rgb, options)
}

/// Opens the depth that the options ask for.
fn read_depth(
    arrays: &Arrays,
    frames: usize,
    options: &ImportOptions,
) -> Result<DepthSource, DatasetError> {
    match options.depth {
        ImportDepth::None => return Ok(DepthSource::None),
        ImportDepth::Pictures => return DepthSource::images(options),
        ImportDepth::Imported => {}
    }
    let planar = |rest: &[usize]| rest.len() == 2;
    let maps = |names: &[&str]| arrays.find_shaped(names, frames, "height, width", planar);
    let (values, is_inverse) = match maps(&INVERSE_DEPTHS)? {
        Some(values) => (values, true),
        None => match maps(&DEPTHS)? {
            Some(values) => (values, false),
            None => return Ok(DepthSource::None),
        },
    };
    let size = (values.shape[2], values.shape[1]);
    let variance = read_variance(arrays, frames, size)?;
    let camera = read_camera(arrays, frames, size)?;
    let max_depth = options.open.max_depth.unwrap_or(f64::INFINITY);
    let depth = InverseDepth { values, is_inverse, variance, camera, max_depth };
    Ok(DepthSource::Inverse(Box::new(depth)))
}

/// Opens the variance of depth or inverse depth, if there is one.
fn read_variance(
    arrays: &Arrays,
    frames: usize,
    (width, height): (usize, usize),
) -> Result<Option<(NpyArray, VarianceKind)>, DatasetError> {
    let expected = format!("{height}, {width}");
    let same = |rest: &[usize]| rest == [height, width];
    let maps = |names: &[&str]| arrays.find_shaped(names, frames, &expected, same);
    if let Some(array) = maps(&DEPTH_VARIANCES)? {
        return Ok(Some((array, VarianceKind::Depth)));
    }
    Ok(maps(&INVERSE_VARIANCES)?.map(|array| (array, VarianceKind::InverseDepth)))
}

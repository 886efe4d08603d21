//! What DROID-SLAM and NeRF-SLAM keep of their keyframes: arrays of poses, inverse depths,
//! pictures, intrinsics and time stamps, each a `.npy` file of a folder or a member of an `.npz`.
//!
//! Poses are seven numbers `camera_from_world`: tx ty tz qx qy qz qw. Intrinsics fx fy cx cy have
//! pixel centres at integers, and those of DROID-SLAM count pixels of an eighth of the size.

mod arrays;
mod maps;
mod numbers;

use super::keyframe::{KeyframePose, Pictures, Source};
use super::npy::Element;
use super::pictures::ArrayPictures;
use super::placed::{Found, LeftOut, by_place, by_time, open_pictures};
use super::{Depth, Kind, Options};
use crate::sequence::DEFAULT_FRAME_RATE;
use crate::{DatasetError, Sequence};
use arrays::Arrays;
use i2slam_geometry::{Pose, StampedPose};
use numbers::{STAMPS, Stamps, camera_of, pose_numbers, read_poses, read_stamps};
use std::collections::HashSet;
use std::path::Path;

const IMAGES: [&str; 2] = ["images", "cam0_images"];

/// The first of these as DROID-SLAM keeps it: channels B, G, R.
const BGR_IMAGES: &str = IMAGES[0];

/// Opens the arrays, with the pictures of a sequence or their own.
pub(super) fn open(
    path: &Path,
    pictures: Option<&Path>,
    options: &Options,
) -> Result<Found, DatasetError> {
    if pictures.is_none() && options.depth == Depth::Pictures {
        let reason = "depth pictures are asked for, and no dataset with them is named".to_owned();
        return Err(DatasetError::Option { name: "depth", reason });
    }
    let arrays = Arrays::open(path)?;
    let numbers = pose_numbers(&arrays)?;
    let frames = numbers.shape[0];
    let stamps = read_stamps(&arrays, frames)?;
    let mut warnings = Vec::new();
    let records = used_records(frames, stamps.as_ref(), &mut warnings);
    let poses = read_poses(&numbers, &records)?;
    let depth = maps::read_depth(&arrays, frames, options)?;
    let (keyframes, left_out, source);
    if let Some(folder) = pictures {
        let stamps = stamps.ok_or_else(|| arrays.missing(&STAMPS))?;
        let sequence = open_pictures(folder, options, options.depth == Depth::Pictures)?;
        warnings.extend(sequence.warnings.iter().cloned());
        (keyframes, left_out) = join(&poses, &stamps, &sequence, options, &mut warnings);
        source = Source { pictures: Pictures::Sequence(Box::new(sequence)), depth };
    } else {
        (keyframes, left_out) = alone(&poses, stamps.as_ref());
        let images = read_images(&arrays, frames, options)?;
        source = Source { pictures: Pictures::Arrays(Box::new(images)), depth };
    }
    let path = path.to_path_buf();
    Ok(Found { kind: Kind::Droid, path, source, keyframes, left_out, warnings })
}

/// The places of the arrays that hold a keyframe. Arrays of a run may have room for more, whose
/// time stamps are then all alike.
fn used_records(frames: usize, stamps: Option<&Stamps>, warnings: &mut Vec<String>) -> Vec<usize> {
    let Some(stamps) = stamps else { return (0..frames).collect() };
    let stamps = stamps.numbers();
    let used = frames - unused_end(&stamps);
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

/// How many stamps at the end are alike and go back in time.
fn unused_end(stamps: &[f64]) -> usize {
    let alike = stamps.iter().rev().take_while(|&stamp| Some(stamp) == stamps.last()).count();
    let before = stamps.len().checked_sub(alike + 1).map(|at| stamps[at]);
    let goes_back = before.is_some_and(|before| stamps.last().is_some_and(|&s| s < before));
    if alike > 1 && goes_back { alike } else { 0 }
}

/// A pose and its place in the arrays.
type Record = (usize, Pose<f64>);

/// Poses with the pictures of a sequence.
fn join(
    poses: &[Record],
    stamps: &Stamps,
    sequence: &Sequence,
    options: &Options,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, LeftOut) {
    match stamps {
        Stamps::Frames(counts) => {
            let place = |record: usize| counts[record].saturating_mul(options.frames_per_stamp);
            let poses = poses.iter().map(|&(record, pose)| (record, place(record), pose));
            by_place(poses.collect(), sequence, warnings)
        }
        Stamps::Seconds(times) => {
            let stamped = poses.iter().map(|&(record, world_from_camera)| {
                (record, StampedPose { timestamp: times[record], world_from_camera })
            });
            by_time(stamped.collect(), sequence, options, warnings)
        }
    }
}

/// Poses with pictures of the same arrays, in order of time.
fn alone(poses: &[Record], stamps: Option<&Stamps>) -> (Vec<KeyframePose>, LeftOut) {
    let index = |record: usize| match stamps {
        Some(Stamps::Frames(counts)) => counts[record],
        _ => record,
    };
    let time = |record: usize| match stamps {
        Some(Stamps::Seconds(times)) => times[record],
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
    let left_out = LeftOut { with_picture: poses.len(), reason, ..LeftOut::default() };
    (keyframes, left_out)
}

fn read_images(
    arrays: &Arrays,
    frames: usize,
    options: &Options,
) -> Result<ArrayPictures, DatasetError> {
    let planes = |rest: &[usize]| matches!(rest, [3, _, _] | [_, _, 3]);
    let images = arrays.find_shaped(&IMAGES, frames, "3, height, width", planes)?;
    let images = images.ok_or_else(|| arrays.missing(&IMAGES))?;
    if images.element != Element::U8 {
        let reason = format!("pictures of type {:?}, expected U8 (0 to 255)", images.element);
        return Err(DatasetError::metadata(&images.path, reason));
    }
    let size = match images.shape[1..] {
        [3, height, width] | [height, width, 3] => (width, height),
        _ => (0, 0),
    };
    let camera = camera_of(arrays, frames, size)?;
    let source = arrays.path().display().to_string();
    let is_bgr = images.path.file_stem().is_some_and(|name| name == BGR_IMAGES);
    let is_rgb = options.arrays_are_rgb.unwrap_or(!is_bgr);
    ArrayPictures::new(images, camera, source, DEFAULT_FRAME_RATE, is_rgb, options)
}

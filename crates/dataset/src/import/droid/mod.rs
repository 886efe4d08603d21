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
use super::placed::{Found, LeftOut, by_index, by_time, open_pictures};
use super::{Depth, Kind, Options};
use crate::{DatasetError, Sequence};
use arrays::Arrays;
use i2slam_geometry::{Pose, StampedPose};
use numbers::{STAMPS, Stamps, camera_of, read_poses, read_stamps};
use std::path::Path;

const IMAGES: [&str; 2] = ["images", "cam0_images"];

/// Frames a second of stamps that count frames.
const FRAME_RATE: f64 = 30.0;

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
    let poses = read_poses(&arrays)?;
    let frames = poses.len();
    let stamps = read_stamps(&arrays, frames)?;
    let depth = maps::read_depth(&arrays, frames, options)?;
    let mut warnings = Vec::new();
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

/// Poses with the pictures of a sequence.
fn join(
    poses: &[Pose<f64>],
    stamps: &Stamps,
    sequence: &Sequence,
    options: &Options,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, LeftOut) {
    match stamps {
        Stamps::Frames(counts) => {
            let indices = counts.iter().map(|count| count.saturating_mul(options.frames_per_stamp));
            let poses = indices.zip(poses.iter().copied()).enumerate();
            let poses = poses.map(|(record, (index, pose))| (record, index, pose));
            by_index(poses.collect(), sequence, warnings)
        }
        Stamps::Seconds(times) => {
            let stamped = poses.iter().zip(times).map(|(&world_from_camera, &timestamp)| {
                StampedPose { timestamp, world_from_camera }
            });
            by_time(&stamped.collect::<Vec<_>>(), sequence, options, warnings)
        }
    }
}

/// Poses with pictures of the same arrays, in order of time.
fn alone(poses: &[Pose<f64>], stamps: Option<&Stamps>) -> (Vec<KeyframePose>, LeftOut) {
    let index = |record: usize| match stamps {
        Some(Stamps::Frames(counts)) => counts[record],
        _ => record,
    };
    let time = |record: usize| match stamps {
        Some(Stamps::Seconds(times)) => times[record],
        _ => index(record) as f64 / FRAME_RATE,
    };
    let keyframe = |(record, &world_from_camera): (usize, &Pose<f64>)| KeyframePose {
        index: index(record),
        timestamp: time(record),
        world_from_camera,
        position: record,
        record,
    };
    let mut keyframes: Vec<KeyframePose> = poses.iter().enumerate().map(keyframe).collect();
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
    ArrayPictures::new(images, camera, source, FRAME_RATE, options)
}

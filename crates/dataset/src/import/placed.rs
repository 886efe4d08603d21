//! Poses that have found their pictures.

use super::join::join;
use super::keyframe::{KeyframePose, Source};
use super::{Kind, Options};
use crate::{DatasetError, OpenOptions, Sequence};
use i2slam_geometry::StampedPose;
use std::path::{Path, PathBuf};

/// A pose this share of the picture interval away from its picture is worth a warning.
const ODD_GAP: f64 = 0.25;

/// How many poses and pictures are no keyframes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LeftOut {
    /// Poses without a picture.
    pub poses_without_picture: usize,
    /// Pictures of the sequence without a pose: what lies between keyframes.
    pub pictures_without_pose: usize,
    /// Poses with a picture, before the choice by range and stride.
    pub(super) with_picture: usize,
    /// Why poses have no picture, and what to do.
    pub(super) reason: String,
}

/// What a reader has found.
pub(super) struct Found {
    pub(super) kind: Kind,
    pub(super) path: PathBuf,
    pub(super) source: Source,
    pub(super) keyframes: Vec<KeyframePose>,
    pub(super) left_out: LeftOut,
    pub(super) warnings: Vec<String>,
}

/// The sequence of the pictures: all of its frames, so that poses without pictures can be told
/// from poses of pictures that were not chosen.
pub(super) fn open_pictures(
    path: &Path,
    options: &Options,
    with_depth: bool,
) -> Result<Sequence, DatasetError> {
    Sequence::open(path, &all_frames(options, with_depth))
}

/// The options that open all pictures.
pub(super) fn all_frames(options: &Options, with_depth: bool) -> OpenOptions {
    OpenOptions { frames: None, stride: 1, colour_only: !with_depth, ..options.open.clone() }
}

/// The keyframes of stamped poses, in order of time.
pub(super) fn by_time(
    poses: &[StampedPose],
    pictures: &Sequence,
    options: &Options,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, LeftOut) {
    let stamps: Vec<f64> = poses.iter().map(|pose| pose.timestamp).collect();
    let times: Vec<f64> = pictures.entries.iter().map(|entry| entry.timestamp).collect();
    let tolerance = options.open.association_tolerance;
    let joined = join(&stamps, &times, tolerance);
    let keyframe = |&(record, position): &(usize, usize)| KeyframePose {
        index: pictures.entries[position].index,
        timestamp: times[position],
        world_from_camera: poses[record].world_from_camera,
        position,
        record,
    };
    let keyframes: Vec<KeyframePose> = joined.pairs.iter().map(keyframe).collect();
    let left_out = LeftOut {
        poses_without_picture: poses.len() - keyframes.len(),
        pictures_without_pose: times.len() - keyframes.len(),
        with_picture: keyframes.len(),
        reason: format!(
            "a pose and its picture must be less than {tolerance} s apart and each other's \
             nearest, and the nearest of all are {:.3} s apart: check that both use one clock",
            joined.nearest_gap
        ),
    };
    if left_out.poses_without_picture > 0 {
        warnings.push(format!(
            "{} of {} poses left out: no picture within {tolerance} s that has no nearer pose",
            left_out.poses_without_picture,
            poses.len()
        ));
    }
    if joined.widest_gap * pictures.frame_rate > ODD_GAP {
        warnings.push(format!(
            "poses lie up to {:.3} s from their pictures, which are {:.3} s apart: are pictures \
             missing, or is it another clock?",
            joined.widest_gap,
            pictures.frame_rate.recip()
        ));
    }
    (keyframes, left_out)
}

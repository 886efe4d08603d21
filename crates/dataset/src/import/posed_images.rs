//! Poses that have found their pictures.

use super::join::join;
use super::keyframe::{DepthSource, KeyframePose, Pictures, Source};
use super::{Depth, Kind, Options};
use crate::{DatasetError, Entry, OpenOptions, Sequence};
use i2slam_geometry::{Pose, StampedPose};
use std::collections::HashMap;
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

impl Found {
    /// Options that say nothing of what was found, a sentence each.
    pub(super) fn ignored(&self, options: &Options) -> Vec<String> {
        let mut words = Vec::new();
        let takes_pictures = matches!(&self.source.depth, DepthSource::Pictures(_));
        if options.variance.is_some() && !takes_pictures {
            words.push("pictures of the variance ignored: no depth pictures are taken".to_owned());
        }
        let has_camera = self.kind == Kind::Colmap || self.source.sequence().is_none();
        let (file, intrinsics) = (&options.open.camera, &options.open.intrinsics);
        if has_camera && (file.is_some() || intrinsics.is_some()) {
            let source = self.source.camera_source();
            words.push(format!("the given camera ignored: that of {source} counts"));
        }
        let has_depth = |pictures: &Sequence| pictures.entries.iter().any(|e| e.depth.is_some());
        let unread = self.kind == Kind::Trajectory
            && options.depth == Depth::Imported
            && self.source.sequence().is_some_and(has_depth);
        if unread {
            let words_of = "a trajectory has no depth of its own, and the depth pictures of the \
                            dataset are not read: ask for the depth of pictures, or for none";
            words.push(words_of.to_owned());
        }
        words
    }
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

/// The options that open all pictures, none thinned: a pose must not get the neighbour of a picture
/// that is left out.
pub(super) fn all_frames(options: &Options, with_depth: bool) -> OpenOptions {
    OpenOptions {
        frames: None,
        stride: 1,
        minimum_gap: 0.0,
        colour_only: !with_depth,
        ..options.open.clone()
    }
}

/// The keyframes of stamped poses (their place in the files, themselves), in order of time.
pub(super) fn by_time(
    mut poses: Vec<(usize, StampedPose)>,
    pictures: &Sequence,
    options: &Options,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, LeftOut) {
    poses.sort_by(|a, b| a.1.timestamp.total_cmp(&b.1.timestamp));
    let stamps: Vec<f64> = poses.iter().map(|(_, pose)| pose.timestamp).collect();
    let times: Vec<f64> = pictures.entries.iter().map(|entry| entry.timestamp).collect();
    let tolerance = options.open.association_tolerance;
    let joined = join(&stamps, &times, tolerance);
    let keyframe = |&(place, position): &(usize, usize)| {
        let (record, pose) = &poses[place];
        keyframe(pictures, position, *record, pose.world_from_camera)
    };
    let keyframes: Vec<KeyframePose> = joined.pairs.iter().map(keyframe).collect();
    if joined.widest_gap * pictures.frame_rate > ODD_GAP {
        warnings.push(format!(
            "poses lie up to {:.3} s from their pictures, which are {:.3} s apart: are pictures \
             missing, or is it another clock?",
            joined.widest_gap,
            pictures.frame_rate.recip()
        ));
    }
    let reason = format!(
        "a pose and its picture must be less than {tolerance} s apart and each other's nearest, \
         and the nearest of all are {:.3} s apart: check that both use one clock",
        joined.nearest_gap
    );
    let why = format!("no picture within {tolerance} s that has no nearer pose");
    let left_out = left_out(poses.len(), &keyframes, pictures, reason, &why, warnings);
    (keyframes, left_out)
}

/// The keyframes of poses (their place in the files, that of their picture among all colour
/// images, themselves), in order of the pictures.
///
/// Who counts pictures counts files: also those that have no depth or no pose and are no frames.
pub(super) fn by_place(
    poses: Vec<(usize, usize, Pose<f64>)>,
    pictures: &Sequence,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, LeftOut) {
    let places: HashMap<usize, usize> =
        pictures.entries.iter().enumerate().map(|(at, entry)| (entry.place, at)).collect();
    let count = poses.len();
    let last = poses.iter().map(|&(_, place, _)| place).max().unwrap_or(0);
    warnings.extend(short_reach(last, pictures));
    let with_picture = poses
        .into_iter()
        .filter_map(|(record, place, pose)| Some((record, *places.get(&place)?, pose)));
    let keyframes = at_positions(with_picture, pictures);
    let reason = format!(
        "time stamps count frames, up to {last}, and there are {} pictures: are these the pictures \
         of this run, and with its stride?",
        pictures.len()
    );
    let left_out =
        left_out(count, &keyframes, pictures, reason, "no picture of its number", warnings);
    (keyframes, left_out)
}

/// The keyframes of poses (their place in the files, the position of their picture, themselves), in
/// order of the pictures; the first where several have one picture.
pub(super) fn at_positions(
    poses: impl Iterator<Item = (usize, usize, Pose<f64>)>,
    pictures: &Sequence,
) -> Vec<KeyframePose> {
    let placed = poses.map(|(record, position, pose)| keyframe(pictures, position, record, pose));
    let mut keyframes: Vec<KeyframePose> = placed.collect();
    keyframes.sort_by_key(|keyframe| (keyframe.position, keyframe.record));
    keyframes.dedup_by_key(|keyframe| keyframe.position);
    keyframes
}

/// A warning if frame numbers end before the middle of the pictures: stamps of a program that
/// skips pictures count those that it took.
fn short_reach(last: usize, pictures: &Sequence) -> Option<String> {
    let count = pictures.entries.iter().map(|entry| entry.place + 1).max()?;
    let reached = last.saturating_add(1);
    (reached.saturating_mul(2) < count).then(|| {
        format!(
            "time stamps reach picture {reached} of {count}: is frames_per_stamp the stride of the \
             run (demo.py: 3)?"
        )
    })
}

fn keyframe(
    pictures: &Sequence,
    position: usize,
    record: usize,
    world_from_camera: Pose<f64>,
) -> KeyframePose {
    let entry = &pictures.entries[position];
    let (index, timestamp) = (entry.index, entry.timestamp);
    KeyframePose { index, timestamp, world_from_camera, position, record }
}

/// Counts what is no keyframe, with a warning where poses are left out.
pub(super) fn left_out(
    poses: usize,
    keyframes: &[KeyframePose],
    pictures: &Sequence,
    reason: String,
    why: &str,
    warnings: &mut Vec<String>,
) -> LeftOut {
    let without = poses - keyframes.len();
    if without > 0 {
        warnings.push(format!("{without} of {poses} poses left out: {why}"));
    }
    LeftOut {
        poses_without_picture: without,
        pictures_without_pose: pictures.len() - keyframes.len(),
        with_picture: keyframes.len(),
        reason,
    }
}

/// Numbers keyframes as frames of the sequence thinned by `minimum_gap` [s], and leaves those out
/// whose pictures it leaves out.
pub(super) fn thin(found: &mut Found, minimum_gap: f64) {
    let Pictures::Sequence(pictures) = &found.source.pictures else { return };
    if !pictures.is_thinned || minimum_gap == 0.0 {
        return;
    }
    let (mut last_kept, mut kept) = (f64::NEG_INFINITY, 0..);
    let index = |entry: &Entry| {
        let follows = entry.timestamp - last_kept > minimum_gap;
        last_kept = if follows { entry.timestamp } else { last_kept };
        if follows { kept.next() } else { None }
    };
    let indices: Vec<Option<usize>> = pictures.entries.iter().map(index).collect();
    let all = found.keyframes.len();
    found.keyframes.retain_mut(|keyframe| {
        keyframe.index = indices[keyframe.position].unwrap_or(keyframe.index);
        indices[keyframe.position].is_some()
    });
    let count = all - found.keyframes.len();
    if count > 0 {
        let words = format!(
            "{count} of {all} poses left out: their pictures follow others by no more than \
             {minimum_gap} s (minimum_gap; 0 keeps all)"
        );
        found.left_out.poses_without_picture += count;
        found.left_out.with_picture -= count;
        found.left_out.reason = words.clone();
        found.warnings.push(words);
    }
}

/// Leaves keyframes out whose picture files are gone.
pub(super) fn leave_out_missing_files(found: &mut Found) {
    let Pictures::Sequence(pictures) = &found.source.pictures else { return };
    let file = |keyframe: &KeyframePose| &pictures.entries[keyframe.position].colour;
    let missing: Vec<_> = found.keyframes.iter().map(file).filter(|file| !file.is_file()).collect();
    let Some(first) = missing.first() else { return };
    let (count, all) = (missing.len(), found.keyframes.len());
    let words = format!("{count} of {all} pictures are missing, the first is {}", first.display());
    found.keyframes.retain(|keyframe| file(keyframe).is_file());
    found.left_out.poses_without_picture += count;
    found.left_out.with_picture -= count;
    found.left_out.reason = words.clone();
    found.warnings.push(words);
}

//! Matching of poses with images, and the keyframes of nerfstudio files and TUM trajectories.

use super::source::{DepthSource, ImageSource, KeyframePose, KeyframeSource};
use super::{ImportDepth, ImportFormat, ImportOptions};
use crate::formats::nerfstudio::TransformsFile;
use crate::formats::{DetectedLayout, FrameEntry, pair_mutually_nearest, read_unit_trajectory};
use crate::{DatasetError, OpenOptions, Sequence};
use i2slam_geometry::{Pose, StampedPose};
use std::collections::HashMap;
use std::path::{Path, PathBuf};

/// Distance in time between pose and image above which a warning is given [frame intervals].
const MAX_SILENT_GAP: f64 = 0.25;

/// Numbers of poses and images that are no keyframes.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UnmatchedCounts {
    /// Poses without an image.
    pub poses_without_image: usize,
    /// Images without a pose: those between keyframes.
    pub images_without_pose: usize,
    /// Poses with an image, before the choice by range and stride.
    pub(super) with_image: usize,
    /// Why poses have no image, and what to do.
    pub(super) reason: String,
}

/// Keyframes as read, before the choice by range and stride.
pub(super) struct ReadKeyframes {
    pub(super) format: ImportFormat,
    pub(super) path: PathBuf,
    pub(super) source: KeyframeSource,
    pub(super) keyframes: Vec<KeyframePose>,
    pub(super) unmatched: UnmatchedCounts,
    pub(super) warnings: Vec<String>,
}

impl ReadKeyframes {
    /// Keyframes with the images of a sequence.
    pub(super) fn of_sequence(
        (format, path): (ImportFormat, &Path),
        (sequence, depth): (Sequence, DepthSource),
        (keyframes, unmatched): (Vec<KeyframePose>, UnmatchedCounts),
        warnings: Vec<String>,
    ) -> Self {
        let source = KeyframeSource { images: ImageSource::Sequence(Box::new(sequence)), depth };
        Self { format, path: path.to_path_buf(), source, keyframes, unmatched, warnings }
    }

    /// Counts keyframes that were dropped, with a warning.
    fn count_dropped(&mut self, count: usize, reason: String) {
        self.unmatched.poses_without_image += count;
        self.unmatched.with_image -= count;
        self.unmatched.reason = reason.clone();
        self.warnings.push(reason);
    }

    /// Warnings about options without effect.
    pub(super) fn ignored_options(&self, options: &ImportOptions) -> Vec<String> {
        let mut warnings = Vec::new();
        let uses_depth_images = matches!(&self.source.depth, DepthSource::Images(_));
        if options.variance.is_some() && !uses_depth_images {
            warnings
                .push("pictures of the variance ignored: no depth pictures are taken".to_owned());
        }
        let has_camera = self.format == ImportFormat::Colmap || self.source.sequence().is_none();
        let source = self.source.camera_source();
        let (file, intrinsics) = (&options.open.camera, &options.open.intrinsics);
        let is_other = |file: &PathBuf| file.display().to_string() != source;
        if has_camera && (file.as_ref().is_some_and(is_other) || intrinsics.is_some()) {
            warnings.push(format!("the given camera ignored: that of {source} counts"));
        }
        let has_depth = |images: &Sequence| images.frames_with_depth() > 0;
        let unread = self.format == ImportFormat::Trajectory
            && options.depth == ImportDepth::Imported
            && self.source.sequence().is_some_and(has_depth);
        if unread {
            let warning = "a trajectory has no depth of its own, and the depth pictures of the \
                            dataset are not read: ask for the depth of pictures, or for none";
            warnings.push(warning.to_owned());
        }
        warnings
    }
}

/// Opens all frames of the sequence of images: only then do poses without an image differ from poses
/// of images that were not chosen.
pub(super) fn open_images(
    path: &Path,
    options: &ImportOptions,
    with_depth: bool,
) -> Result<Sequence, DatasetError> {
    Sequence::open(path, &all_frames(options, with_depth))
}

/// The options that open all images, unthinned: a pose must not be matched with the neighbour of a
/// dropped image.
pub(super) fn all_frames(options: &ImportOptions, with_depth: bool) -> OpenOptions {
    OpenOptions {
        frames: None,
        stride: 1,
        minimum_gap: 0.0,
        colour_only: !with_depth,
        ..options.open.clone()
    }
}

/// Matches poses (with their index in the files) with images by time, in order of time.
pub(super) fn match_by_time(
    mut poses: Vec<(usize, StampedPose)>,
    images: &Sequence,
    options: &ImportOptions,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, UnmatchedCounts) {
    poses.sort_by(|a, b| a.1.timestamp.total_cmp(&b.1.timestamp));
    let stamps: Vec<f64> = poses.iter().map(|(_, pose)| pose.timestamp).collect();
    let times: Vec<f64> = images.entries.iter().map(|entry| entry.timestamp).collect();
    let tolerance = options.open.association_tolerance;
    let associated = pair_mutually_nearest(&stamps, &times, tolerance);
    let keyframe = |&(index, position): &(usize, usize)| {
        let (record, pose) = &poses[index];
        keyframe(images, position, *record, pose.world_from_camera)
    };
    let keyframes: Vec<KeyframePose> = associated.pairs.iter().map(keyframe).collect();
    if associated.widest_gap * images.frame_rate > MAX_SILENT_GAP {
        warnings.push(format!(
            "poses lie up to {:.3} s from their pictures, which are {:.3} s apart: are pictures \
             missing, or is it another clock?",
            associated.widest_gap,
            images.frame_rate.recip()
        ));
    }
    let reason = format!(
        "a pose and its picture must be less than {tolerance} s apart and each other's nearest, \
         and the nearest of all are {:.3} s apart: check that both use one clock",
        associated.nearest_gap
    );
    let why = format!("no picture within {tolerance} s that has no nearer pose");
    let unmatched = count_unmatched(poses.len(), &keyframes, images, reason, &why, warnings);
    (keyframes, unmatched)
}

/// Matches poses with images by number: triples of index in the files, index among all colour image
/// files (including those that are no frames of the sequence), and pose. In order of the images.
pub(super) fn match_by_number(
    poses: Vec<(usize, usize, Pose<f64>)>,
    images: &Sequence,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, UnmatchedCounts) {
    let positions: HashMap<usize, usize> =
        images.entries.iter().enumerate().map(|(at, entry)| (entry.image_index, at)).collect();
    let count = poses.len();
    let last = poses.iter().map(|&(_, number, _)| number).max().unwrap_or(0);
    warnings.extend(stride_warning(last, images));
    let with_image = poses
        .into_iter()
        .filter_map(|(record, number, pose)| Some((record, *positions.get(&number)?, pose)));
    let keyframes = at_positions(with_image, images);
    let reason = format!(
        "time stamps count frames, up to {last}, and there are {} pictures: are these the pictures \
         of this run, and with its stride?",
        images.len()
    );
    let unmatched =
        count_unmatched(count, &keyframes, images, reason, "no picture of its number", warnings);
    (keyframes, unmatched)
}

/// The keyframes of poses, given as triples of index in the files, position of the image, and pose;
/// in order of the images, the first of several poses of one image.
pub(super) fn at_positions(
    poses: impl Iterator<Item = (usize, usize, Pose<f64>)>,
    images: &Sequence,
) -> Vec<KeyframePose> {
    let keyframes = poses.map(|(record, position, pose)| keyframe(images, position, record, pose));
    let mut keyframes: Vec<KeyframePose> = keyframes.collect();
    keyframes.sort_by_key(|keyframe| (keyframe.position, keyframe.record));
    keyframes.dedup_by_key(|keyframe| keyframe.position);
    keyframes
}

/// A warning if frame numbers end before the middle of the images: programs that skip images number
/// only those that they used.
fn stride_warning(last: usize, images: &Sequence) -> Option<String> {
    let count = images.entries.iter().map(|entry| entry.image_index + 1).max()?;
    let reached = last.saturating_add(1);
    (reached.saturating_mul(2) < count).then(|| {
        format!(
            "time stamps reach picture {reached} of {count}: is frames_per_stamp the stride of the \
             run (demo.py: 3)?"
        )
    })
}

fn keyframe(
    images: &Sequence,
    position: usize,
    record: usize,
    world_from_camera: Pose<f64>,
) -> KeyframePose {
    let entry = &images.entries[position];
    let (index, timestamp) = (entry.index, entry.timestamp);
    KeyframePose { index, timestamp, world_from_camera, position, record }
}

/// Counts poses and images that are no keyframes, with a warning about dropped poses.
pub(super) fn count_unmatched(
    poses: usize,
    keyframes: &[KeyframePose],
    images: &Sequence,
    reason: String,
    why: &str,
    warnings: &mut Vec<String>,
) -> UnmatchedCounts {
    let without = poses - keyframes.len();
    if without > 0 {
        warnings.push(format!("{without} of {poses} poses left out: {why}"));
    }
    UnmatchedCounts {
        poses_without_image: without,
        images_without_pose: images.len() - keyframes.len(),
        with_image: keyframes.len(),
        reason,
    }
}

/// Drops keyframes whose images are within `minimum_gap` [s] after a kept one, and renumbers the
/// others as frames of the sequence thinned alike.
pub(super) fn thin(found: &mut ReadKeyframes, minimum_gap: f64) {
    let ImageSource::Sequence(images) = &found.source.images else { return };
    if !images.is_thinned || minimum_gap == 0.0 {
        return;
    }
    let (mut last_kept, mut kept) = (f64::NEG_INFINITY, 0..);
    let index = |entry: &FrameEntry| {
        let follows = entry.timestamp - last_kept > minimum_gap;
        last_kept = if follows { entry.timestamp } else { last_kept };
        if follows { kept.next() } else { None }
    };
    let indices: Vec<Option<usize>> = images.entries.iter().map(index).collect();
    let all = found.keyframes.len();
    found.keyframes.retain_mut(|keyframe| {
        keyframe.index = indices[keyframe.position].unwrap_or(keyframe.index);
        indices[keyframe.position].is_some()
    });
    let count = all - found.keyframes.len();
    if count > 0 {
        let why = match minimum_gap {
            0.0 => "have the time stamps of others".to_owned(),
            _ => {
                format!("follow others by no more than {minimum_gap} s (minimum_gap; 0 keeps all)")
            }
        };
        let reason = format!("{count} of {all} poses left out: their pictures {why}");
        found.count_dropped(count, reason);
    }
}

/// Drops keyframes whose image files do not exist.
pub(super) fn drop_missing_files(found: &mut ReadKeyframes) {
    let ImageSource::Sequence(images) = &found.source.images else { return };
    let file = |keyframe: &KeyframePose| &images.entries[keyframe.position].colour;
    let missing: Vec<_> = found.keyframes.iter().map(file).filter(|file| !file.is_file()).collect();
    let Some(first) = missing.first() else { return };
    let (count, all) = (missing.len(), found.keyframes.len());
    let reason = format!("{count} of {all} pictures are missing, the first is {}", first.display());
    found.keyframes.retain(|keyframe| file(keyframe).is_file());
    found.count_dropped(count, reason);
}

/// Opens a `transforms.json`. It names its images itself; a warning if `pictures` is another folder.
pub(super) fn open_nerfstudio(
    file: &Path,
    pictures: Option<&Path>,
    options: &ImportOptions,
) -> Result<ReadKeyframes, DatasetError> {
    let transforms = TransformsFile::open(file, false)?;
    let with_depth = options.depth != ImportDepth::None && transforms.has_depth();
    if options.depth == ImportDepth::Pictures && !with_depth {
        let reason = "no frame has a depth_file_path, and depth pictures are asked for";
        return Err(DatasetError::file(file, reason));
    }
    let layout = DetectedLayout::Nerfstudio(transforms);
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let sequence = Sequence::from_layout(folder, &layout, &all_frames(options, with_depth))?;
    let mut warnings = sequence.warnings.clone();
    let whole = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    if let Some(other) = pictures.filter(|other| !whole(folder).starts_with(whole(other))) {
        warnings.push(format!(
            "the pictures are those that {} names, not those of {}",
            file.display(),
            other.display()
        ));
    }
    let poses = sequence.poses.iter().copied().enumerate().collect();
    let (keyframes, mut unmatched) = match_by_time(poses, &sequence, options, &mut warnings);
    unmatched.reason = "the other frames have no transform_matrix that is finite and rigid".into();
    let depth = if with_depth { DepthSource::images(options)? } else { DepthSource::None };
    let (kind, images) = ((ImportFormat::Nerfstudio, file), (sequence, depth));
    Ok(ReadKeyframes::of_sequence(kind, images, (keyframes, unmatched), warnings))
}

/// Opens a trajectory with the images of `pictures`, by default of the folder it lies in.
pub(super) fn open_trajectory(
    file: &Path,
    pictures: Option<&Path>,
    options: &ImportOptions,
) -> Result<ReadKeyframes, DatasetError> {
    let poses = read_unit_trajectory(file)?;
    let beside = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = pictures.unwrap_or(beside.unwrap_or(Path::new(".")));
    let depth = DepthSource::images_if_requested(options)?;
    let sequence = open_images(folder, options, options.depth == ImportDepth::Pictures)?;
    let mut warnings = sequence.warnings.clone();
    let poses = poses.into_iter().enumerate().collect();
    let matched = match_by_time(poses, &sequence, options, &mut warnings);
    let (kind, images) = ((ImportFormat::Trajectory, file), (sequence, depth));
    Ok(ReadKeyframes::of_sequence(kind, images, matched, warnings))
}

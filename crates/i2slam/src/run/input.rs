//! Frames or keyframes of any source of poses, ready to be mapped, and what is known of their path.

use super::camera::CameraEstimate;
use super::{RunOptions, Stage};
use crate::config::TrackingMethod;
use crate::keyframes::{KeyframeSource, PictureError, PosedKeyframe};
use crate::session::{MappedFrames, Session};
use i2slam_dataset::{Frame, Sequence};
use i2slam_geometry::{Camera, Pose, StampedPose};
use i2slam_odometry::PoseDeviation;
use std::collections::BTreeMap;

/// A frame to be tracked against the map, or a keyframe that comes with its pose.
pub(super) enum Item {
    Frame(Frame),
    Keyframe(Box<PosedKeyframe>),
}

/// Frames with poses between keyframes, in order.
pub(super) type BetweenFrames =
    Box<dyn ExactSizeIterator<Item = Result<PosedKeyframe, PictureError>>>;

/// Poses that a source knows before its frames are mapped.
#[derive(Default)]
pub(super) struct KnownPath {
    /// Index, stamp [s] and pose of all frames that have one.
    pub(super) poses: Vec<(usize, f64, Pose<f64>)>,
    /// As they were known when their frames came.
    pub(super) online: Vec<StampedPose>,
    /// Deviations of poses that stay as the source gave them, by frame index.
    pub(super) deviations: BTreeMap<usize, PoseDeviation>,
}

/// Frames, or keyframes with poses, ready to be mapped.
pub(super) struct Input<'a> {
    pub(super) items: Box<dyn Iterator<Item = Result<Item, PictureError>> + 'a>,
    /// Number of items.
    pub(super) count: usize,
    /// Keyframes of the path, whose mapping steps all items share.
    pub(super) keyframes: usize,
    /// Kind of the items.
    pub(super) kind: &'static ItemKind,
    /// Camera of all pictures.
    pub(super) camera: Camera<f64>,
    /// Source of its focal length, in words.
    pub(super) camera_source: String,
    /// True if the keyframes are photographs, in no order.
    pub(super) is_unordered: bool,
    /// Readout of a rolling shutter that the source has found [s]; 0 without.
    pub(super) readout: f64,
    pub(super) frame_rate: f64,
    pub(super) between: BetweenFrames,
    pub(super) path: KnownPath,
    /// Frames of the sequence, those without a pose included.
    pub(super) frames_given: usize,
    pub(super) estimate: Option<CameraEstimate>,
    pub(super) undistorted: Option<Sequence>,
    /// Frames that were mapped while they came; items are the others.
    pub(super) mapped: Option<MappedFrames>,
}

/// Words and stages of a kind of items.
pub(super) struct ItemKind {
    /// Name in messages.
    pub(super) name: &'static str,
    pub(super) first: &'static str,
    pub(super) stage: Stage,
    /// Stage after the last item.
    pub(super) last_stage: Stage,
    pub(super) session: fn(crate::Config, Camera<f64>, f64) -> Session,
}

pub(super) const FRAMES: ItemKind = ItemKind {
    name: "frame",
    first: "the first frame",
    stage: Stage::Frames,
    last_stage: Stage::MapRefinement,
    session: Session::tracking,
};

pub(super) const KEYFRAMES: ItemKind = ItemKind {
    name: "keyframe",
    first: "the first keyframe",
    stage: Stage::Keyframes,
    last_stage: Stage::Refinement,
    session: Session::refining,
};

impl<'a> Input<'a> {
    /// True if every n-th of all frames is held out, in place of every n-th item.
    pub(super) fn counts_frames(&self, options: &RunOptions) -> bool {
        self.estimate.is_some() && options.config.tracking.method != TrackingMethod::Adam
    }

    /// All frames of a sequence, to be tracked against the map.
    pub(super) fn frames(sequence: &'a Sequence) -> Self {
        let items = sequence.stream().map(|frame| Ok(Item::Frame(frame?)));
        Self {
            items: Box::new(items),
            count: sequence.len(),
            keyframes: sequence.len(),
            kind: &FRAMES,
            camera: sequence.camera,
            camera_source: sequence.camera_source.clone(),
            is_unordered: false,
            readout: 0.0,
            frame_rate: sequence.frame_rate,
            between: Box::new(std::iter::empty()),
            path: KnownPath::default(),
            frames_given: sequence.len(),
            estimate: None,
            undistorted: None,
            mapped: None,
        }
    }

    /// All keyframes of a source, without any frame between them.
    pub(super) fn keyframes(
        mut source: Box<dyn KeyframeSource>,
        camera_source: String,
        count: usize,
        frame_rate: f64,
    ) -> Input<'static> {
        Input {
            count,
            keyframes: count,
            kind: &KEYFRAMES,
            camera: *source.camera(),
            camera_source,
            is_unordered: source.is_unordered(),
            readout: source.readout(),
            items: Box::new(std::iter::from_fn(move || {
                Some(source.next_keyframe()?.map(|keyframe| Item::Keyframe(Box::new(keyframe))))
            })),
            frame_rate,
            between: Box::new(std::iter::empty()),
            path: KnownPath::default(),
            frames_given: count,
            estimate: None,
            undistorted: None,
            mapped: None,
        }
    }

    /// Stage of its items, after as many that were mapped while they came.
    pub(super) fn stage(&self, before: usize) -> Stage {
        match self.kind.stage {
            Stage::Keyframes if before + self.count > self.keyframes => Stage::Mapping,
            stage => stage,
        }
    }

    pub(super) fn none_usable(&self) -> String {
        match (self.kind.stage, self.count) {
            (Stage::Keyframes, _) => "no keyframe could be used".to_owned(),
            (_, 1) => "the only frame could not be used".to_owned(),
            (_, all) => format!("none of the {all} frames could be used"),
        }
    }
}

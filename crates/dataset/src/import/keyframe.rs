//! From the place of a keyframe to its picture, depth and variance.

use crate::{DatasetError, Sequence};
use i2slam_geometry::{Camera, Image, Pose};

/// A keyframe before its picture is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframePose {
    /// Place of the picture in the associated stream of its sequence, or in the imported file.
    pub index: usize,
    /// Time stamp of the picture [s].
    pub timestamp: f64,
    /// Pose at the time of the picture; OpenCV's camera axes, in the unit of the files.
    pub world_from_camera: Pose<f64>,
    /// Place in the source of the pictures.
    pub(super) position: usize,
    /// Place in the imported files.
    pub(super) record: usize,
}

/// A keyframe, ready to use.
#[derive(Clone, Debug, PartialEq)]
pub struct Keyframe {
    /// Place of the picture in the associated stream of its sequence, or in the imported file.
    pub index: usize,
    /// Time stamp of the picture [s].
    pub timestamp: f64,
    /// 3 planes R, G, B in `[0, 1]`, as recorded (display space).
    pub colour: Image<f32>,
    /// Pose at the time of the picture; OpenCV's camera axes, in the unit of the files.
    pub world_from_camera: Pose<f64>,
    /// 1 plane, depth along the optical axis in the unit of the poses, 0 where there is none.
    pub depth: Option<Image<f32>>,
    /// 1 plane, variance of the depth in that unit squared, above 0 where there is depth.
    pub variance: Option<Image<f32>>,
}

/// Where pictures and depths come from.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub(super) pictures: Box<Sequence>,
    pub(super) depth: DepthSource,
}

/// Where depth comes from.
#[derive(Clone, Debug)]
pub(super) enum DepthSource {
    None,
    /// The depth pictures of the sequence.
    Pictures,
}

impl Source {
    pub(super) fn camera(&self) -> Camera<f64> {
        self.pictures.camera
    }

    pub(super) fn camera_source(&self) -> String {
        self.pictures.camera_source.clone()
    }

    pub(super) fn frame_rate(&self) -> f64 {
        self.pictures.frame_rate
    }

    pub(super) fn has_depth(&self) -> bool {
        !matches!(self.depth, DepthSource::None)
    }

    pub(super) fn has_variance(&self) -> bool {
        false
    }

    pub(super) fn sequence(&self) -> Option<&Sequence> {
        Some(&self.pictures)
    }

    pub(super) fn load(&self, pose: &KeyframePose) -> Result<Keyframe, DatasetError> {
        let frame = self.pictures.load(pose.position)?;
        let depth = self.has_depth().then_some(frame.depth);
        Ok(Keyframe {
            index: pose.index,
            timestamp: pose.timestamp,
            colour: frame.colour,
            world_from_camera: pose.world_from_camera,
            depth,
            variance: None,
        })
    }
}

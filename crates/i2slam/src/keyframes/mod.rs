//! Keyframes that come with poses: what a monocular front end delivers, and what files of one hold.

mod import;
mod monocular;
mod picture_reader;
mod refined_import;
mod row_rectification;

pub use import::{Import, ImportDepth, ImportKind, ImportOptions, import};
pub use monocular::{
    Intrinsics, MonocularError, MonocularSource, OdometryError, OdometryProgress,
    OdometryReconstruction, OdometryWarning, Stage,
};
pub use refined_import::RefinedImport;

use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Image, Pose};
use std::error::Error;
use std::sync::Arc;

/// What goes wrong with a picture, whatever it is.
pub type PictureError = Box<dyn Error + Send + Sync>;

/// A picture that a front end has found a place for.
///
/// Poses and depths share a unit of length, which is the metre only if the front end knows it.
#[derive(Clone, Debug)]
pub struct PosedKeyframe {
    /// Place of the picture in its sequence.
    pub index: usize,
    /// Time stamp of the picture [s].
    pub timestamp: f64,
    /// The picture, R, G, B in [0, 1], as [`KeyframeSource::camera`] sees it.
    pub colour: Arc<Image<f32>>,
    /// Pose at the middle of the exposure; of files, that of the nearest stamp in them.
    pub world_from_camera: Pose<f64>,
    /// Stamp and pose of the picture before it in the video, where known: how fast the camera
    /// moves.
    pub before: Option<(f64, Pose<f64>)>,
    /// The same of the picture after it.
    pub after: Option<(f64, Pose<f64>)>,
    /// What is known of its depth.
    pub depth: Option<EstimatedDepth>,
}

impl PosedKeyframe {
    /// A frame at its pose [world from camera]; depth and adjacent frames are unknown.
    pub fn from_frame(frame: Frame, world_from_camera: Pose<f64>) -> Self {
        let Frame { index, timestamp, colour, .. } = frame;
        let (before, after, depth) = (None, None, None);
        Self { index, timestamp, colour, world_from_camera, before, after, depth }
    }
}

/// Depth along the optical axis that was estimated rather than measured, with how far it is
/// trusted.
#[derive(Clone, Debug)]
pub struct EstimatedDepth {
    /// Depth in the unit of the poses, 0 where there is none; as large as the picture.
    pub depth: Image<f32>,
    /// Its variance, in that unit squared (Rosinol et al. 2023, eq. 3); `None`: all alike.
    pub variance: Option<Image<f32>>,
}

/// Where keyframes come from, one after the other in the order of their stamps.
pub trait KeyframeSource {
    /// Pinhole camera of all pictures and depths.
    fn camera(&self) -> &Camera<f64>;

    /// Time from the first to the last row of the pictures [s], positive if the top row comes
    /// first; 0 where rows are exposed together, or nothing is known. Poses are of the middle row.
    fn readout(&self) -> f64 {
        0.0
    }

    /// The next keyframe; `None` after the last.
    ///
    /// # Errors
    ///
    /// A keyframe that cannot be read; the next call goes on after it.
    fn next_keyframe(&mut self) -> Option<Result<PosedKeyframe, PictureError>>;
}

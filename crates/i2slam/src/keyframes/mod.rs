//! Sources of keyframes with poses: the monocular front end, and files of other programs.

pub(crate) mod delivery;
mod import;
mod monocular;
mod refined_import;
mod row_rectification;

pub use import::{Import, ImportDepth, ImportFormat, ImportOptions, import};
pub(crate) use monocular::{BoxedLoader, GivenPictures, TrackedPictures, in_usual_unit};
pub use monocular::{
    Intrinsics, MonocularError, MonocularSource, OdometryError, OdometryProgress,
    OdometryReconstruction, OdometryWarning, Stage,
};
pub use refined_import::RefinedImport;
pub(crate) use row_rectification::project_rolling;

use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Image, Pose, Tangent};
use std::error::Error;
use std::sync::Arc;

/// Any error of reading a picture.
pub type PictureError = Box<dyn Error + Send + Sync>;

/// A picture with its pose.
///
/// Poses and depths share a unit of length, which need not be the metre.
#[derive(Clone, Debug)]
pub struct PosedKeyframe {
    /// Position of the picture in its sequence.
    pub index: usize,
    /// Time stamp [s].
    pub timestamp: f64,
    /// Three planes R, G, B in [0, 1], of [`KeyframeSource::camera`].
    pub colour: Arc<Image<f32>>,
    /// Pose at mid-exposure; from files, that of the nearest time stamp.
    pub world_from_camera: Pose<f64>,
    /// Time stamp [s] and pose of the video frame before it, where known.
    pub before: Option<(f64, Pose<f64>)>,
    /// Time stamp [s] and pose of the video frame after it, where known.
    pub after: Option<(f64, Pose<f64>)>,
    /// Motion from start to end of the exposure, of either sign, found by comparison with other
    /// photographs.
    pub exposure_motion: Option<Tangent<f64>>,
    /// Estimated depth, where known.
    pub depth: Option<EstimatedDepth>,
    /// Whether later mapping steps may render it again. A frame between keyframes is rendered only
    /// by the steps that follow its own insertion.
    pub is_keyframe: bool,
    /// True if Gaussians are placed where it has no depth, too, at inpainted depth
    /// (`mapping.fill_depth`).
    pub fills_depth: bool,
}

impl PosedKeyframe {
    /// A keyframe at its pose [world from camera]; depth and adjacent frames are unknown.
    pub fn from_frame(frame: Frame, world_from_camera: Pose<f64>) -> Self {
        let Frame { index, timestamp, colour, .. } = frame;
        Self {
            index,
            timestamp,
            colour,
            world_from_camera,
            before: None,
            after: None,
            exposure_motion: None,
            depth: None,
            is_keyframe: true,
            fills_depth: true,
        }
    }
}

/// Estimated depth along the optical axis with its variance.
#[derive(Clone, Debug)]
pub struct EstimatedDepth {
    /// Depth in the unit of the poses, 0 where unknown; of the picture's size.
    pub depth: Image<f32>,
    /// Variance in that unit squared (Rosinol et al. 2023, eq. 4); `None`: treated as measured.
    pub variance: Option<Image<f32>>,
}

/// Delivers keyframes in the order of their time stamps.
pub trait KeyframeSource {
    /// True if the keyframes are photographs: those next to each other in time need not be near, and tell
    /// nothing of the motion during an exposure.
    fn is_unordered(&self) -> bool {
        false
    }

    /// Pinhole camera of all pictures and depths.
    fn camera(&self) -> &Camera<f64>;

    /// Time from the first to the last row of the pictures [s], positive if the top row comes first;
    /// 0 for a global shutter or if unknown. Poses are of the middle row.
    fn readout(&self) -> f64 {
        0.0
    }

    /// The next keyframe; `None` after the last.
    ///
    /// # Errors
    ///
    /// A keyframe that cannot be read; the next call continues after it.
    fn next_keyframe(&mut self) -> Option<Result<PosedKeyframe, PictureError>>;
}

//! Progress, warnings and cancellation of a run.

use super::{CameraEstimate, RuntimeForecast};
use crate::keyframes;
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::warning::Warning;
use i2slam_compute::CancellationToken;
use i2slam_geometry::StampedPose;
use std::fmt;
use std::sync::{Arc, Mutex};

/// Stage of a run; its [`Display`](fmt::Display) is a few words for a progress bar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Visual odometry; its stages may come in turns.
    Odometry(keyframes::Stage),
    /// Visual odometry and mapping of frames while they come; counts tracked frames.
    Online,
    /// Dense depth of photographs, before they are mapped; counts photographs.
    DenseDepth,
    /// Tracking and mapping of frames with depth; counts frames.
    Frames,
    /// Mapping of keyframes; counts keyframes.
    Keyframes,
    /// Mapping of keyframes and the frames between them; counts frames.
    Mapping,
    /// Final refinement of the map after the last frame; counts steps.
    MapRefinement,
    /// Final refinement of map and poses, and localisation of all other frames; counts steps and
    /// frames.
    Refinement,
}

impl Stage {
    /// Words for a progress bar.
    pub fn name(self) -> &'static str {
        match self {
            Self::Odometry(keyframes::Stage::Tracking { .. }) => "tracking points",
            Self::Odometry(keyframes::Stage::Matching) => "matching photographs",
            Self::Odometry(keyframes::Stage::FocalLength) => "estimating the focal length",
            Self::Odometry(keyframes::Stage::Registration) => "finding camera poses",
            Self::Odometry(keyframes::Stage::FirstPairs) => "trying other first pairs",
            Self::Odometry(keyframes::Stage::BundleAdjustment) => "adjusting camera poses",
            Self::Odometry(keyframes::Stage::RollingShutter) => "measuring the rolling shutter",
            Self::Odometry(keyframes::Stage::LoopClosure) => "closing loops",
            Self::Online => "tracking and mapping",
            Self::DenseDepth => "estimating depth",
            Self::Frames => "frames",
            Self::Keyframes => "keyframes",
            Self::Mapping => "mapping frames",
            Self::MapRefinement => "refining the map",
            Self::Refinement => "refining map and poses",
        }
    }
}

impl fmt::Display for Stage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// Receiver of what happens during a run, called on the threads that work. Every method does
/// nothing by default; `()` is an observer that ignores everything.
pub trait Observer: Send + Sync {
    /// `done` of `total` steps of a stage are done; a `total` of 0 is unknown.
    fn progress(&self, _stage: Stage, _done: usize, _total: usize) {}

    /// `done` of `total` frames or keyframes are processed, the last one with this estimate.
    fn frame(&self, _estimate: &FrameEstimate, _done: usize, _total: usize) {}

    /// The map has changed: by a frame, or by a step of the final refinement. `current` copies
    /// everything estimated so far, and the map waits for that alone.
    fn map(&self, _current: &dyn Fn() -> Reconstruction) {}

    /// True if the map is wanted while frames come, also where that of the result is made after the
    /// last one: it is made beside them then, for [`map`](Self::map) alone, which takes time and changes
    /// nothing else. False by default.
    fn follows_map(&self) -> bool {
        false
    }

    /// The pose of a frame as it is known when the frame has come, in the world of the first keyframe:
    /// by visual odometry, or by the map where that is the source of poses. The unit of length is the
    /// metre where depth is measured, and arbitrary by colour alone. Frames without a pose so far are
    /// left out.
    fn pose(&self, _pose: &StampedPose) {}

    /// A decision that users may want to know of.
    fn note(&self, _line: &str) {}

    /// Something unusual, which is also kept in the [`RunOutcome`](super::RunOutcome).
    fn warning(&self, _warning: &Warning) {}

    /// Visual odometry has estimated the camera.
    fn camera(&self, _camera: &CameraEstimate) {}

    /// The duration of the run was extrapolated from its first frames, where the front end finds the
    /// path, or anew when all frames are tracked, if it differs.
    fn forecast(&self, _forecast: &RuntimeForecast) {}

    /// Token that ends the run early, asked for at its start; never cancelled by default.
    fn cancellation(&self) -> CancellationToken {
        CancellationToken::default()
    }
}

impl Observer for () {}

/// The observer of one run, its token, and the warnings so far.
pub(super) struct RunContext {
    pub(super) observer: Arc<dyn Observer>,
    pub(super) cancellation: CancellationToken,
    warnings: Mutex<Vec<Warning>>,
}

impl RunContext {
    pub(super) fn new(observer: impl Observer + 'static) -> Self {
        let cancellation = observer.cancellation();
        Self { observer: Arc::new(observer), cancellation, warnings: Mutex::default() }
    }

    /// Reports a warning and keeps it.
    pub(super) fn warn(&self, warning: impl Into<Warning>) {
        let warning = warning.into();
        self.observer.warning(&warning);
        if let Ok(mut warnings) = self.warnings.lock() {
            warnings.push(warning);
        }
    }

    /// The warnings so far.
    pub(super) fn into_warnings(self) -> Vec<Warning> {
        self.warnings.into_inner().unwrap_or_default()
    }
}

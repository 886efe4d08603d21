//! Progress reports and cancellation of a reconstruction.

use i2slam_compute::CancellationToken;
use std::fmt;
use std::sync::Arc;

/// Stage of the odometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Tracking points; counts pictures.
    Tracking {
        /// Keyframes among those so far.
        keyframes: usize,
    },
    /// Matching photographs with each other; counts pairs.
    Matching,
    /// Searching for the focal length.
    FocalLength,
    /// Registering keyframes; counts registered ones, of all.
    Registration,
    /// Registering photographs from other first pairs; counts maps.
    FirstPairs,
    /// Bundle adjustment; counts steps, of which there may be fewer.
    BundleAdjustment,
    /// Estimating the rolling-shutter readout.
    RollingShutter,
    /// Closing loops.
    LoopClosure,
}

/// Receives a stage, the amount done and the total (0 if unknown).
type Listener = Arc<dyn Fn(Stage, usize, usize) + Send + Sync>;

/// Listener to progress, with a cancellation token. The default has neither.
#[derive(Clone, Default)]
pub struct Progress {
    cancellation: CancellationToken,
    listener: Option<Listener>,
}

impl Progress {
    /// Stops at the next step once `cancellation` is cancelled; calls `listener(stage, done,
    /// total)` on a thread of the reconstruction, with a total of 0 where it is unknown.
    pub fn new(
        cancellation: CancellationToken,
        listener: impl Fn(Stage, usize, usize) + Send + Sync + 'static,
    ) -> Self {
        Self { cancellation, listener: Some(Arc::new(listener)) }
    }

    /// Whether the reconstruction shall stop.
    pub fn is_cancelled(&self) -> bool {
        self.cancellation.is_cancelled()
    }

    /// Reports progress to the listener.
    pub fn report(&self, stage: Stage, done: usize, of: usize) {
        self.listener.iter().for_each(|listener| listener(stage, done, of));
    }

    /// A copy with the same cancellation and no listener, for trial runs.
    pub(crate) fn without_listener(&self) -> Self {
        Self { cancellation: self.cancellation.clone(), listener: None }
    }
}

impl fmt::Debug for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Progress").field("cancellation", &self.cancellation).finish_non_exhaustive()
    }
}

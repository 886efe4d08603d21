//! Who watches the search for a path: how far it is, and whether it is to end.

use i2slam_compute::CancellationToken;
use std::fmt;
use std::sync::Arc;

/// What a front end is at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Follows points from picture to picture; counts pictures.
    Tracking {
        /// Keyframes among those so far.
        keyframes: usize,
    },
    /// Looks for the focal length from several starts.
    FocalLength,
    /// Finds where keyframes were taken; counts those that are found, of all.
    Registration,
    /// Adjusts all poses and points together; counts steps, of which there may be fewer.
    BundleAdjustment,
    /// Looks for the time between the first and the last row of a picture.
    RollingShutter,
    /// Looks for places that are seen again.
    LoopClosure,
}

/// Told of stages, with how much of them is done, and of how much (0 where that is not known).
type Listener = Arc<dyn Fn(Stage, usize, usize) + Send + Sync>;

/// Who watches. The default is nobody.
#[derive(Clone, Default)]
pub struct Progress {
    cancellation: CancellationToken,
    listener: Option<Listener>,
}

impl Progress {
    /// Ends the search where `cancellation` is cancelled; `listener` is told what is done, of how much (0
    /// where that is not known), on the thread that searches.
    pub fn new(
        cancellation: CancellationToken,
        listener: impl Fn(Stage, usize, usize) + Send + Sync + 'static,
    ) -> Self {
        Self { cancellation, listener: Some(Arc::new(listener)) }
    }

    /// Whether the search is to end.
    pub fn is_cancelled(&self) -> bool {
        self.cancellation.is_cancelled()
    }

    /// Tells how far it is.
    pub fn report(&self, stage: Stage, done: usize, of: usize) {
        self.listener.iter().for_each(|listener| listener(stage, done, of));
    }

    /// For trials, of which nothing is told.
    pub(crate) fn without_listener(&self) -> Self {
        Self { cancellation: self.cancellation.clone(), listener: None }
    }
}

impl fmt::Debug for Progress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Progress").field("cancellation", &self.cancellation).finish_non_exhaustive()
    }
}

//! Trajectory errors: associate by time, align, measure.
//!
//! Numbers agree with the public tool evo (Grupp 2017) where evo has them;
//! `tests/golden/README.md` says how that was checked.

mod absolute;
mod alignment;
mod association;
mod deviations;
mod relative;

pub use absolute::{TrajectoryError, absolute_trajectory_error};
pub use alignment::{Alignment, align};
pub use association::{Association, DEFAULT_TOLERANCE, associate, count_frames_without_pose};
pub use deviations::{ClaimedPose, DeviationRatios, deviation_ratios};
pub use relative::{RelativePoseError, Step, relative_pose_error};

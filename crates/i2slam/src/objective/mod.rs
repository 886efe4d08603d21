//! Objectives of tracking and mapping: pictures formed from a map are compared with observed ones,
//! and the losses (eq. 12) are differentiated by map, motion and tone.
//!
//! Metrics that are reported, not minimised, are in `i2slam-eval`.

mod exposure;
mod frame;
mod losses;
mod observation;
mod rays;
mod ssim;

pub(crate) use exposure::pull_back_to_middle;
pub use exposure::{BlurMethod, Exposure, Sampling};
pub use exposure::{blur_length, blur_length_at, virtual_camera_count};
pub(crate) use frame::form_picture;
pub use frame::{Evaluation, FrameObjective, FrameVariables};
pub use losses::{ImageLoss, PixelLoss};
pub use observation::Observation;
pub use rays::{PixelBatch, RayObjective, ShutterHessian};

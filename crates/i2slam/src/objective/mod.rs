//! Where map and image formation meet: the losses of eq. 12 and their derivatives.
//!
//! A difference that is minimised lives here; a difference that is reported lives in `eval`.

mod blur;
mod depth;
mod exposure;
mod frame;
mod observation;
mod photometric;
mod rays;
mod ssim;
mod window;

pub use blur::{blur_length, blur_length_at, virtual_camera_count};
pub(crate) use exposure::carried_to_middle;
pub use exposure::{BlurRoute, Exposure, Sampling};
pub(crate) use frame::form;
pub use frame::{Evaluation, FrameObjective, FrameVariables, Tone};
pub use observation::Observation;
pub use rays::{RayObjective, RayView, ShutterGram};

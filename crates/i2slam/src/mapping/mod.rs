//! Mapping: the map is extended by what a frame sees for the first time, and optimised together
//! with tone, response and keyframe poses.
//!
//! [`Mapper`] is a map of either kind: of frames that are tracked against it and keep their poses,
//! or of keyframes whose poses are only roughly known and optimised with it.

mod blur_pairs;
mod context;
mod depth_inpainting;
mod exposure_motion;
mod field;
mod frame_gains;
mod frame_optimizer;
mod gaussians;
mod joint;
mod keyframe;
mod log_light;
mod mapper;
mod response;
mod response_by_blur;
mod response_change;
mod surface_pairs;
mod view;
mod vignetting;
mod white_balance;
mod window;

pub(crate) use blur_pairs::compare_blurred_keyframes;
pub(crate) use context::{MappingContext, RefinementStep};
pub(crate) use depth_inpainting::MIN_SURFACE_OPACITY;
pub(crate) use exposure_motion::{Timing, find_exposure_motions};
pub(crate) use field::{FieldMapper, largest_field};
pub(crate) use gaussians::GaussianMapper;
pub(crate) use joint::JointFieldMapper;
pub(crate) use keyframe::{AdjacentFrames, Keyframe, is_keyframe};
pub(crate) use mapper::{Growth, Mapper};
pub(crate) use response::{FoundTone, find_tone, finds_response};
pub(crate) use surface_pairs::{compare_keyframes, is_comparison_due};
pub(crate) use vignetting::LensVignetting;

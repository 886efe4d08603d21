//! Mapping: the map is extended by what a frame sees for the first time, and optimised together
//! with tone, response and keyframe poses.
//!
//! [`Mapper`] is a map for tracked frames, [`JointMapper`] one whose keyframe poses are only
//! roughly known.

mod depth_inpainting;
mod field;
mod frame_optimizer;
mod gaussians;
mod iteration_budget;
mod joint;
mod keyframe;
mod localization;
mod map_snapshot;
mod mapper;
mod window;

pub(crate) use field::FieldMapper;
pub(crate) use gaussians::GaussianMapper;
pub(crate) use joint::{JointFieldMapper, JointGaussianMapper, JointMapper};
pub(crate) use keyframe::{AdjacentFrames, Keyframe, is_keyframe};
pub(crate) use map_snapshot::Tracker;
pub(crate) use mapper::{Mapper, MappingContext};

//! Mapping: the map takes in what a frame sees for the first time, and is refined together with
//! tone and response over keyframes. [`Mapper`] is what a session knows of it.

mod ages;
mod densify;
mod field;
mod fill;
mod follower;
mod frames;
mod gaussians;
mod keyframe;
mod locate;
mod mapper;
mod merge;
mod optimizer;
mod posed;
mod posed_gaussians;
mod posed_mapper;
mod round;
mod window;

pub(crate) use field::FieldMapper;
pub(crate) use follower::{Follower, Tracker};
pub(crate) use gaussians::{GaussianMapper, raster_settings};
pub(crate) use keyframe::{Beside, Keyframe, intervals, is_keyframe};
pub(crate) use locate::Locator;
pub(crate) use mapper::{Mapper, Story};
pub(crate) use posed::PosedField;
pub(crate) use posed_gaussians::PosedGaussians;
pub(crate) use posed_mapper::PosedMapper;

use optimizer::MapOptimizer;
use window::select_window;

/// Rendered opacity from which the map has a surface.
const SOLID: f32 = 0.9;

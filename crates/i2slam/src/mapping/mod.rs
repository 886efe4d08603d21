//! Mapping: Gaussians are added where a frame sees something new, and all are refined together
//! with tone and response over a window of keyframes.

mod ages;
mod densify;
mod fill;
mod keyframe;
mod merge;
mod optimizer;
mod window;

pub(crate) use densify::{SceneScale, Source, add_gaussians, placement, prune, seed_map};
pub(crate) use keyframe::{Keyframe, is_keyframe};
pub(crate) use merge::merge;
pub(crate) use optimizer::{MapOptimizer, Sight};
pub(crate) use window::select_window;

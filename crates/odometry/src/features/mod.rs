//! Local features, and their matches between pictures that points cannot be tracked through.

mod aliked;
pub(crate) mod collection;
mod matching;
mod rotation_averaging;
mod verification;

pub(crate) use verification::{max_epipolar_distance, position_sigma};

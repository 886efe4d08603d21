//! Which parts of a ray are sampled.

mod occupancy;
mod ray;

pub use occupancy::Occupancy;
pub(crate) use ray::Walk;
pub use ray::{Ray, Sample};

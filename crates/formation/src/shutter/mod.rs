//! Virtual cameras over the exposure (eqs. 5 to 7).
//!
//! The camera moves from the pose at shutter open to the pose at shutter close, its rotation
//! along a great arc and its centre along a line:
//!
//! ```text
//! R(u) = R_s Exp(u ω),   ω = Log(R_s⁻¹ R_e)          Slerp
//! t(u) = (1 - u) t_s + u t_e                         Lerp,   u in [0, 1]
//! ```
//!
//! Only the two end poses are parameters; gradients of the poses between them are pulled back onto
//! those two by [`ShutterPoses::pull_back`].

mod centre_velocity;
mod poses;
#[cfg(test)]
mod tests;

pub use centre_velocity::CentreVelocity;
pub use poses::{Quadrature, ShutterPoses, ShutterTangent, VirtualCamera};

use i2slam_geometry::Real;

/// Place of row `row` of `height` between the top edge (-½) and the bottom edge (½) of a picture:
/// with a rolling shutter that reads it in `readout`, the row is exposed `readout · place` after
/// the middle one.
pub fn row_place<T: Real>(row: usize, height: usize) -> T {
    T::of((row as f64 + 0.5) / height as f64 - 0.5)
}

//! Maps of Gaussians as files for viewers hold them, against the surface that frames have seen.

mod off_surface;
mod pinholes;

pub use off_surface::SurfaceDistance;
pub use pinholes::{Pinholes, pinholes};

use i2slam_geometry::{Rotation, Vec3};

/// A Gaussian of a splat file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Splat {
    /// Centre in the world.
    pub mean: Vec3<f64>,
    /// Standard deviations along its axes, in the unit of the centre.
    pub scale: [f64; 3],
    /// World from Gaussian.
    pub rotation: Rotation<f64>,
    /// Opacity at its centre, 0 to 1.
    pub opacity: f32,
}

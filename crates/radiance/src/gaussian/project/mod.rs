//! From a Gaussian in the world to its footprint in the image, and back.

mod cotangents;
mod cpu_backward;
mod cpu_backward_group;
mod cpu_forward;
mod cpu_motion;
mod cpu_wanted;
mod matrices;
mod path;
pub(crate) mod reference;
mod splat;
mod stages;

pub(crate) use cpu_backward::{Footprints, PoseSums};
pub(crate) use cpu_forward::{Projection, project};
pub(crate) use cpu_motion::MotionFrame;
use cpu_motion::PathCotangents;
pub(crate) use path::Path;
pub(crate) use splat::{CHUNK, Chunk, Splat};
pub(crate) use stages::Frame;

use i2slam_geometry::{Camera, Real};

/// The range of `x/z` and `y/z` in which the Jacobian of the projection is taken at the mean;
/// beyond it the Jacobian is taken at the border, because the linearisation explodes far outside
/// of the picture. The border lies 0.3 of half the field of view outside of the image.
#[derive(Clone, Copy, Debug)]
pub(crate) struct JacobianRange<T> {
    /// Smallest `x/z` and `y/z`.
    pub(crate) low: [T; 2],
    /// Largest `x/z` and `y/z`.
    pub(crate) high: [T; 2],
}

impl<T: Real> JacobianRange<T> {
    pub(crate) fn of(camera: &Camera<T>) -> Self {
        let (width, height) = (T::of(camera.width as f64), T::of(camera.height as f64));
        let margin = T::of(0.15);
        Self {
            low: [
                (-camera.cx - margin * width) / camera.fx,
                (-camera.cy - margin * height) / camera.fy,
            ],
            high: [
                (width - camera.cx + margin * width) / camera.fx,
                (height - camera.cy + margin * height) / camera.fy,
            ],
        }
    }
}

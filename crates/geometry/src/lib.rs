//! Poses, cameras, pixel grids and trajectories: pure mathematics, no files, no threads.
//!
//! Everything is generic over [`Real`] (`f32` or `f64`), so that the same lines run and are
//! checked against central differences. Conventions are listed in the project's CONVENTIONS.md.

mod camera;
mod eigen;
mod image;
mod pose;
mod real;
mod rotation;
mod sample;
mod similarity;
mod trajectory;
mod vector;

pub use camera::Camera;
pub use eigen::{symmetric_eigen, symmetric_eigen_of};
pub use image::Image;
pub use pose::{Pose, Tangent};
pub use real::Real;
pub use rotation::{Rotation, right_jacobian, right_jacobian_inverse};
pub use sample::{CubicTap, Tap};
pub use similarity::Similarity;
pub use trajectory::{StampedPose, Trajectory, interpolate_pose, nearest_stamp};
pub use vector::{Mat3, Vec3};

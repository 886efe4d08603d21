//! Dense alignment of a frame, picture and depth, to a target picture with radiance and depth.
//!
//! [`Linearization`] gives the residuals and normal equations that tracking against a map and
//! alignment between frames share. [`align`] solves the latter:
//!
//! ```
//! use i2slam_geometry::{Camera, Image, Pose};
//! use i2slam_odometry::alignment::{DensePyramid, DenseView, ExposureMotion, align};
//!
//! let camera = Camera { width: 160, height: 120, fx: 130.0, fy: 130.0, cx: 80.0, cy: 60.0 };
//! let picture = Image::from_fn(160, 120, 3, |_, column, row| {
//!     0.5 + 0.2 * (0.3 * column as f32).sin() * (0.2 * row as f32).cos()
//! });
//! let depth = Image::from_fn(160, 120, 1, |_, column, row| {
//!     2.0 + 0.004 * column as f32 + 0.1 * (0.1 * row as f32).sin()
//! });
//! let pictures = DensePyramid::new(&camera, &picture, Some(&depth));
//! let view = DenseView { pictures: &pictures, motion: ExposureMotion::still() };
//! let found = align(view, view, Pose::identity()).expect("the same picture");
//! assert!(found.reference_from_frame.translation.norm() < 1e-5 && found.overlap > 0.9);
//! ```

mod block_covariance;
mod dense_alignment;
mod depth_smoothing;
mod pyramid;
mod residual;
#[cfg(test)]
mod tests;
mod view;

pub(crate) use block_covariance::cholesky;
pub use dense_alignment::{DenseConstraint, align};
pub use pyramid::{halved_by_mean, halved_camera, halved_depth};
pub use residual::{
    AbsoluteErrors, DEGREES_OF_FREEDOM, DepthSamples, Derivatives, EXPOSURE, Equations, FrameLevel,
    Linearization, READOUT, ResidualSums, RobustScales, TargetLevel, TargetRows, UNKNOWNS,
    VELOCITY, WHITE_BALANCE, is_one_surface,
};
pub use view::{DensePyramid, DenseView, ExposureMotion};

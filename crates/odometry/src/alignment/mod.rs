//! Dense alignment of a frame, picture and depth, to a target picture with radiance and depth.

mod block_covariance;
mod dense_alignment;
mod depth_smoothing;
mod pyramid;
mod residual;
#[cfg(test)]
mod tests;
mod view;

pub use dense_alignment::{DenseConstraint, align};
pub use pyramid::{halve_repeatedly, halved_by_mean, halved_camera, halved_depth};
pub use residual::{
    AbsoluteErrors, DEGREES_OF_FREEDOM, DepthSamples, EXPOSURE, Equations, FrameLevel,
    Linearization, READOUT, ResidualSums, RobustScales, TargetLevel, TargetRows, UNKNOWNS,
    VELOCITY, WHITE_BALANCE, is_one_surface,
};
pub use view::{DensePyramid, DenseView, ExposureMotion};

//! Dense alignment of a frame, picture and depth, to a target picture with radiance and depth.

mod pyramid;
mod residual;

pub use pyramid::{halve_repeatedly, halved_by_mean, halved_camera, halved_depth};
pub use residual::{
    AbsoluteErrors, DEGREES_OF_FREEDOM, DepthSamples, EXPOSURE, Equations, FrameLevel,
    Linearization, READOUT, ResidualSums, RobustScales, TargetLevel, UNKNOWNS, VELOCITY,
    WHITE_BALANCE, is_one_surface,
};

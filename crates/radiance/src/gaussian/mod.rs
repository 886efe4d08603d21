//! A radiance map of 3D Gaussians, splatted as by Kerbl et al. (2023) and Zwicker et al. (2002).
//!
//! With `p = camera_from_world · mean`, `W` the rotation of `camera_from_world`, `J` the Jacobian
//! of the pinhole projection at `p` and `Σ` the covariance of the Gaussian, its footprint is
//!
//! ```text
//! μ  = (fx x/z + cx, fy y/z + cy)                  centre \[px\]
//! Σ₂ = J W Σ Wᵀ Jᵀ + screen_variance · I           covariance \[px²\]
//! α  = min(alpha_max, o exp(-½ dᵀ Σ₂⁻¹ d))         at the pixel centre μ + d
//! ```
//!
//! and a pixel is the sum of equations 3 and 4 of the paper, in order of the depth `z` of the
//! means (ties by index). Contributions with `α < alpha_min` are left out, and a pixel ends
//! before the contribution that would take its transmittance under `transmittance_min`.
//!
//! A camera that moves while its shutter is open ([`ShutterMotion`]) sees footprints that move:
//! each is projected once, and only the blend repeats over the moments of the exposure.
//!
//! Two lanes compute it: [`mod@reference`], plain and generic over the scalar, and [`Rasterizer`],
//! fast. A Gaussian with a parameter that is not finite is left out by both.

mod bin;
mod gradient;
mod map;
mod project;
mod rasterize;
mod settings;
mod sort;

#[cfg(test)]
mod tests;

pub use crate::{Moment, MotionGradient, Render, RenderCotangent, ShutterMotion, View};
pub use bin::TILE;
pub use gradient::MapGradient;
pub use map::{ColourActivation, Gaussian, GaussianMap, Shape};
pub use rasterize::{Rasterizer, StageSeconds, Work, reference};
pub use settings::RasterSettings;

//! A radiance map of 3D Gaussians, splatted as by Kerbl et al. (2023) and Zwicker et al. (2002).
//!
//! With `p = camera_from_world · mean`, `W` the rotation of `camera_from_world`, `J` the Jacobian
//! of the pinhole projection at `p` and `Σ` the covariance of the Gaussian, its footprint is
//!
//! ```text
//! μ  = (fx x/z + cx, fy y/z + cy)                  centre \[px\]
//! Σ₂ = J W Σ Wᵀ Jᵀ + screen_variance · I           covariance \[px²\]
//! α  = min(alpha_max, o exp(-½ dᵀ Σ₂⁻¹ d))         at the pixel centre μ + d
//! z  = p_z + dᵀ Σ₂⁻¹ J V e_z,  V = W Σ Wᵀ            depth there \[m\]
//! ```
//!
//! and a pixel is the sum of equations 3 and 4 of the paper, in order of the depth `z` of the
//! means (ties by index). Contributions with `α < alpha_min` are left out, and a pixel ends
//! before the contribution that would take its transmittance under `transmittance_min`.
//!
//! Some Gaussians show another [colour from each direction](ViewColours), that of mid-exposure during
//! the whole exposure.
//!
//! A camera that moves while its shutter is open ([`ShutterMotion`]) sees footprints that move:
//! each is projected once, and only the blend repeats over the moments of the exposure.
//!
//! Two lanes compute it: [`mod@reference`], plain and generic over the scalar, and [`Rasterizer`],
//! fast. A Gaussian with a parameter that is not finite is left out by both.

mod bin;
mod map;
mod project;
mod rasterize;
mod sort;
mod view_colour;

#[cfg(test)]
pub(crate) mod tests;

pub use crate::{Moment, MotionGradient, Render, RenderCotangent, ShutterMotion, View};
pub use bin::TILE;
pub use map::{ColourActivation, Gaussian, GaussianMap, MapGradient, Shape};
pub use rasterize::{Rasterizer, StageSeconds, Work, reference};
pub use view_colour::{Cone, MAX_DEVIATION, TERMS, ViewColour, ViewColours};

/// Cut-offs of the rasteriser. Not differentiated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RasterSettings {
    /// Gaussians whose mean is nearer than this \[m\] are left out; taken as at least 1e-6.
    pub near: f32,
    /// Gaussians whose mean is farther than this \[m\] are left out.
    pub far: f32,
    /// Variance of the low-pass filter added to every footprint \[px²\], not negative.
    pub screen_variance: f32,
    /// Largest opacity of one contribution; taken as at most 1 - 1e-6.
    pub alpha_max: f32,
    /// Contributions of less than this are left out. It sets the extent of a footprint exactly:
    /// `dᵀ Σ₂⁻¹ d <= 2 ln(opacity / alpha_min)`.
    pub alpha_min: f32,
    /// A pixel ends before its transmittance falls under this.
    pub transmittance_min: f32,
}

impl RasterSettings {
    /// The settings within the range where depths sort and gradients are finite.
    pub(crate) fn bounded(self) -> Self {
        Self {
            near: self.near.max(1e-6),
            alpha_max: self.alpha_max.min(1.0 - 1e-6),
            screen_variance: self.screen_variance.max(0.0),
            ..self
        }
    }
}

impl Default for RasterSettings {
    /// The values of 3D Gaussian splatting, with a near plane for indoor scenes.
    fn default() -> Self {
        Self {
            near: 0.01,
            far: 100.0,
            screen_variance: 0.3,
            alpha_max: 0.99,
            alpha_min: 1.0 / 255.0,
            transmittance_min: 1e-4,
        }
    }
}

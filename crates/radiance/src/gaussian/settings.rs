//! Settings of the rasteriser.

/// Where contributions begin and end. Not differentiated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RasterSettings {
    /// Gaussians whose mean is nearer than this [m] are left out. Must be positive.
    pub near: f32,
    /// Gaussians whose mean is farther than this [m] are left out.
    pub far: f32,
    /// Variance of the low-pass filter added to every footprint [px²].
    pub screen_variance: f32,
    /// Largest opacity of one contribution, below 1.
    pub alpha_max: f32,
    /// Contributions of less than this are left out. It sets the extent of a footprint exactly:
    /// `dᵀ Σ₂⁻¹ d <= 2 ln(opacity / alpha_min)`.
    pub alpha_min: f32,
    /// A pixel ends before its transmittance falls under this.
    pub transmittance_min: f32,
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

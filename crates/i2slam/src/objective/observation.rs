//! Observed pictures of a frame.

use super::ssim::SsimReference;
use i2slam_geometry::Image;
use std::sync::{Arc, OnceLock};

/// Relative standard deviation up to which a depth with variance has full weight.
const FULL_WEIGHT_SIGMA: f32 = 0.003;

/// Colour and depth of a frame, cleaned of values that are negative or not finite.
#[derive(Debug)]
pub struct Observation {
    /// Colour, three planes in `[0, 1]`.
    pub colour: Arc<Image<f32>>,
    /// Depth along the optical axis [m], 0 where there is no reading.
    pub depth: Arc<Image<f32>>,
    /// Variance of the depth [m²], above 0 wherever there is depth; `None` for measured depth.
    pub depth_variance: Option<Image<f32>>,
    has_depth: bool,
    ssim_reference: OnceLock<SsimReference>,
}

impl Observation {
    /// Pictures with measured depth. Invalid depth counts as no reading, invalid colour as black.
    pub fn new(colour: impl Into<Arc<Image<f32>>>, depth: impl Into<Arc<Image<f32>>>) -> Self {
        let (colour, depth) = (sanitized(colour.into()), sanitized(depth.into()));
        let has_depth = depth.data.iter().any(|&d| d > 0.0);
        Self { colour, depth, depth_variance: None, has_depth, ssim_reference: OnceLock::new() }
    }

    /// Pictures with estimated depth. Depth whose variance is not above 0 and finite counts as no
    /// reading.
    pub fn estimated(
        colour: impl Into<Arc<Image<f32>>>,
        depth: impl Into<Arc<Image<f32>>>,
        variance: Image<f32>,
    ) -> Self {
        let mut depth = depth.into();
        let is_known = |variance: f32| variance > 0.0 && variance.is_finite();
        if !variance.data.iter().all(|&v| is_known(v)) {
            let values = Arc::make_mut(&mut depth).data.iter_mut().zip(&variance.data);
            values.filter(|(_, v)| !is_known(**v)).for_each(|(d, _)| *d = 0.0);
        }
        Self { depth_variance: Some(variance), ..Self::new(colour, depth) }
    }

    /// Whether the depth was estimated, for example from the pictures themselves.
    pub fn is_estimated(&self) -> bool {
        self.depth_variance.is_some()
    }

    /// Weight of a pixel's depth in [0, 1]: 1 up to a relative standard deviation of 0.3 %, then
    /// in inverse proportion.
    pub fn depth_weight(&self, pixel: usize) -> f32 {
        let Some(variance) = &self.depth_variance else { return 1.0 };
        (FULL_WEIGHT_SIGMA * self.depth.data[pixel] / variance.data[pixel].sqrt()).min(1.0)
    }

    /// Whether any pixel has a depth reading.
    pub fn has_depth(&self) -> bool {
        self.has_depth
    }

    /// Window means of the colour planes for SSIM, computed on first use.
    pub(super) fn ssim_reference(&self) -> &SsimReference {
        self.ssim_reference.get_or_init(|| SsimReference::new(&self.colour))
    }

    /// Number of pixels with a depth reading.
    pub fn valid_depths(&self) -> usize {
        self.depth.data.iter().filter(|&&d| d > 0.0).count()
    }
}

/// The image with values that are negative or not finite set to 0; copied only if it has any.
fn sanitized(mut image: Arc<Image<f32>>) -> Arc<Image<f32>> {
    let is_invalid = |value: f32| !value.is_finite() || value < 0.0;
    if image.data.iter().any(|value| is_invalid(*value)) {
        let values = Arc::make_mut(&mut image).data.iter_mut();
        values.filter(|value| is_invalid(**value)).for_each(|value| *value = 0.0);
    }
    image
}

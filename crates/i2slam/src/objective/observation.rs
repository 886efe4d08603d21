//! What the camera saw.

use super::photometric::SsimReference;
use i2slam_geometry::Image;
use std::sync::{Arc, OnceLock};

/// Standard deviation of an estimated depth, as a share of it, up to which it counts as a measured
/// one.
const TRUSTED: f32 = 0.01;

/// A frame's pictures as the optimisers use them.
#[derive(Debug)]
pub struct Observation {
    /// Colour, three planes in `[0, 1]`.
    pub colour: Arc<Image<f32>>,
    /// Depth along the optical axis [m], 0 where there is no reading.
    pub depth: Arc<Image<f32>>,
    /// Variance of the depth, in its unit squared, above 0 wherever there is depth; none where
    /// depth was measured rather than estimated.
    pub depth_variance: Option<Image<f32>>,
    has_depth: bool,
    similarity: OnceLock<SsimReference>,
}

impl Observation {
    /// An observation of both pictures. Depth that is not finite counts as no reading, colour
    /// that is not finite as black.
    pub fn new(colour: impl Into<Arc<Image<f32>>>, depth: impl Into<Arc<Image<f32>>>) -> Self {
        let (colour, depth) = (sanitized(colour.into()), sanitized(depth.into()));
        let has_depth = depth.data.iter().any(|&d| d > 0.0);
        Self { colour, depth, depth_variance: None, has_depth, similarity: OnceLock::new() }
    }

    /// An observation whose depth was estimated. Depth whose variance is not a number above 0
    /// counts as no reading.
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

    /// Whether the depth was estimated, perhaps from the very pictures that it would be compared
    /// with.
    pub fn is_estimated(&self) -> bool {
        self.depth_variance.is_some()
    }

    /// How far the depth of a pixel that has one is trusted against one that was measured, in [0,
    /// 1]: fully if its standard deviation is within a hundredth of it, then as its inverse.
    pub fn depth_trust(&self, pixel: usize) -> f32 {
        let Some(variance) = &self.depth_variance else { return 1.0 };
        (TRUSTED * self.depth.data[pixel] / variance.data[pixel].sqrt()).min(1.0)
    }

    /// Whether any pixel has a depth reading.
    pub fn has_depth(&self) -> bool {
        self.has_depth
    }

    /// Window means of the colour planes, computed once.
    pub(super) fn similarity(&self) -> &SsimReference {
        self.similarity.get_or_init(|| SsimReference::new(&self.colour))
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

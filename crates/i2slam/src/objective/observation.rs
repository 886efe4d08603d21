//! Observed pictures of a frame.

use super::ssim::SsimReference;
use i2slam_geometry::Image;
use i2slam_storage::{Storable, append_floats, floats};
use std::sync::{Arc, OnceLock};

/// Relative standard deviation up to which a depth with variance has full weight.
const FULL_WEIGHT_SIGMA: f32 = 0.003;

/// Planes in memory: three of colour, one of depth, six means for SSIM.
const KEPT_PLANES: usize = 10;

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

/// Sizes of an observation.
#[derive(Clone, Copy, Debug)]
pub struct ObservationShape {
    width: usize,
    height: usize,
    has_variance: bool,
    has_depth: bool,
}

/// Means for SSIM are computed again.
impl Storable for Observation {
    type Shape = ObservationShape;

    fn shape(&self) -> ObservationShape {
        let (width, height) = (self.colour.width, self.colour.height);
        let has_variance = self.depth_variance.is_some();
        ObservationShape { width, height, has_variance, has_depth: self.has_depth }
    }

    fn memory(&self) -> usize {
        let planes = KEPT_PLANES + usize::from(self.depth_variance.is_some());
        planes * self.depth.pixels() * size_of::<f32>()
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        append_floats(bytes, &self.colour.data);
        append_floats(bytes, &self.depth.data);
        self.depth_variance.iter().for_each(|variance| append_floats(bytes, &variance.data));
    }

    fn read(shape: &ObservationShape, bytes: &[u8]) -> Self {
        let (width, height) = (shape.width, shape.height);
        let mut rest = bytes;
        let mut image = |channels: usize| {
            let (first, others) = rest.split_at(channels * width * height * size_of::<f32>());
            rest = others;
            Image { width, height, channels, data: floats(first) }
        };
        let (colour, depth) = (Arc::new(image(3)), Arc::new(image(1)));
        let depth_variance = shape.has_variance.then(|| image(1));
        let (has_depth, ssim_reference) = (shape.has_depth, OnceLock::new());
        Self { colour, depth, depth_variance, has_depth, ssim_reference }
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

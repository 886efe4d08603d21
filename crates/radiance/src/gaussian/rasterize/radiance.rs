//! Gaussians behind the seam that all maps share.

use super::Rasterizer;
use crate::RadianceMap;
use crate::gaussian::{GaussianMap, MapGradient, Render, RenderCotangent, View};
use i2slam_geometry::Tangent;

/// A map together with its rasteriser.
pub struct GaussianRadiance {
    /// The Gaussians.
    pub map: GaussianMap,
    /// What draws them.
    pub rasterizer: Rasterizer,
}

impl RadianceMap for GaussianRadiance {
    type Gradient = MapGradient;

    fn render(&mut self, view: &View<f32>, out: &mut Render) {
        self.rasterizer.render(&self.map, view, out);
    }

    fn pull_back(
        &mut self,
        view: &View<f32>,
        cotangent: &RenderCotangent,
        gradient: Option<&mut MapGradient>,
    ) -> Tangent<f64> {
        self.rasterizer.pull_back(&self.map, view, cotangent, gradient)
    }
}

//! One render at mid-exposure, re-projected by its depth.

use super::super::SceneMap;
use super::{Exposure, ExposureRenderer};
use i2slam_formation::ShutterTangent;
use i2slam_formation::reproject::Reprojection;
use i2slam_geometry::Image;
use i2slam_radiance::{Render, RenderCotangent, View};

/// Opacity from which a pixel's depth leads its radiance through the exposure.
const SOLID: f32 = 0.5;

/// The render that stands for all virtual cameras. It is larger than the picture by
/// [`Sampling::margin`](super::Sampling::margin), because those look beyond its border.
pub(super) struct WideRender {
    reprojection: Reprojection,
    render: Render,
    /// Depth of what is solid [m], 0 elsewhere.
    surface: Image<f32>,
    cotangent: RenderCotangent<f32>,
}

impl WideRender {
    pub(super) fn new() -> Self {
        let cotangent = RenderCotangent {
            radiance: Image::default(),
            depth: Image::default(),
            opacity: Image::default(),
        };
        Self {
            reprojection: Reprojection::default(),
            render: Render::default(),
            surface: Image::default(),
            cotangent,
        }
    }

    fn find_surface(&mut self) {
        let Render { depth, opacity, .. } = &self.render;
        self.surface.reset(depth.width, depth.height, 1);
        let pixels = depth.data.iter().zip(&opacity.data);
        for (surface, (&depth, &opacity)) in self.surface.data.iter_mut().zip(pixels) {
            *surface = if opacity >= SOLID { depth / opacity } else { 0.0 };
        }
    }
}

impl<M: SceneMap> ExposureRenderer<M> {
    fn wide_view(&self, exposure: &Exposure) -> View<f32> {
        let view = self.view(exposure.shutter.middle());
        View { camera: self.camera.widened(exposure.sampling.margin), ..view }
    }

    pub(super) fn forward_image(&mut self, map: &M, exposure: &Exposure) -> usize {
        self.reserve(1);
        let (view, sampling) = (self.wide_view(exposure), exposure.sampling);
        let wide = &mut self.wide;
        map.render(&mut self.renderers[0], &view, &mut wide.render);
        wide.find_surface();
        wide.reprojection.blur(
            &self.camera,
            &exposure.shutter,
            exposure.readout,
            sampling.virtual_cameras,
            sampling.quadrature,
            &wide.render.radiance,
            &wide.surface,
            &mut self.hdr,
        );
        let picture = &mut self.renders[0];
        wide.render.depth.crop_into(sampling.margin, &mut picture.depth);
        wide.render.opacity.crop_into(sampling.margin, &mut picture.opacity);
        (self.depths, self.middle) = (0..1, 0);
        1
    }

    pub(super) fn backward_image(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        d_depth: &Image<f32>,
        d_map: Option<&mut M::Gradient>,
    ) -> (ShutterTangent<f64>, f64) {
        let view = self.wide_view(exposure);
        let WideRender { reprojection, cotangent, .. } = &mut self.wide;
        let relative = reprojection.pull_back(d_hdr, &mut cotangent.radiance);
        let (width, height) = (view.camera.width, view.camera.height);
        match exposure.depth_pose {
            Some(_) => cotangent.depth.reset(width, height, 1),
            None => d_depth.embed_into(exposure.sampling.margin, &mut cotangent.depth),
        }
        cotangent.opacity.reset(width, height, 1);
        let d_pose = map.pull_back(&mut self.renderers[0], &view, cotangent, d_map);
        let d_middle = exposure.shutter.pull_back(0.5, d_pose);
        (relative.shutter.plus(d_middle), relative.readout)
    }
}

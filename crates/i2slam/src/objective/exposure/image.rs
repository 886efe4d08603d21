//! One render at mid-exposure, re-projected by its depth, with [`Patches`] where it hides too much.

use super::patches::Patches;
use super::{Exposure, ExposureRenderer};
use i2slam_formation::reproject::Reprojection;
use i2slam_formation::{CentreVelocity, ShutterTangent};
use i2slam_geometry::Image;
use i2slam_radiance::{RadianceMap, Render, RenderCotangent, View};

/// Opacity from which a pixel's depth leads its radiance through the exposure.
const SOLID: f32 = 0.5;

/// The render that stands for all virtual cameras. It is larger than the picture by
/// [`Sampling::margin`](super::Sampling::margin), because those look beyond its border.
pub(super) struct WideRender {
    pub(super) reprojection: Reprojection,
    pub(super) render: Render,
    /// Depth of what is solid [m], 0 elsewhere.
    pub(super) surface: Image<f32>,
    cotangent: RenderCotangent<f32>,
    pub(super) patches: Patches,
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
            patches: Patches::none(),
        }
    }

    fn find_surface(&mut self) {
        self.render.write_surface(SOLID, &mut self.surface);
    }
}

impl<M: RadianceMap> ExposureRenderer<M> {
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
        if M::RENDERS_MOTION { 1 + self.patch(map, exposure) } else { 1 }
    }

    /// Draws what the re-projection cannot tell; gives the number of renders that it took.
    fn patch(&mut self, map: &M, exposure: &Exposure) -> usize {
        let view = self.view(exposure.shutter.middle());
        self.reserve(2);
        let WideRender { reprojection, patches, .. } = &mut self.wide;
        patches.choose(reprojection.uncovered(), &self.hdr);
        let Some(wanted) = patches.wanted() else { return 0 };
        let (drawn, motion) = (&mut self.renders[1], exposure.motion());
        let [first, renderer] = &mut self.renderers[..2] else { return 0 };
        map.render_moving(renderer, &view, &motion, wanted, first, drawn);
        patches.paste(&drawn.radiance, &mut self.hdr);
        1
    }

    pub(super) fn backward_image(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        d_depth: &Image<f32>,
        mut d_map: Option<&mut M::Gradient>,
    ) -> (ShutterTangent<f64>, f64) {
        let (drawn, d_readout) = self.pull_back_patches(map, exposure, d_hdr, d_map.as_deref_mut());
        let view = self.wide_view(exposure);
        let WideRender { reprojection, cotangent, patches, .. } = &mut self.wide;
        let d_looked_up = if patches.wanted().is_some() { &patches.rest } else { d_hdr };
        let relative = reprojection.pull_back(d_looked_up, &mut cotangent.radiance);
        let (width, height) = (view.camera.width, view.camera.height);
        match exposure.depth_pose {
            Some(_) => cotangent.depth.reset(width, height, 1),
            None => d_depth.embed_into(exposure.sampling.margin, &mut cotangent.depth),
        }
        cotangent.opacity.reset(width, height, 1);
        let d_pose = map.pull_back(&mut self.renderers[0], &view, cotangent, d_map);
        let d_middle = exposure.shutter.pull_back(0.5, d_pose);
        (relative.shutter.plus(d_middle).plus(drawn), relative.readout + d_readout)
    }

    /// Divides the cotangent, and pulls the patches' part back to the map, the shutter poses and
    /// the readout.
    fn pull_back_patches(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        d_map: Option<&mut M::Gradient>,
    ) -> (ShutterTangent<f64>, f64) {
        let view = self.view(exposure.shutter.middle());
        let patches = &mut self.wide.patches;
        if patches.wanted().is_none() {
            return (ShutterTangent::zero(), 0.0);
        }
        patches.divide(d_hdr);
        let (renderer, cotangent) = (&mut self.renderers[1], &patches.cotangent);
        let moved = map.pull_back_moving(renderer, &view, &exposure.motion(), cotangent, d_map);
        let motion = CentreVelocity::from(exposure.shutter);
        (motion.pull_back_to_shutter(moved.pose, moved.velocity), moved.readout)
    }
}

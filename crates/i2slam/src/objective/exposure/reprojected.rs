//! Blur by re-projection: one render at mid-exposure is moved to every virtual camera by its depth,
//! with [`Patches`] where it hides too much.

use super::patches::Patches;
use super::{Exposure, ExposureRenderer};
use i2slam_formation::reproject::Reprojection;
use i2slam_formation::{CentreVelocity, ShutterTangent};
use i2slam_geometry::Image;
use i2slam_radiance::{RadianceMap, Render, RenderCotangent, View};

/// Least opacity of a pixel with a surface, by whose depth it is re-projected.
const MIN_SURFACE_OPACITY: f32 = 0.5;

/// The render that all virtual cameras are re-projected from. It extends beyond the picture by
/// [`Sampling::margin`](super::Sampling::margin), because they see beyond its border.
#[derive(Default)]
pub(super) struct MarginRender {
    pub(super) reprojection: Reprojection,
    pub(super) render: Render,
    /// Depth of pixels with a surface [m], 0 elsewhere.
    pub(super) surface: Image<f32>,
    cotangent: RenderCotangent<f32>,
    pub(super) patches: Patches,
}

impl<M: RadianceMap> ExposureRenderer<M> {
    fn margin_view(&self, exposure: &Exposure) -> View<f32> {
        let view = self.view(exposure.shutter.middle());
        View { camera: self.camera.widened(exposure.sampling.margin), ..view }
    }

    /// Blurs by re-projection; returns the number of renders.
    pub(super) fn forward_reprojected(&mut self, map: &M, exposure: &Exposure) -> usize {
        self.reserve(1);
        let (view, sampling) = (self.margin_view(exposure), exposure.sampling);
        let margin_render = &mut self.margin_render;
        map.render(&mut self.renderers[0], &view, &mut margin_render.render);
        margin_render.render.write_surface(MIN_SURFACE_OPACITY, &mut margin_render.surface);
        margin_render.reprojection.blur(
            &self.camera,
            &exposure.shutter,
            exposure.readout,
            sampling.virtual_cameras,
            sampling.quadrature,
            &margin_render.render.radiance,
            &margin_render.surface,
            &mut self.hdr,
        );
        let picture = &mut self.renders[0];
        margin_render.render.depth.crop_into(sampling.margin, &mut picture.depth);
        margin_render.render.opacity.crop_into(sampling.margin, &mut picture.opacity);
        (self.depths, self.middle) = (0..1, 0);
        if M::RENDERS_MOTION { 1 + self.render_patches(map, exposure) } else { 1 }
    }

    /// Replaces tiles that the re-projection cannot show by renders of the moving map; returns the
    /// number of renders.
    fn render_patches(&mut self, map: &M, exposure: &Exposure) -> usize {
        let view = self.view(exposure.shutter.middle());
        self.reserve(2);
        let MarginRender { reprojection, patches, .. } = &mut self.margin_render;
        patches.select(reprojection.uncovered(), &self.hdr);
        let Some(mask) = patches.tile_mask() else { return 0 };
        let (rendered, motion) = (&mut self.renders[1], exposure.motion());
        let [first, renderer] = &mut self.renderers[..2] else { return 0 };
        map.render_moving(renderer, &view, &motion, Some(mask), Some(first), rendered);
        patches.paste(&rendered.radiance, &mut self.hdr);
        1
    }

    pub(super) fn backward_reprojected(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        d_depth: &Image<f32>,
        mut d_map: Option<&mut M::Gradient>,
    ) -> (ShutterTangent<f64>, f64) {
        let (by_patches, d_readout) =
            self.pull_back_patches(map, exposure, d_hdr, d_map.as_deref_mut());
        let view = self.margin_view(exposure);
        let MarginRender { reprojection, cotangent, patches, .. } = &mut self.margin_render;
        let d_reprojected = if patches.tile_mask().is_some() { &patches.rest } else { d_hdr };
        let relative = reprojection.pull_back(d_reprojected, &mut cotangent.radiance);
        let (width, height) = (view.camera.width, view.camera.height);
        match exposure.depth_pose {
            Some(_) => cotangent.depth.reset(width, height, 1),
            None => d_depth.embed_into(exposure.sampling.margin, &mut cotangent.depth),
        }
        cotangent.opacity.reset(width, height, 1);
        let d_pose = map.pull_back(&mut self.renderers[0], &view, cotangent, d_map);
        let d_middle = exposure.shutter.pull_back(0.5, d_pose);
        (relative.shutter.plus(d_middle).plus(by_patches), relative.readout + d_readout)
    }

    /// Splits the cotangent, and pulls the patches' part back to map, shutter poses and readout.
    fn pull_back_patches(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        d_map: Option<&mut M::Gradient>,
    ) -> (ShutterTangent<f64>, f64) {
        let view = self.view(exposure.shutter.middle());
        let patches = &mut self.margin_render.patches;
        if patches.tile_mask().is_none() {
            return (ShutterTangent::zero(), 0.0);
        }
        patches.split(d_hdr);
        let (renderer, cotangent) = (&mut self.renderers[1], &patches.cotangent);
        let moved = map.pull_back_moving(renderer, &view, &exposure.motion(), cotangent, d_map);
        let motion = CentreVelocity::from(exposure.shutter);
        (motion.pull_back_to_shutter(moved.pose, moved.velocity), moved.readout)
    }
}

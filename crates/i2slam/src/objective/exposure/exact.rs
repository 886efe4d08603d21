//! One render per virtual camera.

use super::{Exposure, ExposureRenderer};
use i2slam_formation::{ShutterTangent, accumulate, scale_into};
use i2slam_geometry::Image;
use i2slam_radiance::RadianceMap;

impl<M: RadianceMap> ExposureRenderer<M> {
    pub(super) fn forward_exact(&mut self, map: &M, exposure: &Exposure) -> usize {
        let cameras = exposure.cameras();
        let count = cameras.len();
        self.hdr.reset(self.camera.width, self.camera.height, 3);
        for (j, camera) in cameras.enumerate() {
            self.still(map, j, camera.world_from_camera);
            accumulate(&mut self.hdr, camera.weight as f32, &self.renders[j].radiance);
        }
        (self.depths, self.middle) = (0..count, count / 2);
        count
    }

    pub(super) fn backward_exact(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        (depth, d_depth): (usize, &mut Image<f32>),
        mut d_map: Option<&mut M::Gradient>,
    ) -> ShutterTangent<f64> {
        let mut d_shutter = ShutterTangent::zero();
        for (j, camera) in exposure.cameras().enumerate() {
            let view = self.view(camera.world_from_camera);
            // Blur is linear: every virtual camera receives the same cotangent times its weight.
            scale_into(d_hdr, camera.weight as f32, &mut self.cotangent.radiance);
            let d_pose = if j == depth {
                self.with_depth(d_depth, |this| this.pull_back(map, j, &view, d_map.as_deref_mut()))
            } else {
                self.pull_back(map, j, &view, d_map.as_deref_mut())
            };
            d_shutter = d_shutter.plus(exposure.shutter.pull_back(camera.u, d_pose));
        }
        d_shutter
    }
}

//! One projection; Gaussians move with their pixel velocity.

use super::super::SceneMap;
use super::{Exposure, ExposureRenderer};
use i2slam_formation::{CentreVelocity, ShutterTangent, VirtualCamera};
use i2slam_geometry::Image;
use i2slam_radiance::gaussian::{Moment, ShutterMotion};

impl<M: SceneMap> ExposureRenderer<M> {
    pub(super) fn forward_splat(&mut self, map: &M, exposure: &Exposure) -> usize {
        let middle = exposure.shutter.middle();
        self.reserve(2);
        let view = self.view(middle);
        let motion = exposure.motion();
        map.render_moving(&mut self.renderers[0], &view, &motion, None, &mut self.renders[0]);
        self.hdr.clone_from(&self.renders[0].radiance);
        self.still(map, 1, middle);
        (self.depths, self.middle) = (1..2, 1);
        2
    }

    pub(super) fn backward_splat(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        d_depth: &mut Image<f32>,
        mut d_map: Option<&mut M::Gradient>,
    ) -> (ShutterTangent<f64>, f64) {
        let view = self.view(exposure.shutter.middle());
        self.cotangent.radiance.clone_from(d_hdr);
        let mut moved = map.pull_back_moving(
            &mut self.renderers[0],
            &view,
            &exposure.motion(),
            &self.cotangent,
            d_map.as_deref_mut(),
        );
        if exposure.depth_pose.is_none() {
            let d_pose = self.backward_depth(map, 1, exposure.shutter.middle(), d_depth, d_map);
            moved.pose = moved.pose.plus(d_pose);
        }
        let motion = CentreVelocity::from(exposure.shutter);
        (motion.pull_back_to_shutter(moved.pose, moved.velocity), moved.readout)
    }
}

impl Exposure {
    /// The motion as moving splats need it.
    pub(super) fn motion(&self) -> ShutterMotion<f32> {
        let moment = |camera: VirtualCamera<f64>| Moment {
            time: (camera.u - 0.5) as f32,
            weight: camera.weight as f32,
        };
        ShutterMotion {
            velocity: CentreVelocity::from(self.shutter).velocity.cast(),
            readout: self.readout as f32,
            moments: self.cameras().map(moment).collect(),
        }
    }
}

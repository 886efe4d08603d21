//! The exposure integral (eqs. 5 and 6) by one of two methods, with derivatives.
//!
//! | method | rendered | repeated for every virtual camera |
//! |---|---|---|
//! | exact | every virtual camera | everything |
//! | image | the map once, at mid-exposure, with a margin | re-projection by depth, the blend in a few tiles |

mod patches;
mod reprojected;
mod sampling;
#[cfg(test)]
mod tests;

pub use sampling::{BlurMethod, Sampling, blur_length, blur_length_at, virtual_camera_count};

use i2slam_formation::{CentreVelocity, ShutterPoses, ShutterTangent, VirtualCamera};
use i2slam_formation::{accumulate, scale_into};
use i2slam_geometry::{Camera, Image, Pose, Rotation, Tangent};
use i2slam_radiance::{Moment, RadianceMap, Render, RenderCotangent, ShutterMotion, View};
use reprojected::MarginRender;
use std::ops::Range;

/// Motion of the camera during an exposure, and its sampling.
#[derive(Clone, Copy, Debug)]
pub struct Exposure {
    /// World-from-camera at shutter open and close.
    pub shutter: ShutterPoses<f64>,
    /// Virtual cameras and blur method.
    pub sampling: Sampling,
    /// Time from the first row to the last [exposures]; 0 for a global shutter. The shutter poses
    /// are those of the middle row.
    pub readout: f64,
    /// World-from-camera pose of the depth picture, if it is known; otherwise depth is compared at
    /// the virtual camera that fits best (eq. 14), or at mid-exposure where no other is rendered.
    pub depth_pose: Option<Pose<f64>>,
}

impl Exposure {
    /// The method used: a single camera is rendered exactly, a rolling shutter is re-projected.
    fn method(&self) -> BlurMethod {
        match self.sampling.method {
            _ if self.sampling.virtual_cameras <= 1 && self.readout == 0.0 => BlurMethod::Exact,
            method => method.supporting_readout(self.readout),
        }
    }

    fn cameras(&self) -> impl ExactSizeIterator<Item = VirtualCamera<f64>> + use<> {
        let sampling = self.sampling;
        self.shutter.each_virtual_camera(sampling.virtual_cameras, sampling.quadrature)
    }

    /// The motion for maps that render motion.
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

/// Pulls the cotangent of a pose that moves rigidly with `middle` back to `middle`.
///
/// With `pose = middle ⊞ (λ, l)` and `E = Exp(l)`: `d.ρ = E d_pose.ρ`,
/// `d.φ = E d_pose.φ + λ × E d_pose.ρ`.
pub(crate) fn pull_back_to_middle(
    middle: Pose<f64>,
    pose: Pose<f64>,
    d_pose: Tangent<f64>,
) -> Tangent<f64> {
    let lead = middle.local(pose);
    let turn = Rotation::exp(lead.rotation);
    let translation = turn.rotate(d_pose.translation);
    let rotation = turn.rotate(d_pose.rotation) + lead.translation.cross(translation);
    Tangent { translation, rotation }
}

/// Renders exposures; owns the buffers.
pub(super) struct ExposureRenderer<M: RadianceMap> {
    camera: Camera<f32>,
    settings: M::Settings,
    renderers: Vec<M::Renderer>,
    renders: Vec<Render>,
    margin_render: MarginRender,
    cotangent: RenderCotangent<f32>,
    /// Renders whose depth may be compared, and the one at mid-exposure.
    depths: Range<usize>,
    middle: usize,
    /// Average radiance over the exposure, linear, three planes.
    pub(super) hdr: Image<f32>,
}

impl<M: RadianceMap> ExposureRenderer<M> {
    pub(super) fn new(camera: Camera<f32>, settings: M::Settings) -> Self {
        let none = Image::new(camera.width, camera.height, 1);
        Self {
            camera,
            settings,
            renderers: Vec::new(),
            renders: Vec::new(),
            margin_render: MarginRender::default(),
            cotangent: RenderCotangent {
                radiance: Image::default(),
                depth: none.clone(),
                opacity: none,
            },
            depths: 0..0,
            middle: 0,
            hdr: Image::default(),
        }
    }

    /// Radiance, depth and opacity seen from one pose.
    pub(super) fn render(&mut self, map: &M, pose: Pose<f64>) -> &Render {
        self.render_pose(map, 0, pose);
        &self.renders[0]
    }

    /// Indices of the last exposure's renders whose depth may be compared.
    pub(super) fn depths(&self) -> Range<usize> {
        self.depths.clone()
    }

    pub(super) fn depth(&self, index: usize) -> &Image<f32> {
        &self.renders[index].depth
    }

    /// Opacity at mid-exposure.
    pub(super) fn opacity(&self) -> &Image<f32> {
        &self.renders[self.middle].opacity
    }

    /// Computes `hdr` and the renders whose depth is compared.
    pub(super) fn forward(&mut self, map: &M, exposure: &Exposure) {
        let rendered = match exposure.method() {
            BlurMethod::Exact => self.forward_exact(map, exposure),
            BlurMethod::Reprojected => self.forward_reprojected(map, exposure),
        };
        if let Some(pose) = exposure.depth_pose {
            self.render_pose(map, rendered, pose);
            self.depths = rendered..rendered + 1;
        }
    }

    /// Pulls the cotangents of `hdr` and of the depth of render `depth` back to the shutter poses,
    /// the readout and, if given, the map.
    pub(super) fn backward(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        (depth, d_depth): (usize, &mut Image<f32>),
        mut d_map: Option<&mut M::Gradient>,
    ) -> (ShutterTangent<f64>, f64) {
        let (mut d_shutter, d_readout) = match exposure.method() {
            BlurMethod::Exact => {
                let depth = (depth, &mut *d_depth);
                (self.backward_exact(map, exposure, d_hdr, depth, d_map.as_deref_mut()), 0.0)
            }
            BlurMethod::Reprojected => {
                self.backward_reprojected(map, exposure, d_hdr, d_depth, d_map.as_deref_mut())
            }
        };
        if let Some(pose) = exposure.depth_pose {
            let d_pose = self.backward_depth(map, depth, pose, d_depth, d_map);
            let d_middle = pull_back_to_middle(exposure.shutter.middle(), pose, d_pose);
            d_shutter = d_shutter.plus(exposure.shutter.pull_back(0.5, d_middle));
        }
        (d_shutter, d_readout)
    }

    /// Averages one render per virtual camera; returns their number.
    fn forward_exact(&mut self, map: &M, exposure: &Exposure) -> usize {
        let cameras = exposure.cameras();
        let count = cameras.len();
        self.hdr.reset(self.camera.width, self.camera.height, 3);
        for (j, camera) in cameras.enumerate() {
            self.render_pose(map, j, camera.world_from_camera);
            accumulate(&mut self.hdr, camera.weight as f32, &self.renders[j].radiance);
        }
        (self.depths, self.middle) = (0..count, count / 2);
        count
    }

    fn backward_exact(
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
            let d_map = d_map.as_deref_mut();
            let d_pose = match j == depth {
                true => self.with_depth(d_depth, |this| this.pull_back(map, j, &view, d_map)),
                false => self.pull_back(map, j, &view, d_map),
            };
            d_shutter = d_shutter.plus(exposure.shutter.pull_back(camera.u, d_pose));
        }
        d_shutter
    }

    fn view(&self, pose: Pose<f64>) -> View<f32> {
        View { camera: self.camera, world_from_camera: pose.cast() }
    }

    fn reserve(&mut self, count: usize) {
        while self.renderers.len() < count {
            self.renderers.push(M::renderer(&self.settings));
            self.renders.push(Render::default());
        }
    }

    fn render_pose(&mut self, map: &M, index: usize, pose: Pose<f64>) {
        self.reserve(index + 1);
        let view = self.view(pose);
        map.render(&mut self.renderers[index], &view, &mut self.renders[index]);
    }

    /// Pulls depth alone back to the pose of its render.
    fn backward_depth(
        &mut self,
        map: &M,
        index: usize,
        pose: Pose<f64>,
        d_depth: &mut Image<f32>,
        d_map: Option<&mut M::Gradient>,
    ) -> Tangent<f64> {
        let view = self.view(pose);
        self.cotangent.radiance.reset(self.camera.width, self.camera.height, 3);
        self.with_depth(d_depth, |this| this.pull_back(map, index, &view, d_map))
    }

    fn with_depth<R>(&mut self, d_depth: &mut Image<f32>, work: impl FnOnce(&mut Self) -> R) -> R {
        std::mem::swap(&mut self.cotangent.depth, d_depth);
        let result = work(self);
        std::mem::swap(&mut self.cotangent.depth, d_depth);
        result
    }

    fn pull_back(
        &mut self,
        map: &M,
        index: usize,
        view: &View<f32>,
        d_map: Option<&mut M::Gradient>,
    ) -> Tangent<f64> {
        map.pull_back(&mut self.renderers[index], view, &self.cotangent, d_map)
    }
}

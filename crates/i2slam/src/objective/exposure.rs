//! The exposure integral (eqs. 5 and 6) by one of three routes, forward and back.
//!
//! | route | rendered | what repeats for every virtual camera |
//! |---|---|---|
//! | exact | every virtual camera | everything |
//! | splat | the map once with the pixel velocity of every Gaussian, and once still, for depth | the blend |
//! | image | the map once, at mid-exposure | a look-up by depth |

use super::{SceneMap, virtual_camera_count};
use crate::config::{BlurModel, FormationConfig};
use i2slam_formation::reproject::Reprojection;
use i2slam_formation::{
    CentreVelocity, Quadrature, ShutterPoses, ShutterTangent, VirtualCamera, accumulate, scale_into,
};
use i2slam_geometry::{Camera, Image, Pose, Rotation, Tangent};
use i2slam_radiance::gaussian::{Moment, ShutterMotion};
use i2slam_radiance::{Render, RenderCotangent, View};
use std::ops::Range;

/// Opacity from which a pixel's depth leads its radiance through the exposure.
const SOLID: f32 = 0.5;

/// Blur [px] from which re-projection uncovers more than it can fill, and `auto` renders every
/// virtual camera.
const LONG_BLUR: f64 = 20.0;

/// How the average over the exposure is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlurRoute {
    /// One render per virtual camera.
    Exact,
    /// One projection; Gaussians move with their pixel velocity.
    Splat,
    /// One render at mid-exposure, re-projected by its depth.
    Image,
}

/// How the average over an exposure is sampled and computed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Virtual cameras over the exposure.
    pub virtual_cameras: usize,
    /// Where they lie within it.
    pub quadrature: Quadrature,
    /// How their average is computed.
    pub route: BlurRoute,
}

impl Sampling {
    /// One camera in the middle.
    pub const SHARP: Self =
        Self { virtual_cameras: 1, quadrature: Quadrature::Midpoints, route: BlurRoute::Exact };

    /// What a blur of `length` pixels needs.
    pub fn new(formation: &FormationConfig, length: f64) -> Self {
        if !formation.blur {
            return Self::SHARP;
        }
        let per_camera = f64::from(formation.blur_per_camera);
        let route = match formation.blur_model {
            BlurModel::Exact => BlurRoute::Exact,
            BlurModel::Splat => BlurRoute::Splat,
            BlurModel::Image => BlurRoute::Image,
            BlurModel::Auto if length < LONG_BLUR => BlurRoute::Image,
            BlurModel::Auto => BlurRoute::Exact,
        };
        Self {
            virtual_cameras: virtual_camera_count(length, per_camera, formation.virtual_cameras),
            quadrature: formation.quadrature(),
            route,
        }
    }
}

/// The camera's motion while the shutter is open, and how it is sampled.
#[derive(Clone, Copy, Debug)]
pub struct Exposure {
    /// World-from-camera at shutter open and close.
    pub shutter: ShutterPoses<f64>,
    /// How the average over it is computed.
    pub sampling: Sampling,
    /// Time in which the rows are read [exposures]; 0 for a global shutter. The shutter poses are
    /// those of the middle row.
    pub readout: f64,
    /// Where the camera was when the depth picture was taken, if that is known; otherwise depth
    /// is compared at the virtual camera that fits best (eq. 14), or at mid-exposure on a route
    /// that renders no other.
    pub depth_pose: Option<Pose<f64>>,
}

impl Exposure {
    /// One camera needs no route, and exact renders cannot show rows of different times.
    fn route(&self) -> BlurRoute {
        match self.sampling.route {
            _ if self.sampling.virtual_cameras <= 1 && self.readout == 0.0 => BlurRoute::Exact,
            BlurRoute::Exact if self.readout != 0.0 => BlurRoute::Splat,
            route => route,
        }
    }

    fn cameras(&self) -> Vec<VirtualCamera<f64>> {
        let sampling = self.sampling;
        self.shutter.virtual_cameras(sampling.virtual_cameras, sampling.quadrature)
    }

    fn motion(&self) -> ShutterMotion<f32> {
        let moment = |camera: &VirtualCamera<f64>| Moment {
            time: (camera.u - 0.5) as f32,
            weight: camera.weight as f32,
        };
        ShutterMotion {
            velocity: CentreVelocity::from(self.shutter).velocity.cast(),
            readout: self.readout as f32,
            moments: self.cameras().iter().map(moment).collect(),
        }
    }
}

/// The cotangent of a pose that moves rigidly with `middle`, as a cotangent of `middle`.
///
/// With `pose = middle ⊞ (λ, l)` and `E = Exp(l)`: `d.ρ = E d_pose.ρ`,
/// `d.φ = E d_pose.φ + λ × E d_pose.ρ`.
pub(super) fn carried_to_middle(
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

/// Renders exposures; owns every buffer that this takes.
pub(super) struct ExposureRenderer<M: SceneMap> {
    camera: Camera<f32>,
    settings: M::Settings,
    renderers: Vec<M::Renderer>,
    renders: Vec<Render>,
    reprojection: Reprojection,
    surface: Image<f32>,
    cotangent: RenderCotangent<f32>,
    depths: Range<usize>,
    middle: usize,
    /// Average radiance over the exposure, linear, three planes.
    pub(super) hdr: Image<f32>,
}

impl<M: SceneMap> ExposureRenderer<M> {
    pub(super) fn new(camera: Camera<f32>, settings: M::Settings) -> Self {
        let none = Image::new(camera.width, camera.height, 1);
        Self {
            camera,
            settings,
            renderers: Vec::new(),
            renders: Vec::new(),
            reprojection: Reprojection::default(),
            surface: Image::default(),
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
        self.still(map, 0, pose);
        &self.renders[0]
    }

    /// The renders of the last exposure whose depth may be compared.
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

    /// Computes `hdr`, and the renders that depth is compared with.
    pub(super) fn forward(&mut self, map: &M, exposure: &Exposure) {
        let rendered = match exposure.route() {
            BlurRoute::Exact => self.forward_exact(map, exposure),
            BlurRoute::Splat => self.forward_splat(map, exposure),
            BlurRoute::Image => self.forward_image(map, exposure),
        };
        if let Some(pose) = exposure.depth_pose {
            self.still(map, rendered, pose);
            self.depths = rendered..rendered + 1;
        }
    }

    /// From the cotangents of `hdr` and of the depth of render `depth` back to the shutter poses
    /// (with the readout's own derivative) and, where asked for, to the map.
    pub(super) fn backward(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        (depth, d_depth): (usize, &mut Image<f32>),
        mut d_map: Option<&mut M::Gradient>,
    ) -> (ShutterTangent<f64>, f64) {
        let (mut d_shutter, d_readout) = match exposure.route() {
            BlurRoute::Exact => {
                let depth = (depth, &mut *d_depth);
                (self.backward_exact(map, exposure, d_hdr, depth, d_map.as_deref_mut()), 0.0)
            }
            BlurRoute::Splat => {
                self.backward_splat(map, exposure, d_hdr, d_depth, d_map.as_deref_mut())
            }
            BlurRoute::Image => {
                self.backward_image(map, exposure, d_hdr, d_depth, d_map.as_deref_mut())
            }
        };
        if let Some(pose) = exposure.depth_pose {
            let d_pose = self.backward_depth(map, depth, pose, d_depth, d_map);
            let d_middle = carried_to_middle(exposure.shutter.middle(), pose, d_pose);
            d_shutter = d_shutter.plus(exposure.shutter.pull_back(0.5, d_middle));
        }
        (d_shutter, d_readout)
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

    fn still(&mut self, map: &M, index: usize, pose: Pose<f64>) {
        self.reserve(index + 1);
        let view = self.view(pose);
        map.render(&mut self.renderers[index], &view, &mut self.renders[index]);
    }

    fn forward_exact(&mut self, map: &M, exposure: &Exposure) -> usize {
        let cameras = exposure.cameras();
        self.hdr.reset(self.camera.width, self.camera.height, 3);
        for (j, camera) in cameras.iter().enumerate() {
            self.still(map, j, camera.world_from_camera);
            accumulate(&mut self.hdr, camera.weight as f32, &self.renders[j].radiance);
        }
        (self.depths, self.middle) = (0..cameras.len(), cameras.len() / 2);
        cameras.len()
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
        for (j, camera) in exposure.cameras().iter().enumerate() {
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

    fn forward_splat(&mut self, map: &M, exposure: &Exposure) -> usize {
        let middle = exposure.shutter.middle();
        self.reserve(2);
        let view = self.view(middle);
        let motion = exposure.motion();
        map.render_moving(&mut self.renderers[0], &view, &motion, &mut self.renders[0]);
        self.hdr.clone_from(&self.renders[0].radiance);
        self.still(map, 1, middle);
        (self.depths, self.middle) = (1..2, 1);
        2
    }

    fn backward_splat(
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

    fn forward_image(&mut self, map: &M, exposure: &Exposure) -> usize {
        self.still(map, 0, exposure.shutter.middle());
        let render = &self.renders[0];
        self.surface.reset(self.camera.width, self.camera.height, 1);
        let pixels = render.depth.data.iter().zip(&render.opacity.data);
        for (surface, (&depth, &opacity)) in self.surface.data.iter_mut().zip(pixels) {
            *surface = if opacity >= SOLID { depth / opacity } else { 0.0 };
        }
        self.reprojection.blur(
            &self.camera,
            &exposure.shutter,
            exposure.readout,
            exposure.sampling.virtual_cameras,
            exposure.sampling.quadrature,
            &render.radiance,
            &self.surface,
            &mut self.hdr,
        );
        (self.depths, self.middle) = (0..1, 0);
        1
    }

    fn backward_image(
        &mut self,
        map: &M,
        exposure: &Exposure,
        d_hdr: &Image<f32>,
        d_depth: &mut Image<f32>,
        d_map: Option<&mut M::Gradient>,
    ) -> (ShutterTangent<f64>, f64) {
        let view = self.view(exposure.shutter.middle());
        let relative = self.reprojection.pull_back(d_hdr, &mut self.cotangent.radiance);
        let d_pose = match exposure.depth_pose {
            Some(_) => self.pull_back(map, 0, &view, d_map),
            None => self.with_depth(d_depth, |this| this.pull_back(map, 0, &view, d_map)),
        };
        let d_middle = exposure.shutter.pull_back(0.5, d_pose);
        (relative.shutter.plus(d_middle), relative.readout)
    }

    /// The pose cotangent of a render that only depth is compared with.
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

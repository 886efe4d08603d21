//! The objective of mapping on a radiance field: pixels drawn from several frames, each a batch of
//! rays through the exposure.
//!
//! A pixel's radiance is the mean over `N` moments of the exposure, one in each `N`-th of it, drawn
//! at random from a share of that: from all of it, an estimate of eq. 5 whose error averages out
//! over the steps instead of leaving the same gaps in every streak, but whose scatter counts as a
//! loss that shorter motion and softer edges lessen; from none, the same `N` virtual cameras in
//! every step. Exposure, white balance and response follow the mean (eq. 8).

mod depth;
mod jacobian;

pub use jacobian::ShutterGram;

use super::exposure::carried_to_middle;
use super::frame::{Evaluation, FrameVariables};
use super::{Observation, Tone};
use i2slam_compute::Random;
use i2slam_formation::{CurveGradient, Formation, ShutterTangent};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::View;
use i2slam_radiance::hashgrid::{
    FieldGradient, FieldRenderer, HashGridMap, MarchSettings, Ray, RayGradient, RayRender,
};
use std::ops::Range;

/// Opacity from which a ray has met something.
const MET: f32 = 0.5;

/// Pixels of one frame.
pub struct RayView<'a> {
    /// What the camera saw.
    pub observation: &'a Observation,
    /// Motion, exposure, white balance and response of the frame.
    pub variables: FrameVariables<'a>,
    /// Pixels that are compared, `row · width + column`.
    pub pixels: Vec<usize>,
}

impl RayView<'_> {
    fn times(&self) -> usize {
        self.variables.exposure.sampling.virtual_cameras.max(1)
    }

    /// Whether depth is compared along a ray of its own. A still frame needs one ray for both, and
    /// so does depth that was estimated, no better than to the blur: it is compared at one of the
    /// `N` moments, drawn at random.
    fn depth_apart(&self) -> bool {
        let exposure = &self.variables.exposure;
        let moving = self.times() > 1 || exposure.readout != 0.0;
        let apart = exposure.depth_pose.is_some() || moving && !self.observation.is_estimated();
        apart && self.observation.has_depth()
    }

    /// Rays of a pixel: the moments of the exposure, then depth's.
    pub fn rays_per_pixel(&self) -> usize {
        self.times() + usize::from(self.depth_apart())
    }

    fn depth_pose(&self) -> Pose<f64> {
        let exposure = &self.variables.exposure;
        exposure.depth_pose.unwrap_or_else(|| exposure.shutter.middle())
    }
}

/// Where in the exposure a ray was drawn.
#[derive(Clone, Copy)]
enum Moment {
    /// For radiance (and depth, where both share the ray), from 0 = open to 1 = close.
    Exposure(f64),
    /// For depth alone.
    Depth,
}

/// Draws, forms and compares batches of rays; owns every buffer that this takes.
pub struct RayObjective {
    camera: Camera<f32>,
    renderer: FieldRenderer,
    depth_outlier: f32,
    moment_jitter: f64,
    parts: Vec<Range<usize>>,
    /// Of all views of the last batch.
    pixels: usize,
    rays: Vec<Ray>,
    moments: Vec<Moment>,
    renders: Vec<RayRender>,
    cotangents: Vec<RayRender>,
    ray_gradients: Vec<RayGradient>,
    hdr: Image<f32>,
    picture: Image<f32>,
    d_picture: Image<f32>,
    d_hdr: Image<f32>,
}

impl RayObjective {
    /// An objective for pictures of `camera`.
    pub fn new(camera: Camera<f32>, march: MarchSettings) -> Self {
        Self {
            camera,
            renderer: FieldRenderer::new(march),
            depth_outlier: 0.0,
            moment_jitter: 1.0,
            parts: Vec::new(),
            pixels: 0,
            rays: Vec::new(),
            moments: Vec::new(),
            renders: Vec::new(),
            cotangents: Vec::new(),
            ray_gradients: Vec::new(),
            hdr: Image::default(),
            picture: Image::default(),
            d_picture: Image::default(),
            d_hdr: Image::default(),
        }
    }

    /// Standard deviations beyond which an estimated depth is let go, see [`map`](Self::map); 0
    /// for never.
    pub fn set_depth_outlier(&mut self, deviations: f32) {
        self.depth_outlier = deviations;
    }

    /// The share of each `N`-th of the exposure, around its middle, from which moments are drawn; 1
    /// unless it is set.
    pub fn set_moment_jitter(&mut self, share: f32) {
        self.moment_jitter = f64::from(share);
    }

    /// The mean over `views` of `w_img · mean |C - Ĉ| + w_depth · mean |d - d̂|`, over the pixels
    /// of a view and those of them with a depth reading; where depth has a variance v, (d - d̂)² /
    /// v, or Cauchy's function of it, takes the place of |d - d̂|. Adds the derivative by the field
    /// to `gradient` and returns the part of each view, with derivatives of the whole; those by the
    /// poses only `with_poses`.
    pub fn map(
        &mut self,
        map: &HashGridMap,
        views: &[RayView<'_>],
        weights: (f32, f32),
        with_poses: bool,
        random: &mut Random,
        gradient: &mut FieldGradient,
    ) -> Vec<Evaluation> {
        self.draw(views, random);
        self.renderer.keep_slopes(with_poses);
        self.renderer.render(&map.field, &map.occupancy, &self.rays, &mut self.renders);
        let parts = self.parts.clone();
        self.cotangents.clear();
        self.cotangents.resize(self.rays.len(), RayRender::default());
        let share = 1.0 / views.len().max(1) as f32;
        let weights = (weights.0 * share, weights.1 * share);
        let compared = views.iter().zip(&parts).map(|(v, part)| self.compare(v, part, weights));
        let mut evaluations: Vec<Evaluation> = compared.collect();
        let by_rays = with_poses.then_some(&mut self.ray_gradients);
        self.renderer.pull_back(&map.field, &self.rays, &self.cotangents, Some(gradient), by_rays);
        for ((evaluation, view), part) in evaluations.iter_mut().zip(views).zip(&parts) {
            if with_poses {
                evaluation.shutter = self.to_shutter(view, part);
            }
        }
        evaluations
    }

    /// Samples that a pixel of the last batch took, in the mean; none if there were none.
    pub fn samples_per_pixel(&self) -> Option<f32> {
        let (samples, pixels) = (self.renderer.samples(), self.pixels);
        (samples > 0 && pixels > 0).then(|| samples as f32 / pixels as f32)
    }

    /// The rays of the last batch that lost less than half of their light.
    pub fn unmet(&self) -> impl Iterator<Item = &Ray> {
        let met_little = |(_, render): &(&Ray, &RayRender)| render.opacity < MET;
        self.rays.iter().zip(&self.renders).filter(met_little).map(|(ray, _)| ray)
    }

    /// Draw the rays of all views, and note which of them belong to which view.
    fn draw(&mut self, views: &[RayView<'_>], random: &mut Random) {
        self.rays.clear();
        self.moments.clear();
        self.parts.clear();
        self.pixels = views.iter().map(|view| view.pixels.len()).sum();
        for view in views {
            let from = self.rays.len();
            for &pixel in &view.pixels {
                self.draw_pixel(view, pixel, random);
            }
            self.parts.push(from..self.rays.len());
        }
    }

    fn draw_pixel(&mut self, view: &RayView<'_>, pixel: usize, random: &mut Random) {
        let times = view.times();
        let height = self.camera.height as f64;
        let row = ((pixel / self.camera.width) as f64 + 0.5) / height - 0.5;
        let lead = view.variables.exposure.readout * row;
        // Depth that has no ray of its own is that of the last.
        let first = if times > 1 { random.below(times) } else { 0 };
        for j in (0..times).map(|j| (first + j) % times) {
            let within =
                if times > 1 { 0.5 + self.moment_jitter * (random.uniform() - 0.5) } else { 0.5 };
            let u = (j as f64 + within) / times as f64 + lead;
            let pose = view.variables.exposure.shutter.at(u);
            self.push(pose, pixel, Moment::Exposure(u), random);
        }
        if view.depth_apart() {
            self.push(view.depth_pose(), pixel, Moment::Depth, random);
        }
    }

    fn push(&mut self, pose: Pose<f64>, pixel: usize, moment: Moment, random: &mut Random) {
        let (column, row) = (pixel % self.camera.width, pixel / self.camera.width);
        let ray = Ray::through_pixel(&self.view(pose), column, row);
        self.rays.push(Ray { offset: random.uniform() as f32, ..ray });
        self.moments.push(moment);
    }

    fn view(&self, pose: Pose<f64>) -> View<f32> {
        View { camera: self.camera, world_from_camera: pose.cast() }
    }

    /// Forms and compares the pixels of a view, and writes the cotangents of its rays.
    fn compare(
        &mut self,
        view: &RayView<'_>,
        part: &Range<usize>,
        weights: (f32, f32),
    ) -> Evaluation {
        let mut evaluation = Evaluation { pixels: view.pixels.len(), ..Evaluation::default() };
        self.average(view, part);
        self.compare_pictures(view, weights.0, &mut evaluation);
        self.pull_back_tone(view, &mut evaluation);
        let (times, stride) = (view.times(), view.rays_per_pixel());
        let count = view.pixels.len();
        for (i, rays) in self.cotangents[part.clone()].chunks_mut(stride).enumerate() {
            for ray in &mut rays[..times] {
                ray.radiance = [0, 1, 2].map(|c| self.d_hdr.data[c * count + i] / times as f32);
            }
        }
        self.compare_depth(view, part, weights.1, &mut evaluation);
        evaluation
    }

    /// `hdr`: the mean radiance of every pixel of a view.
    fn average(&mut self, view: &RayView<'_>, part: &Range<usize>) {
        let (times, count) = (view.times(), view.pixels.len());
        self.hdr.reset(count, 1, 3);
        for (i, rays) in self.renders[part.clone()].chunks(view.rays_per_pixel()).enumerate() {
            for c in 0..3 {
                let sum: f32 = rays[..times].iter().map(|ray| ray.radiance[c]).sum();
                self.hdr.data[c * count + i] = sum / times as f32;
            }
        }
    }

    fn compare_pictures(&mut self, view: &RayView<'_>, weight: f32, evaluation: &mut Evaluation) {
        let count = view.pixels.len();
        view.variables.form(&self.hdr, &mut self.picture);
        self.d_picture.reset(count, 1, 3);
        let scale = weight / (3 * count).max(1) as f32;
        let mut sum = 0.0;
        for c in 0..3 {
            let observed = view.observation.colour.plane(c);
            for (i, &pixel) in view.pixels.iter().enumerate() {
                let difference = self.picture.data[c * count + i] - observed[pixel];
                sum += f64::from(difference.abs());
                if difference != 0.0 {
                    self.d_picture.data[c * count + i] = scale.copysign(difference);
                }
            }
        }
        evaluation.image = sum / (3 * count).max(1) as f64;
        evaluation.total += f64::from(weight) * evaluation.image;
    }

    fn pull_back_tone(&mut self, view: &RayView<'_>, evaluation: &mut Evaluation) {
        let Some(Tone { frame, curve }) = &view.variables.tone else {
            self.d_hdr.clone_from(&self.d_picture);
            return;
        };
        let mut d_curve = CurveGradient::zero(curve);
        Formation::new(frame, curve).pull_back(
            &self.hdr,
            &self.d_picture,
            &mut self.d_hdr,
            &mut evaluation.tone,
            &mut d_curve,
        );
        evaluation.curve = Some(d_curve);
    }

    /// The derivative by both poses of a view, the derivatives by its rays being known.
    fn to_shutter(&self, view: &RayView<'_>, part: &Range<usize>) -> ShutterTangent<f64> {
        let stride = view.rays_per_pixel();
        let pixel = |ray: usize| view.pixels[(ray - part.start) / stride];
        let each = part.clone().map(|ray| self.ray_to_shutter(view, pixel(ray), ray));
        each.fold(ShutterTangent::zero(), ShutterTangent::plus)
    }

    /// The share of one ray in the derivative by both poses.
    fn ray_to_shutter(&self, view: &RayView<'_>, pixel: usize, ray: usize) -> ShutterTangent<f64> {
        let shutter = &view.variables.exposure.shutter;
        let (column, row) = (pixel % self.camera.width, pixel / self.camera.width);
        let pull_back =
            |pose: Pose<f64>| self.ray_gradients[ray].to_pose(&self.view(pose), column, row);
        match self.moments[ray] {
            Moment::Exposure(u) => shutter.pull_back(u, pull_back(shutter.at(u))),
            Moment::Depth => {
                let pose = view.depth_pose();
                let d_middle = carried_to_middle(shutter.middle(), pose, pull_back(pose));
                shutter.pull_back(0.5, d_middle)
            }
        }
    }
}

#[cfg(test)]
mod tests;

//! Objective of mapping on a radiance field: batches of pixels of several frames, with one ray per
//! pixel and time of the exposure.
//!
//! A pixel's radiance is the mean over `N` times of the exposure, one in each `N`-th of it,
//! jittered within a share of that. Jitter over all of it makes the mean an unbiased estimate of
//! eq. 5, but its variance is a loss that shorter motion and softer edges lower; no jitter means
//! the same `N` virtual cameras in every step. Exposure, white balance and response follow the mean
//! (eq. 8).

mod depth;

use super::Observation;
use super::exposure::pull_back_to_middle;
use super::frame::{Evaluation, FrameVariables, form_picture};
use i2slam_compute::Random;
use i2slam_formation::ShutterTangent;
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::View;
use i2slam_radiance::hashgrid::{
    FieldGradient, FieldRenderer, HashGridMap, MarchSettings, Ray, RayGradient, RayRender,
};
use std::ops::Range;

/// Gauss-Newton Hessian over start (ρ, φ) and end (ρ, φ) of a frame's shutter poses.
pub type ShutterHessian = [[f64; 12]; 12];

/// Least opacity of a ray that met a surface.
const MIN_OPACITY: f32 = 0.5;

/// Pixels of one frame that are compared in one step.
pub struct PixelBatch<'a> {
    /// The frame's pictures.
    pub observation: &'a Observation,
    /// Motion, exposure, white balance and response of the frame.
    pub variables: FrameVariables<'a>,
    /// Pixel indices, `row · width + column`.
    pub pixels: Vec<usize>,
}

impl PixelBatch<'_> {
    /// Times of the exposure per pixel.
    fn exposure_samples(&self) -> usize {
        self.variables.exposure.sampling.virtual_cameras.max(1)
    }

    /// Whether depth has a ray of its own. A still frame needs none; neither does estimated depth,
    /// which is not more precise than the blur and is compared at one of the `N` times, drawn at
    /// random.
    fn has_depth_ray(&self) -> bool {
        let exposure = &self.variables.exposure;
        let moving = self.exposure_samples() > 1 || exposure.readout != 0.0;
        let apart = exposure.depth_pose.is_some() || moving && !self.observation.is_estimated();
        apart && self.observation.has_depth()
    }

    /// Rays of a pixel: those of the exposure, then the one of depth.
    pub fn rays_per_pixel(&self) -> usize {
        self.exposure_samples() + usize::from(self.has_depth_ray())
    }

    /// Vignetting of the pixels; `None` for none.
    fn vignetting(&self) -> Option<Vec<f32>> {
        let all = self.variables.tone?.vignetting?;
        Some(self.pixels.iter().map(|&pixel| all[pixel]).collect())
    }

    fn depth_pose(&self) -> Pose<f64> {
        let exposure = &self.variables.exposure;
        exposure.depth_pose.unwrap_or_else(|| exposure.shutter.middle())
    }
}

/// Time of a ray.
#[derive(Clone, Copy)]
enum RayTime {
    /// From 0 = shutter open to 1 = shutter close, for radiance and for depth without a ray of its
    /// own.
    Exposure(f64),
    /// Time of the depth picture, for depth alone.
    Depth,
}

/// Renders, forms and compares batches of rays; owns the buffers.
pub struct RayObjective {
    camera: Camera<f32>,
    renderer: FieldRenderer,
    depth_outlier: f32,
    time_jitter: f64,
    ranges: Vec<Range<usize>>,
    /// Pixels of all batches of the last step.
    pixels: usize,
    rays: Vec<Ray>,
    times: Vec<RayTime>,
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
            time_jitter: 1.0,
            ranges: Vec::new(),
            pixels: 0,
            rays: Vec::new(),
            times: Vec::new(),
            renders: Vec::new(),
            cotangents: Vec::new(),
            ray_gradients: Vec::new(),
            hdr: Image::default(),
            picture: Image::default(),
            d_picture: Image::default(),
            d_hdr: Image::default(),
        }
    }

    /// Sets the standard deviations beyond which an estimated depth is an outlier, see
    /// [`map`](Self::map); 0 for none.
    pub fn set_depth_outlier(&mut self, deviations: f32) {
        self.depth_outlier = deviations;
    }

    /// Sets the share of each `N`-th of the exposure, around its middle, within which times are
    /// jittered (initially 1).
    pub fn set_time_jitter(&mut self, share: f32) {
        self.time_jitter = f64::from(share);
    }

    /// Evaluates the mean over `batches` of `w_img · mean |C - Ĉ| + w_depth · mean |d - d̂|`, over
    /// the pixels of a batch and those of them with a depth reading. Where depth has a variance v,
    /// (d - d̂)² / v, or Cauchy's function of it, takes the place of |d - d̂|. Adds the derivative
    /// by the field to `gradient`. Returns each batch's share with the derivatives by its
    /// variables; those by the poses only `with_poses`.
    pub fn map(
        &mut self,
        map: &HashGridMap,
        batches: &[PixelBatch<'_>],
        weights: (f32, f32),
        with_poses: bool,
        random: &mut Random,
        gradient: &mut FieldGradient,
    ) -> Vec<Evaluation> {
        self.create_rays(batches, random);
        self.renderer.keep_slopes(with_poses);
        self.renderer.render(&map.field, &map.occupancy, &self.rays, &mut self.renders);
        let ranges = self.ranges.clone();
        self.cotangents.clear();
        self.cotangents.resize(self.rays.len(), RayRender::default());
        let share = 1.0 / batches.len().max(1) as f32;
        let weights = (weights.0 * share, weights.1 * share);
        let compared =
            batches.iter().zip(&ranges).map(|(v, range)| self.compare(v, range, weights));
        let mut evaluations: Vec<Evaluation> = compared.collect();
        let by_rays = with_poses.then_some(&mut self.ray_gradients);
        self.renderer.pull_back(&map.field, &self.rays, &self.cotangents, Some(gradient), by_rays);
        for ((evaluation, batch), range) in evaluations.iter_mut().zip(batches).zip(&ranges) {
            if with_poses {
                evaluation.shutter = self.to_shutter(batch, range);
            }
        }
        evaluations
    }

    /// Mean number of field samples per pixel of the last step; `None` if there were none.
    pub fn samples_per_pixel(&self) -> Option<f32> {
        let (samples, pixels) = (self.renderer.samples(), self.pixels);
        (samples > 0 && pixels > 0).then(|| samples as f32 / pixels as f32)
    }

    /// Rays of the last step that met no surface.
    pub fn low_opacity_rays(&self) -> impl Iterator<Item = &Ray> {
        let met_little = |(_, render): &(&Ray, &RayRender)| render.opacity < MIN_OPACITY;
        self.rays.iter().zip(&self.renders).filter(met_little).map(|(ray, _)| ray)
    }

    /// Creates the rays of all batches.
    fn create_rays(&mut self, batches: &[PixelBatch<'_>], random: &mut Random) {
        self.rays.clear();
        self.times.clear();
        self.ranges.clear();
        self.pixels = batches.iter().map(|batch| batch.pixels.len()).sum();
        for batch in batches {
            let from = self.rays.len();
            for &pixel in &batch.pixels {
                self.create_pixel_rays(batch, pixel, random);
            }
            self.ranges.push(from..self.rays.len());
        }
    }

    fn create_pixel_rays(&mut self, batch: &PixelBatch<'_>, pixel: usize, random: &mut Random) {
        let samples = batch.exposure_samples();
        let height = self.camera.height as f64;
        let row = ((pixel / self.camera.width) as f64 + 0.5) / height - 0.5;
        let lead = batch.variables.exposure.readout * row;
        // Depth without a ray of its own is that of the last time: a random one.
        let first = if samples > 1 { random.below(samples) } else { 0 };
        for j in (0..samples).map(|j| (first + j) % samples) {
            let within =
                if samples > 1 { 0.5 + self.time_jitter * (random.uniform() - 0.5) } else { 0.5 };
            let u = (j as f64 + within) / samples as f64 + lead;
            let pose = batch.variables.exposure.shutter.at(u);
            self.push(pose, pixel, RayTime::Exposure(u), random);
        }
        if batch.has_depth_ray() {
            self.push(batch.depth_pose(), pixel, RayTime::Depth, random);
        }
    }

    fn push(&mut self, pose: Pose<f64>, pixel: usize, time: RayTime, random: &mut Random) {
        let (column, row) = (pixel % self.camera.width, pixel / self.camera.width);
        let ray = Ray::through_pixel(&self.view(pose), column, row);
        self.rays.push(Ray { offset: random.uniform() as f32, ..ray });
        self.times.push(time);
    }

    fn view(&self, pose: Pose<f64>) -> View<f32> {
        View { camera: self.camera, world_from_camera: pose.cast() }
    }

    /// Compares the pixels of a batch with the frame, and writes the cotangents of its rays.
    fn compare(
        &mut self,
        batch: &PixelBatch<'_>,
        range: &Range<usize>,
        weights: (f32, f32),
    ) -> Evaluation {
        let mut evaluation = Evaluation { pixels: batch.pixels.len(), ..Evaluation::default() };
        self.average(batch, range);
        let vignetting = batch.vignetting();
        let variables = batch.variables.with_vignetting(vignetting.as_deref());
        self.compare_pictures(batch, &variables, weights.0, &mut evaluation);
        let (hdr, d_picture) = (&self.hdr, &self.d_picture);
        variables.pull_back_tone(hdr, d_picture, &mut self.d_hdr, &mut evaluation);
        let (samples, stride) = (batch.exposure_samples(), batch.rays_per_pixel());
        let count = batch.pixels.len();
        for (i, rays) in self.cotangents[range.clone()].chunks_mut(stride).enumerate() {
            for ray in &mut rays[..samples] {
                ray.radiance = [0, 1, 2].map(|c| self.d_hdr.data[c * count + i] / samples as f32);
            }
        }
        self.compare_depth(batch, range, weights.1, &mut evaluation);
        evaluation
    }

    /// Writes the mean radiance of every pixel of a batch to `hdr`.
    fn average(&mut self, batch: &PixelBatch<'_>, range: &Range<usize>) {
        let (samples, count) = (batch.exposure_samples(), batch.pixels.len());
        self.hdr.reset(count, 1, 3);
        for (i, rays) in self.renders[range.clone()].chunks(batch.rays_per_pixel()).enumerate() {
            for c in 0..3 {
                let sum: f32 = rays[..samples].iter().map(|ray| ray.radiance[c]).sum();
                self.hdr.data[c * count + i] = sum / samples as f32;
            }
        }
    }

    fn compare_pictures(
        &mut self,
        batch: &PixelBatch<'_>,
        variables: &FrameVariables<'_>,
        weight: f32,
        evaluation: &mut Evaluation,
    ) {
        let count = batch.pixels.len();
        form_picture(variables.tone.as_ref(), &self.hdr, &mut self.picture);
        self.d_picture.reset(count, 1, 3);
        let scale = weight / (3 * count).max(1) as f32;
        let mut sum = 0.0;
        for c in 0..3 {
            let observed = batch.observation.colour.plane(c);
            for (i, &pixel) in batch.pixels.iter().enumerate() {
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

    /// Pulls the derivatives by the rays of a batch back to its shutter poses.
    fn to_shutter(&self, batch: &PixelBatch<'_>, range: &Range<usize>) -> ShutterTangent<f64> {
        let stride = batch.rays_per_pixel();
        let pixel = |ray: usize| batch.pixels[(ray - range.start) / stride];
        let each = range.clone().map(|ray| self.ray_to_shutter(batch, pixel(ray), ray));
        each.fold(ShutterTangent::zero(), ShutterTangent::plus)
    }

    /// One ray's share of the derivative by the shutter poses.
    fn ray_to_shutter(
        &self,
        batch: &PixelBatch<'_>,
        pixel: usize,
        ray: usize,
    ) -> ShutterTangent<f64> {
        let shutter = &batch.variables.exposure.shutter;
        let (column, row) = (pixel % self.camera.width, pixel / self.camera.width);
        let pull_back =
            |pose: Pose<f64>| self.ray_gradients[ray].to_pose(&self.view(pose), column, row);
        match self.times[ray] {
            RayTime::Exposure(u) => shutter.pull_back(u, pull_back(shutter.at(u))),
            RayTime::Depth => {
                let pose = batch.depth_pose();
                let d_middle = pull_back_to_middle(shutter.middle(), pose, pull_back(pose));
                shutter.pull_back(0.5, d_middle)
            }
        }
    }

    /// `JᵀJ / m` of the `m` picture values of the pixels of `batch`, with `J` their derivative by
    /// the shutter poses.
    pub fn shutter_hessian(
        &mut self,
        map: &HashGridMap,
        batch: &PixelBatch<'_>,
        random: &mut Random,
    ) -> ShutterHessian {
        self.create_rays(std::slice::from_ref(batch), random);
        self.renderer.keep_slopes(true);
        self.renderer.render(&map.field, &map.occupancy, &self.rays, &mut self.renders);
        self.average(batch, &(0..self.rays.len()));
        self.picture_slopes(batch);
        let mut hessian = [[0.0; 12]; 12];
        for channel in 0..3 {
            self.set_cotangents(batch, channel);
            let by_rays = Some(&mut self.ray_gradients);
            self.renderer.pull_back(&map.field, &self.rays, &self.cotangents, None, by_rays);
            for i in 0..batch.pixels.len() {
                let row = self.jacobian_row(batch, i);
                for (entries, a) in hessian.iter_mut().zip(row) {
                    entries.iter_mut().zip(row).for_each(|(entry, b)| *entry += a * b);
                }
            }
        }
        let values = (3 * batch.pixels.len()).max(1) as f64;
        hessian.map(|row| row.map(|entry| entry / values))
    }

    /// Writes the derivative of every picture value by its radiance to `d_hdr`; channels do not
    /// mix.
    fn picture_slopes(&mut self, batch: &PixelBatch<'_>) {
        self.d_picture.reset(batch.pixels.len(), 1, 3);
        self.d_picture.data.fill(1.0);
        let vignetting = batch.vignetting();
        let variables = batch.variables.with_vignetting(vignetting.as_deref());
        let (hdr, d_picture, unused) = (&self.hdr, &self.d_picture, &mut Evaluation::default());
        variables.pull_back_tone(hdr, d_picture, &mut self.d_hdr, unused);
    }

    /// Sets the cotangents that select one channel of every pixel.
    fn set_cotangents(&mut self, batch: &PixelBatch<'_>, channel: usize) {
        let (samples, stride) = (batch.exposure_samples(), batch.rays_per_pixel());
        let slopes = self.d_hdr.plane(channel);
        self.cotangents.clear();
        self.cotangents.resize(self.rays.len(), RayRender::default());
        for (rays, slope) in self.cotangents.chunks_mut(stride).zip(slopes) {
            rays[..samples].iter_mut().for_each(|r| r.radiance[channel] = slope / samples as f32);
        }
    }

    /// The derivative of one picture value by the shutter poses.
    fn jacobian_row(&self, batch: &PixelBatch<'_>, i: usize) -> [f64; 12] {
        let stride = batch.rays_per_pixel();
        let rays = i * stride..(i + 1) * stride;
        let each = rays.map(|ray| self.ray_to_shutter(batch, batch.pixels[i], ray));
        each.fold(ShutterTangent::zero(), ShutterTangent::plus).to_array()
    }
}

#[cfg(test)]
mod tests;

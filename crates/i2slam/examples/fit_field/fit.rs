//! Training on true poses: random pixels of all frames, mean square error of pictures.

use crate::Arguments;
use crate::frames::Frames;
use i2slam::geometry::Image;
use i2slam::radiance::hashgrid::*;
use i2slam::radiance::{Render, View};
use i2slam_check::processor_seconds;
use i2slam_compute::Random;
use std::error::Error;
use std::time::Instant;

/// Occupancy cells along an edge of the cube.
const CELLS: u32 = 128;
/// Half thickness of the shell around a surface, as a share of its depth.
const SHELL: f32 = 0.03;
/// Sample spacing as a share of the distance from the camera.
const CONE: f32 = 1.0 / 128.0;
/// Least sample spacing [m].
const STEP_MIN: f32 = 0.005;
/// Cell size of the finest grid [m].
const FINEST: f64 = 0.005;
/// Learning rate at the start; it falls tenfold.
const RATE: f32 = 1e-2;
/// Least `exposure · radiance` of which a picture tells anything.
const DARK: f32 = 1e-4;

pub(crate) fn print(frames: &Frames, arguments: &Arguments) -> Result<(), Box<dyn Error>> {
    let mut map = untrained(frames, arguments)?;
    let mut trainer = Trainer::new(frames, &map, arguments);
    let (mut times, mut samples) = (Vec::new(), 0);
    let before = processor_seconds();
    for step in 0..arguments.steps {
        let clock = Instant::now();
        let rate = decayed_rate(RATE, step as i32, arguments.steps as i32);
        samples += trainer.step(&mut map, arguments.rays, rate);
        times.push(clock.elapsed().as_secs_f64());
    }
    let processor = processor_seconds() - before;
    times.sort_by(f64::total_cmp);
    let [fastest, median] = [0, times.len() / 2].map(|i| 1e3 * times.get(i).unwrap_or(&0.0));
    let psnr = held_out(frames, map);
    let steps = arguments.steps.max(1);
    println!(
        "i2slam: {} steps of {} rays, {} samples; a step {fastest:.1} ms fastest, {median:.1} ms \
         median, {:.1} ms of the processor; held out {psnr:.2} dB",
        arguments.steps,
        arguments.rays,
        samples / steps,
        1e3 * processor / steps as f64
    );
    Ok(())
}

/// A field in the cube of all surfaces of the training frames, sampled around them.
fn untrained(frames: &Frames, arguments: &Arguments) -> Result<HashGridMap, SettingsError> {
    let (mut low, mut high) = ([f64::MAX; 3], [f64::MIN; 3]);
    for &frame in &frames.training() {
        for (ray, depth) in rays_with_depth(frames, frame) {
            let p = (ray.origin + ray.direction * depth).to_array().map(f64::from);
            for k in 0..3 {
                (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
            }
        }
    }
    let edge = (0..3).fold(0.0_f64, |edge, k| edge.max(high[k] - low[k]));
    let bound = 0.51 * edge;
    let cube = FieldSettings::cube([0, 1, 2].map(|k| 0.5 * (low[k] + high[k])), bound);
    let finest_resolution = (2.0 * bound / FINEST) as u32;
    let settings = FieldSettings { log2_table: arguments.log2_table, finest_resolution, ..cube };
    let field = HashGridField::new(settings, arguments.seed)?;
    let looks = OccupancySettings { resolution: CELLS, ..OccupancySettings::default() };
    let mut occupancy = Occupancy::empty(looks);
    for &frame in &frames.training() {
        for (ray, depth) in rays_with_depth(frames, frame) {
            occupancy.mark_cells(&field, &ray, depth * (1.0 - SHELL), depth * (1.0 + SHELL));
        }
    }
    let march = MarchSettings { step_min: STEP_MIN, cone: CONE, ..MarchSettings::cube(bound) };
    Ok(HashGridMap { field, occupancy, march: MarchSettings { steps_max: 1 << 14, ..march } })
}

fn view(frames: &Frames, frame: usize) -> View<f32> {
    View { camera: frames.camera.cast(), world_from_camera: frames.poses[frame].cast() }
}

fn rays_with_depth(frames: &Frames, frame: usize) -> impl Iterator<Item = (Ray, f32)> + '_ {
    let (view, depth) = (view(frames, frame), &frames.frames[frame].depth);
    let seen = depth.data.iter().enumerate().filter(|(_, depth)| **depth > 0.0);
    seen.map(move |(p, &d)| (Ray::through_pixel(&view, p % depth.width, p / depth.width), d))
}

/// `((t H) / (t H + 1))^(1/2.2)` of `x = t H`, and its slope.
fn formed(x: f32) -> (f32, f32) {
    let kept = x.max(DARK);
    let value = (kept / (1.0 + kept)).powf(1.0 / 2.2);
    (value, if x > DARK { value / (2.2 * kept * (1.0 + kept)) } else { 0.0 })
}

/// State of training.
struct Trainer<'a> {
    frames: &'a Frames,
    training: Vec<usize>,
    views: Vec<View<f32>>,
    renderer: FieldRenderer,
    gradient: FieldGradient,
    adam: FieldAdam,
    random: Random,
    renders: Vec<RayRender>,
}

impl<'a> Trainer<'a> {
    fn new(frames: &'a Frames, map: &HashGridMap, arguments: &Arguments) -> Self {
        Self {
            frames,
            training: frames.training(),
            views: (0..frames.frames.len()).map(|frame| view(frames, frame)).collect(),
            renderer: FieldRenderer::new(map.march),
            gradient: FieldGradient::zeros(&map.field),
            adam: FieldAdam::new(),
            random: Random::new(arguments.seed ^ 0x5eed),
            renders: Vec::new(),
        }
    }

    /// One step on `count` pixels; the number of samples.
    fn step(&mut self, map: &mut HashGridMap, count: usize, rate: f32) -> usize {
        let (width, height) = (self.frames.camera.width, self.frames.camera.height);
        let random = &mut self.random;
        let mut draw = |_| {
            let frame = self.training[random.below(self.training.len())];
            let (column, row) = (random.below(width), random.below(height));
            let ray = Ray::through_pixel(&self.views[frame], column, row);
            (Ray { offset: random.uniform() as f32, ..ray }, (frame, column, row))
        };
        let (rays, pixels): (Vec<_>, Vec<_>) = (0..count).map(&mut draw).unzip();
        self.renderer.render(&map.field, &map.occupancy, &rays, &mut self.renders);
        let samples = self.renderer.samples();
        let scale = 2.0 / (3 * count) as f32;
        let cotangent = |(render, &(frame, column, row)): (&RayRender, &(usize, usize, usize))| {
            let exposure = self.frames.exposures[frame];
            let radiance = [0, 1, 2].map(|c| {
                let (shown, slope) = formed(exposure * render.radiance[c]);
                let truth = self.frames.frames[frame].colour.at(c, column, row);
                scale * (shown - truth) * slope * exposure
            });
            RayRender { radiance, ..RayRender::default() }
        };
        let cotangents: Vec<_> = self.renders.iter().zip(&pixels).map(cotangent).collect();
        let gradient = &mut self.gradient;
        self.renderer.pull_back(&map.field, &rays, &cotangents, Some(gradient), None);
        self.adam.step(&mut map.field, gradient, rate);
        samples
    }
}

fn held_out(frames: &Frames, map: HashGridMap) -> f64 {
    let (mut renderer, mut render) = (FieldRenderer::new(map.march), Render::default());
    frames.held_out(|frame| {
        renderer.render_view(&map.field, &map.occupancy, &view(frames, frame), &mut render);
        let mut shown: Image<f32> = render.radiance.clone();
        shown.data.iter_mut().for_each(|v| *v = formed(*v * frames.exposures[frame]).0);
        shown
    })
}

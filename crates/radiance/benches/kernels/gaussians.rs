//! The Gaussian rasteriser: time by stage, by size of the problem, and memory.
//!
//! The case of the stages is 320 x 240 and 50 000 Gaussians of four pixels radius.

use super::counts::{self, Count};
use super::{fastest, machine, on_threads};
use i2slam_compute::{Adam, AdamSettings};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::RadianceMap;
use i2slam_radiance::gaussian::{
    ColourActivation, Gaussian, GaussianMap, MapGradient, Rasterizer, Render, RenderCotangent,
    Shape, StageSeconds, View, Work,
};
use std::hint::black_box;

const COUNT: usize = 50_000;
const SIZE: (usize, usize) = (320, 240);

/// A map with everything that one step needs.
pub(crate) struct Step {
    pub(crate) map: GaussianMap,
    pub(crate) view: View<f32>,
    cotangent: RenderCotangent,
    pub(crate) rasterizer: Rasterizer,
    out: Render,
    gradient: MapGradient,
    adam: [Adam; 4],
    ages: Vec<u32>,
}

impl Step {
    pub(crate) fn new(count: usize, (width, height): (usize, usize)) -> Self {
        let view = view(width, height);
        let map = map(count, &view);
        Self {
            gradient: MapGradient::new(&map),
            map,
            view,
            cotangent: cotangent(&view),
            rasterizer: Rasterizer::default(),
            out: Render::default(),
            adam: std::array::from_fn(|_| Adam::new(AdamSettings::default())),
            ages: vec![0; count],
        }
    }

    pub(crate) fn forward(&mut self) {
        self.map.render(&mut self.rasterizer, &self.view, &mut self.out);
    }

    /// To all parameters of the map and to the pose.
    pub(crate) fn backward(&mut self) {
        let gradient = Some(&mut self.gradient);
        let Self { rasterizer, map, view, cotangent, .. } = self;
        black_box(map.pull_back(rasterizer, view, cotangent, gradient));
    }

    /// Means, colours, opacities and scales take a step, so short that the scene stays.
    pub(crate) fn adam(&mut self) {
        self.ages.iter_mut().for_each(|age| *age += 1);
        let (map, gradient, rate) = (&mut self.map, &self.gradient, 1e-12);
        let groups = [
            (map.means.as_flattened_mut(), gradient.means.as_flattened(), 3),
            (map.colours.as_flattened_mut(), gradient.colours.as_flattened(), 3),
            (map.opacity_logits.as_mut_slice(), gradient.opacity_logits.as_slice(), 1),
            (map.log_scales.as_flattened_mut(), gradient.log_scales.as_flattened(), 3),
        ];
        for (adam, (values, gradient, width)) in self.adam.iter_mut().zip(groups) {
            adam.step_elements(values, gradient, |_| rate, width, &self.ages);
        }
    }

    /// The fastest times of all stages over some rounds.
    fn stages(&mut self, rounds: usize, least: f64) -> [Stage; 6] {
        let mut best: Option<[Stage; 6]> = None;
        fastest(rounds, least, || {
            self.forward();
            self.backward();
            let now = named(&self.rasterizer.stage_seconds());
            let best = best.get_or_insert(now);
            best.iter_mut().zip(now).for_each(|(best, now)| best.1 = best.1.min(now.1));
        });
        best.unwrap_or_else(|| named(&self.rasterizer.stage_seconds()))
    }
}

/// Name, time, and what counts the work of a stage.
type Stage = (&'static str, f64, fn(&Work) -> Count);

fn named(seconds: &StageSeconds) -> [Stage; 6] {
    [
        ("projection", seconds.project, counts::project),
        ("sorting", seconds.sort, counts::sort),
        ("binning", seconds.bin, counts::bin),
        ("forward", seconds.blend + seconds.copy_out, counts::blend),
        ("backward", seconds.blend_back, counts::blend_back),
        ("projection backward", seconds.project_back, counts::project_back),
    ]
}

/// Time, operations, bytes and share of the machine's limits, per stage, on all threads.
pub(crate) fn print_stages() {
    let threads = rayon::current_num_threads();
    let (peak, bandwidth) = (machine::flops(threads), machine::bandwidth(threads).0);
    let mut step = Step::new(COUNT, SIZE);
    let stages = step.stages(100, 3.0);
    let work = step.rasterizer.work();
    println!("# work\ngaussians,visible,pairs,visited,rows,tiles");
    println!(
        "{},{},{},{},{},{}",
        work.gaussians, work.visible, work.pairs, work.visited, work.rows, work.tiles
    );
    println!(
        "# stages\nstage,ms,mflop,mb,flop_per_byte,share_of_peak,share_of_bandwidth,share_of_roof"
    );
    for (name, seconds, count) in stages {
        let Count { operations, bytes } = count(&work);
        let roof = (operations / peak).max(bytes / bandwidth);
        println!(
            "{name},{:.3},{:.1},{:.2},{:.1},{:.3},{:.3},{:.3}",
            seconds * 1e3,
            operations / 1e6,
            bytes / 1e6,
            operations / bytes,
            operations / peak / seconds,
            bytes / bandwidth / seconds,
            roof / seconds
        );
        println!("time,stages/{name},{seconds:.6e}");
    }
}

/// Forward, backward and Adam on one thread, and on all.
pub(crate) fn print_step() {
    println!("threads,forward_ms,backward_ms,adam_ms,step_ms");
    for threads in [1, rayon::current_num_threads()] {
        let times = on_threads(threads, || {
            let mut step = Step::new(COUNT, SIZE);
            let mut best = [f64::MAX; 4];
            fastest(60, 3.0, || {
                let parts: [fn(&mut Step); 3] = [Step::forward, Step::backward, Step::adam];
                let mut whole = 0.0;
                for (best, part) in best.iter_mut().zip(parts) {
                    let seconds = fastest(1, 0.0, || part(&mut step));
                    (*best, whole) = (best.min(seconds), whole + seconds);
                }
                best[3] = best[3].min(whole);
            });
            best
        });
        let Some([forward, backward, adam, step]) = times.map(|t| t.map(|t| t * 1e3)) else {
            continue;
        };
        println!("{threads},{forward:.3},{backward:.3},{adam:.3},{step:.3}");
        println!("time,step/{threads} threads,{:.6e}", step * 1e-3);
    }
}

/// A picture of `width x height` with a horizontal field of view of 63 degrees.
pub(crate) fn view(width: usize, height: usize) -> View<f32> {
    let (w, h) = (width as f32, height as f32);
    let focal = 0.8125 * w;
    let camera = Camera { width, height, fx: focal, fy: focal, cx: 0.5 * w, cy: 0.5 * h };
    View { camera, world_from_camera: Pose::identity() }
}

/// Numbers in 0 to 1 (Knuth's linear congruence, upper bits).
fn noise(seed: u64) -> impl FnMut() -> f32 {
    let mut state = seed;
    move || {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1 << 24) as f32
    }
}

/// `count` balls all over the picture at depths of 1 to 4 m, with a standard deviation of 1.33 px
/// in the image and an opacity of 0.36.
pub(crate) fn map(count: usize, view: &View<f32>) -> GaussianMap {
    let (camera, mut noise) = (view.camera, noise(3));
    let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
    for _ in 0..count {
        let z = 1.0 + 3.0 * noise();
        let (u, v) = (noise() * camera.width as f32, noise() * camera.height as f32);
        let sigma = (1.33_f32 * 1.33 - 0.3).sqrt() * z / camera.fx;
        map.push(Gaussian {
            mean: camera.unproject(u, v, z).to_array(),
            log_scale: [sigma.ln(); 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity_logit: -0.58,
            colour: [-noise(), -noise(), -noise()],
        });
    }
    map
}

/// A cotangent of noise for every plane.
pub(crate) fn cotangent(view: &View<f32>) -> RenderCotangent {
    let (width, height, mut noise) = (view.camera.width, view.camera.height, noise(5));
    let mut image = |channels: usize| {
        let data = (0..width * height * channels).map(|_| noise() - 0.5).collect();
        Image { width, height, channels, data }
    };
    RenderCotangent { radiance: image(3), depth: image(1), opacity: image(1) }
}

const SIZE_COUNTS: [usize; 4] = [10_000, 100_000, 1_000_000, 5_000_000];
const SIZES: [(usize, usize); 4] = [(160, 120), (320, 240), (640, 480), (1280, 960)];

/// Forward and backward of every number of Gaussians at every size of the picture.
pub(crate) fn print_sizes() {
    println!("gaussians,width,height,pairs,visited,rows,forward_ms,backward_ms");
    for count in SIZE_COUNTS {
        for size in SIZES {
            let mut step = Step::new(count, size);
            let (mut forward, mut backward) = (f64::MAX, f64::MAX);
            fastest(3, 0.7, || {
                forward = forward.min(fastest(1, 0.0, || step.forward()));
                backward = backward.min(fastest(1, 0.0, || step.backward()));
            });
            let work = step.rasterizer.work();
            println!(
                "{count},{},{},{},{},{},{:.3},{:.3}",
                size.0,
                size.1,
                work.pairs,
                work.visited,
                work.rows,
                forward * 1e3,
                backward * 1e3
            );
        }
    }
}

const MEMORY_COUNTS: [usize; 4] = [100_000, 300_000, 500_000, 700_000];

/// Bytes per Gaussian of the map: 14 numbers.
const MAP: usize = 14 * 4;
/// Of its gradient: as many, and whether it was seen.
const GRADIENT: usize = 14 * 4 + 1;
/// Of Adam's two moments of means, colours, opacities and scales, and its age.
const ADAM: usize = 2 * 10 * 4 + 4;
/// Of the footprint.
const FOOTPRINT: usize = 64;
/// Of a visible one: its item, sorted, and both buffers of the sort.
const ITEM: usize = 8 + 8 + 2 * 8;
/// Of a pair with a tile: entry, place, sums of the backward pass.
const PAIR: usize = 8 + 4 + 44;

/// Most resident memory of this process so far [bytes].
fn peak() -> Option<usize> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    line.split_whitespace().nth(1)?.parse::<usize>().ok().map(|kib| kib * 1024)
}

/// Expected bytes of a number of Gaussians, and growth of the process's peak from one number to the
/// next. Needs a process of its own: the peak never falls.
pub(crate) fn print_memory() {
    println!("# bytes\npart,bytes");
    println!("map,{MAP}\ngradient,{GRADIENT}\nadam,{ADAM}\nfootprint,{FOOTPRINT}");
    println!("visible,{ITEM}\npair,{PAIR}");
    println!("# memory\ngaussians,pairs,counted_bytes,peak_bytes,counted_slope,measured_slope");
    let mut last: Option<(usize, usize, usize)> = None;
    for count in MEMORY_COUNTS {
        let mut step = Step::new(count, SIZE);
        step.forward();
        step.backward();
        step.adam();
        let work = step.rasterizer.work();
        let each = MAP + GRADIENT + ADAM + FOOTPRINT;
        let counted = each * count + ITEM * work.visible + PAIR * work.pairs;
        let Some(peak) = peak() else { return };
        let slope = |before: usize, now: usize, by: usize| (now - before) as f64 / by as f64;
        match last {
            Some((n, c, p)) => println!(
                "{count},{},{counted},{peak},{:.0},{:.0}",
                work.pairs,
                slope(c, counted, count - n),
                slope(p, peak, count - n)
            ),
            None => println!("{count},{},{counted},{peak},,", work.pairs),
        }
        last = Some((count, counted, peak));
    }
}

//! One sharp render of 320 x 240 re-projected to the virtual cameras of an exposure, and back.

use divan::{Bencher, black_box};
use i2slam_formation::reproject::Reprojection;
use i2slam_formation::{Quadrature, ShutterPoses};
use i2slam_geometry::{Camera, Image, Pose, Tangent};

const CAMERA: Camera<f32> =
    Camera { width: 320, height: 240, fx: 290.0, fy: 290.0, cx: 160.0, cy: 120.0 };

fn main() {
    divan::main();
}

fn noise(channels: usize) -> Image<f32> {
    let mut image = Image::new(CAMERA.width, CAMERA.height, channels);
    let mut state = 1_u32;
    for v in &mut image.data {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *v = (state >> 8) as f32 / (1 << 24) as f32;
    }
    image
}

/// A bumpy wall two metres away with a board of a ninth of the picture at 1.3 m.
fn depth() -> Image<f32> {
    let mut depth = noise(1);
    for (i, z) in depth.data.iter_mut().enumerate() {
        let (x, y) = (i % CAMERA.width, i / CAMERA.width);
        let board = (100..207).contains(&x) && (80..160).contains(&y);
        *z = if board { 1.3 } else { 1.8 + 0.002 * x as f32 } + 0.002 * *z;
    }
    depth
}

/// About ten pixels of blur, half of it by parallax.
fn shutter() -> ShutterPoses<f64> {
    let half = Tangent::from_array([0.016, -0.008, 0.004, 0.004, 0.007, 0.004]);
    let middle = Pose::identity();
    ShutterPoses { start: middle.retract(half.scaled(-1.0)), end: middle.retract(half) }
}

struct Frame {
    reprojection: Reprojection,
    radiance: Image<f32>,
    depth: Image<f32>,
    blurred: Image<f32>,
    d_radiance: Image<f32>,
}

impl Frame {
    fn new() -> Self {
        Self {
            reprojection: Reprojection::default(),
            radiance: noise(3),
            depth: depth(),
            blurred: Image::default(),
            d_radiance: Image::default(),
        }
    }

    fn blur(&mut self, views: usize) {
        self.reprojection.blur(
            &CAMERA,
            black_box(&shutter()),
            0.0,
            views,
            Quadrature::Midpoints,
            &self.radiance,
            &self.depth,
            &mut self.blurred,
        );
    }

    fn pull_back(&mut self) {
        let d_blurred = black_box(&self.radiance);
        black_box(self.reprojection.pull_back(d_blurred, &mut self.d_radiance));
    }
}

/// Runs `work` on a pool of its own: entering it is part of the time, about 10 µs.
fn on_threads(bencher: Bencher<'_, '_>, threads: usize, mut work: impl FnMut() + Send) {
    match rayon::ThreadPoolBuilder::new().num_threads(threads).build() {
        Ok(pool) => bencher.bench_local(|| pool.install(&mut work)),
        Err(error) => eprintln!("no thread pool: {error}"),
    }
}

#[divan::bench(args = [5, 9, 17])]
fn forward_one_thread(bencher: Bencher<'_, '_>, views: usize) {
    let mut frame = Frame::new();
    on_threads(bencher, 1, || frame.blur(views));
}

#[divan::bench(args = [5, 9, 17])]
fn backward_one_thread(bencher: Bencher<'_, '_>, views: usize) {
    let mut frame = Frame::new();
    frame.blur(views);
    on_threads(bencher, 1, || frame.pull_back());
}

#[divan::bench(args = [1, 2])]
fn both_ways_five_views(bencher: Bencher<'_, '_>, threads: usize) {
    let mut frame = Frame::new();
    on_threads(bencher, threads, || {
        frame.blur(5);
        frame.pull_back();
    });
}

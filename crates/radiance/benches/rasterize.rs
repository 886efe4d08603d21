//! Time of one picture, forward and backward: 320x240, 50 000 Gaussians of 4 px radius
//! (standard deviation 1.33 px in the image, opacity about 0.36), about 103 000 pairs of a
//! Gaussian and a tile, and no pixel that ends early.
//!
//! `textbook_*` is the reference lane in `f32` on one thread, called tile by tile with the
//! Gaussians of each tile: the same sums without vectors, threads or row culling. Its lists are
//! made outside of the measured time.

use divan::{Bencher, black_box};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_radiance::gaussian::*;

const WIDTH: usize = 320;
const HEIGHT: usize = 240;
const TILE: usize = 16;
const RADIUS: f32 = 5.0;

fn main() {
    for opacity in OPACITIES {
        let mut rasterizer = Rasterizer::default();
        rasterizer.render(&scene(Shape::Isotropic, opacity), &view(), &mut Render::default());
        println!("{opacity}: {} pairs of a Gaussian and a tile", rasterizer.intersections());
    }
    divan::main();
}

/// The scenes: how opaque the Gaussians are decides whether pixels end early.
const OPACITIES: [&str; 2] = ["translucent", "opaque"];

fn noise(seed: u64) -> impl FnMut() -> f32 {
    let mut numbers = i2slam_check::noise(seed, 1 << 20).into_iter().cycle();
    move || 0.5 + 0.5 * numbers.next().unwrap_or(0.0) as f32
}

fn view() -> View<f32> {
    let camera =
        Camera { width: WIDTH, height: HEIGHT, fx: 260.0, fy: 260.0, cx: 160.0, cy: 120.0 };
    View { camera, world_from_camera: Pose::identity() }
}

fn scene(shape: Shape, opacity: &str) -> GaussianMap {
    let (camera, mut noise) = (view().camera, noise(3));
    let mut map = GaussianMap::new(shape, ColourActivation::Exponential);
    let logit = if opacity == "opaque" { 2.0 } else { -0.58 };
    for _ in 0..50_000 {
        let z = 1.0 + 3.0 * noise();
        let p = camera.unproject(noise() * WIDTH as f32, noise() * HEIGHT as f32, z);
        let sigma = (1.33_f32 * 1.33 - 0.3).sqrt() * z / camera.fx;
        map.push(Gaussian {
            mean: p.to_array(),
            log_scale: [sigma.ln(); 3],
            rotation: [1.0, noise(), noise(), noise()],
            opacity_logit: logit,
            colour: [-noise(), -noise(), -noise()],
        });
    }
    map
}

fn cotangent(width: usize, height: usize) -> RenderCotangent {
    let mut noise = noise(5);
    let mut image = |channels: usize| Image {
        width,
        height,
        channels,
        data: (0..width * height * channels).map(|_| noise() - 0.5).collect(),
    };
    RenderCotangent { radiance: image(3), depth: image(1), opacity: image(1) }
}

#[divan::bench(args = OPACITIES)]
fn forward(bencher: Bencher<'_, '_>, opacity: &str) {
    let (map, view) = (scene(Shape::Isotropic, opacity), view());
    let (mut rasterizer, mut out) = (Rasterizer::default(), Render::default());
    bencher.bench_local(|| rasterizer.render(black_box(&map), &view, &mut out));
}

#[divan::bench(args = OPACITIES)]
fn forward_anisotropic(bencher: Bencher<'_, '_>, opacity: &str) {
    let (map, view) = (scene(Shape::Anisotropic, opacity), view());
    let (mut rasterizer, mut out) = (Rasterizer::default(), Render::default());
    bencher.bench_local(|| rasterizer.render(black_box(&map), &view, &mut out));
}

fn backward(bencher: Bencher<'_, '_>, map: &GaussianMap, with_map: bool) {
    let (view, cotangent) = (view(), cotangent(WIDTH, HEIGHT));
    let mut rasterizer = Rasterizer::default();
    rasterizer.render(map, &view, &mut Render::default());
    let mut gradient = MapGradient::new(map.len());
    bencher.bench_local(|| {
        let gradient = with_map.then_some(&mut gradient);
        rasterizer.pull_back(black_box(map), &view, &cotangent, gradient)
    });
}

#[divan::bench(args = OPACITIES)]
fn backward_pose_and_map(bencher: Bencher<'_, '_>, opacity: &str) {
    backward(bencher, &scene(Shape::Isotropic, opacity), true);
}

#[divan::bench(args = OPACITIES)]
fn backward_pose_and_map_anisotropic(bencher: Bencher<'_, '_>, opacity: &str) {
    backward(bencher, &scene(Shape::Anisotropic, opacity), true);
}

#[divan::bench(args = OPACITIES)]
fn backward_pose(bencher: Bencher<'_, '_>, opacity: &str) {
    backward(bencher, &scene(Shape::Isotropic, opacity), false);
}

/// The view and the Gaussians of every tile.
fn tiles(map: &GaussianMap) -> Vec<(View<f32>, GaussianMap)> {
    let mut tiles = Vec::new();
    for (row, column) in (0..HEIGHT / TILE).flat_map(|r| (0..WIDTH / TILE).map(move |c| (r, c))) {
        let mut view = view();
        let (x, y) = ((column * TILE) as f32, (row * TILE) as f32);
        view.camera = Camera { width: TILE, height: TILE, ..view.camera };
        (view.camera.cx, view.camera.cy) = (view.camera.cx - x, view.camera.cy - y);
        let mut part = GaussianMap::new(map.shape, map.activation);
        for g in map.iter() {
            let [u, v] = [0, 1].map(|k| g.mean[k] / g.mean[2] * view.camera.fx);
            let (u, v) = (u + view.camera.cx, v + view.camera.cy);
            let near = |c: f32| c > -RADIUS && c < TILE as f32 + RADIUS;
            if near(u) && near(v) {
                part.push(g);
            }
        }
        tiles.push((view, part));
    }
    tiles
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn textbook_forward(bencher: Bencher<'_, '_>) {
    let tiles = tiles(&scene(Shape::Isotropic, "translucent"));
    let settings = RasterSettings::default();
    bencher.bench_local(|| {
        for (view, map) in &tiles {
            black_box(reference::render(map, view, &settings));
        }
    });
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn textbook_backward_pose_and_map(bencher: Bencher<'_, '_>) {
    let tiles = tiles(&scene(Shape::Isotropic, "translucent"));
    let (settings, cotangent) = (RasterSettings::default(), cotangent(TILE, TILE));
    bencher.bench_local(|| {
        for (view, map) in &tiles {
            let mut gradient = MapGradient::new(map.len());
            let gradient = Some(&mut gradient);
            black_box(reference::pull_back(map, view, &settings, &cotangent, gradient));
        }
    });
}

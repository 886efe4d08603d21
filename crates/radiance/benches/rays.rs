//! Time of a training batch of the hash-grid field at its full size (16 levels of 2 features,
//! tables of 2¹⁹, networks of 64 units): 4096 rays drawn from all over a room, sampled in the
//! cells around its walls.
//!
//! Before that it prints the fastest time of each part of a training step, taken in turns within
//! one run, with samples per second and the share of operations per second that the products of
//! the networks alone amount to.
//!
//! `textbook_*` is the reference lane in `f32` on one thread for a sixteenth of the rays.

use divan::{Bencher, black_box};
use i2slam_geometry::Vec3;
use i2slam_radiance::hashgrid::*;
use std::time::Instant;

/// Half edge of the cube, and of the room within \[m\].
const BOUND: f64 = 2.0;
const WALL: f64 = 1.8;
const RAYS: usize = 4096;

fn main() {
    print_parts();
    divan::main();
}

/// Numbers that repeat.
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut numbers = i2slam_check::noise(seed, 1 << 20).into_iter().cycle();
    move || numbers.next().unwrap_or(0.0)
}

fn march() -> MarchSettings {
    MarchSettings::cube(BOUND)
}

/// A room: opaque cells along the walls, some density within them.
fn scene() -> (HashGridField, Occupancy) {
    let settings = FieldSettings::cube([0.0; 3], BOUND);
    let mut field = HashGridField::new(settings, 1).expect("settings in range");
    let mut noise = noise(5);
    let [table, density, _] = field.parameters_mut();
    table.iter_mut().for_each(|v| *v = noise() as f32);
    density.iter_mut().for_each(|v| *v *= 2.0);
    let settings = OccupancySettings::default();
    let shell = |p: Vec3<f32>| {
        let farthest = p.to_array().iter().fold(0.0_f32, |far, v| far.max(v.abs()));
        (f64::from(farthest) - WALL).abs() < 0.15
    };
    (field, Occupancy::of_cells([0.0; 3], BOUND, settings, shell))
}

fn rays() -> Vec<Ray> {
    let mut noise = noise(3);
    let mut vector = |size: f64| Vec3::new(noise() * size, noise() * size, noise() * size);
    let ray = |_| {
        let (origin, direction) = (vector(0.5).cast(), vector(1.0).cast());
        Ray { origin, direction, offset: 0.5 }
    };
    (0..RAYS).map(ray).collect()
}

fn cotangents() -> Vec<RayRender> {
    let mut noise = noise(7);
    let mut one = || noise() as f32 / RAYS as f32;
    let mut cotangent =
        |_| RayRender { radiance: [one(), one(), one()], depth: one(), opacity: one() };
    (0..RAYS).map(&mut cotangent).collect()
}

/// Multiplications of the networks for one sample, forward.
fn products(settings: &FieldSettings) -> usize {
    let (width, geometry) = (settings.hidden_width, settings.geometry_features);
    let encoded = settings.levels * settings.features;
    encoded * width + width * (1 + geometry) + (16 + geometry + width + 3) * width
}

fn print_parts() {
    const ROUNDS: usize = 12;
    let ((mut field, occupancy), rays, cotangents) = (scene(), rays(), cotangents());
    let (mut renderer, mut renders) = (FieldRenderer::new(march()), Vec::new());
    let (mut gradient, mut by_rays) = (FieldGradient::zeros(&field), Vec::new());
    let mut adam = FieldAdam::new();
    let mut fastest = [f64::MAX; 5];
    for _ in 0..ROUNDS {
        let mut time = |part: usize, work: &mut dyn FnMut()| {
            let start = Instant::now();
            work();
            fastest[part] = fastest[part].min(start.elapsed().as_secs_f64() * 1e3);
        };
        renderer.keep_slopes(false);
        time(4, &mut || renderer.render(&field, &occupancy, &rays, &mut renders));
        renderer.keep_slopes(true);
        time(0, &mut || renderer.render(&field, &occupancy, &rays, &mut renders));
        time(1, &mut || {
            renderer.pull_back(&field, &rays, &cotangents, None, Some(&mut by_rays));
        });
        time(2, &mut || {
            let wanted = (Some(&mut gradient), Some(&mut by_rays));
            renderer.pull_back(&field, &rays, &cotangents, wanted.0, wanted.1);
        });
        time(3, &mut || adam.step(&mut field, &mut gradient, 0.0));
    }
    let samples = renderer.samples();
    println!("{RAYS} rays, {samples} samples");
    let names = [
        "forward",
        "backward, rays alone",
        "backward, field and rays",
        "Adam",
        "forward, without slopes",
    ];
    for (name, time) in names.iter().zip(fastest) {
        println!("{name}: {time:.1} ms, {:.2} million samples/s", samples as f64 / time / 1e3);
    }
    let operations = 2.0 * (samples * products(field.settings())) as f64 * 4.0;
    let both = fastest[0] + fastest[2];
    println!(
        "forward and backward: {both:.1} ms, {:.0} rays/s, {:.1} Gflop/s in the networks",
        RAYS as f64 / both * 1e3,
        operations / both / 1e6
    );
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn forward(bencher: Bencher<'_, '_>) {
    let ((field, occupancy), rays) = (scene(), rays());
    let (mut renderer, mut renders) = (FieldRenderer::new(march()), Vec::new());
    bencher.bench_local(|| renderer.render(black_box(&field), &occupancy, &rays, &mut renders));
}

fn backward(bencher: Bencher<'_, '_>, with_field: bool, with_rays: bool) {
    let ((field, occupancy), rays, cotangents) = (scene(), rays(), cotangents());
    let (mut renderer, mut by_rays) = (FieldRenderer::new(march()), Vec::new());
    renderer.keep_slopes(with_rays);
    renderer.render(&field, &occupancy, &rays, &mut Vec::new());
    let mut gradient = FieldGradient::zeros(&field);
    bencher.bench_local(|| {
        let gradient = with_field.then_some(&mut gradient);
        let by_rays = with_rays.then_some(&mut by_rays);
        renderer.pull_back(black_box(&field), &rays, &cotangents, gradient, by_rays);
    });
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn backward_field(bencher: Bencher<'_, '_>) {
    backward(bencher, true, false);
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn backward_rays(bencher: Bencher<'_, '_>) {
    backward(bencher, false, true);
}

#[divan::bench(sample_count = 20, sample_size = 1)]
fn backward_field_and_rays(bencher: Bencher<'_, '_>) {
    backward(bencher, true, true);
}

#[divan::bench(sample_count = 3, sample_size = 1)]
fn textbook_forward_and_backward_of_a_sixteenth(bencher: Bencher<'_, '_>) {
    let ((field, occupancy), rays, cotangents) = (scene(), rays(), cotangents());
    let mut gradient = FieldGradient::zeros(&field);
    let parts: Vec<_> = rays
        .iter()
        .zip(&cotangents)
        .step_by(16)
        .map(|(ray, cotangent)| (ray, cotangent, occupancy.samples(&field, &march(), ray)))
        .collect();
    bencher.bench_local(|| {
        for (ray, cotangent, samples) in &parts {
            black_box(reference::render(&field, ray, samples));
            let gradient = Some(&mut gradient);
            black_box(reference::pull_back(&field, ray, samples, cotangent, gradient));
        }
    });
}

//! Time of a training batch of the hash-grid field at its full size (16 levels of 2 features,
//! tables of 2¹⁹, networks of 64 units): 4096 rays drawn from all over a room, sampled in the
//! cells around its walls.
//!
//! Before that it prints the fastest time of each part of a training step, taken in turns within
//! one run, with rays and samples per second, and the operations per second that the products of
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
    let textbook = textbook(&field, &occupancy, &rays, &cotangents);
    let mut fastest = [f64::MAX; 6];
    for _ in 0..ROUNDS {
        let mut time = |part: usize, work: &mut dyn FnMut()| {
            let start = Instant::now();
            work();
            fastest[part] = fastest[part].min(start.elapsed().as_secs_f64() * 1e3);
        };
        time(5, &mut || render_textbook(&field, &textbook, &mut gradient));
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
        "textbook forward and backward of a sixteenth",
    ];
    for (name, time) in names.iter().zip(fastest) {
        println!("{name}: {time:.1} ms");
    }
    // Of the networks: once forward; again in each way back, then the products with the
    // derivatives, of which those by the weights only for the field.
    let once = 2.0 * (samples * products(field.settings())) as f64;
    let (rays_alone, both) = (fastest[1], fastest[0] + fastest[2]);
    println!(
        "backward, rays alone: {:.1} Gflop/s in the networks\n\
         forward and backward: {both:.1} ms, {:.0} rays/s, {:.2} million samples/s, {:.1} Gflop/s in the networks",
        2.0 * once / rays_alone / 1e6,
        RAYS as f64 / both * 1e3,
        samples as f64 / both / 1e3,
        4.0 * once / both / 1e6
    );
    println!("textbook, one thread: {:.1} times as long", 16.0 * fastest[5] / both);
}

/// A ray, the derivative by what it shows, and its samples.
type Part = (Ray, RayRender, Vec<Sample>);

/// A sixteenth of the rays.
fn textbook(
    field: &HashGridField,
    occupancy: &Occupancy,
    rays: &[Ray],
    cotangents: &[RayRender],
) -> Vec<Part> {
    let parts = rays.iter().zip(cotangents).step_by(16);
    let part = |(ray, cotangent): (&Ray, &RayRender)| {
        (*ray, *cotangent, occupancy.samples(field, &march(), ray))
    };
    parts.map(part).collect()
}

fn render_textbook(field: &HashGridField, parts: &[Part], gradient: &mut FieldGradient) {
    for (ray, cotangent, samples) in parts {
        black_box(reference::render(field, ray, samples));
        black_box(reference::pull_back(field, ray, samples, cotangent, Some(gradient)));
    }
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
    let parts = textbook(&field, &occupancy, &rays, &cotangents);
    bencher.bench_local(|| render_textbook(&field, &parts, &mut gradient));
}

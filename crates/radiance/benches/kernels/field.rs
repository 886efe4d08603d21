//! The hash-grid field: a room at the full size of a field (16 levels of 2 features, tables of 2¹⁹,
//! networks of 64 units), and rays from all over it, forward and back.

use super::{counts, machine, on_threads};
use i2slam_check::processor_seconds;
use i2slam_geometry::Vec3;
use i2slam_radiance::hashgrid::*;
use std::hint::black_box;

/// Rounds, in each of which every lane has its turn.
const ROUNDS: usize = 16;

/// Least times forward and back \[s of the processor\].
type Times = [f64; 2];

/// Both lanes on one thread. Times are the processor's own, without what other programs take.
pub(crate) fn print() {
    println!(
        "lane,rays,samples,forward_ms,backward_ms,rays_per_s,million_samples_per_s,gflop_per_s,\
         share_of_peak"
    );
    if on_threads(1, measure).is_none() {
        eprintln!("rays: no threads");
    }
}

fn measure() {
    let (field, occupancy) = scene();
    let (rays, cotangents) = (rays(), cotangents());
    let mut gradient = FieldGradient::zeros(&field);
    let (mut renderer, mut renders) = (FieldRenderer::new(march()), Vec::new());
    let parts = textbook(&field, &occupancy, &rays, &cotangents);
    let mut best = [[f64::MAX; 2]; 2];
    for _ in 0..ROUNDS {
        let clock = processor_seconds();
        renderer.render(&field, &occupancy, &rays, &mut renders);
        let between = processor_seconds();
        renderer.pull_back(&field, &rays, &cotangents, Some(&mut gradient), None);
        keep(&mut best[0], [between - clock, processor_seconds() - between]);
        let clock = processor_seconds();
        for (ray, _, samples) in &parts {
            black_box(reference::render(&field, ray, samples));
        }
        let between = processor_seconds();
        for (ray, cotangent, samples) in &parts {
            let gradient = Some(&mut gradient);
            black_box(reference::pull_back(&field, ray, samples, cotangent, gradient));
        }
        keep(&mut best[1], [between - clock, processor_seconds() - between]);
    }
    let count = counts::field(field.settings());
    let peak = machine::flops(1);
    let of_textbook = parts.iter().map(|(_, _, samples)| samples.len()).sum();
    let lanes = [("cpu", rays.len(), renderer.samples()), ("textbook", parts.len(), of_textbook)];
    for ((lane, rays, samples), [forward, backward]) in lanes.into_iter().zip(best) {
        let both = forward + backward;
        let flops = (count.forward + count.backward) * samples as f64 / both;
        println!(
            "{lane},{rays},{samples},{:.1},{:.1},{:.0},{:.3},{:.1},{:.3}",
            1e3 * forward,
            1e3 * backward,
            rays as f64 / both,
            samples as f64 / both / 1e6,
            flops / 1e9,
            flops / peak
        );
    }
    println!("time,rays/forward,{:.6e}", best[0][0]);
    println!("time,rays/backward,{:.6e}", best[0][1]);
}

fn keep(best: &mut Times, times: Times) {
    best.iter_mut().zip(times).for_each(|(best, time)| *best = best.min(time));
}

/// Half edge of the cube, and of the room within \[m\].
const BOUND: f64 = 2.0;
const WALL: f64 = 1.8;
const RAYS: usize = 4096;

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

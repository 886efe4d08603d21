//! A room whose walls are sampled, at the full size of a field (16 levels of 2 features, tables of
//! 2¹⁹, networks of 64 units), and rays from all over it.

use i2slam_geometry::Vec3;
use i2slam_radiance::hashgrid::*;
use std::hint::black_box;

/// Half edge of the cube, and of the room within \[m\].
const BOUND: f64 = 2.0;
const WALL: f64 = 1.8;
pub(crate) const RAYS: usize = 4096;

/// Numbers that repeat.
fn noise(seed: u64) -> impl FnMut() -> f64 {
    let mut numbers = i2slam_check::noise(seed, 1 << 20).into_iter().cycle();
    move || numbers.next().unwrap_or(0.0)
}

pub(crate) fn march() -> MarchSettings {
    MarchSettings::cube(BOUND)
}

/// A room: opaque cells along the walls, some density within them.
pub(crate) fn scene() -> (HashGridField, Occupancy) {
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

pub(crate) fn rays() -> Vec<Ray> {
    let mut noise = noise(3);
    let mut vector = |size: f64| Vec3::new(noise() * size, noise() * size, noise() * size);
    let ray = |_| {
        let (origin, direction) = (vector(0.5).cast(), vector(1.0).cast());
        Ray { origin, direction, offset: 0.5 }
    };
    (0..RAYS).map(ray).collect()
}

pub(crate) fn cotangents() -> Vec<RayRender> {
    let mut noise = noise(7);
    let mut one = || noise() as f32 / RAYS as f32;
    let mut cotangent =
        |_| RayRender { radiance: [one(), one(), one()], depth: one(), opacity: one() };
    (0..RAYS).map(&mut cotangent).collect()
}

/// A ray, the derivative by what it shows, and its samples.
pub(crate) type Part = (Ray, RayRender, Vec<Sample>);

/// A sixteenth of the rays.
pub(crate) fn textbook(
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

/// The plain lane, forward.
pub(crate) fn render_textbook(field: &HashGridField, parts: &[Part]) {
    for (ray, _, samples) in parts {
        black_box(reference::render(field, ray, samples));
    }
}

/// The plain lane, back to the field and the rays.
pub(crate) fn pull_back_textbook(
    field: &HashGridField,
    parts: &[Part],
    gradient: &mut FieldGradient,
) {
    for (ray, cotangent, samples) in parts {
        black_box(reference::pull_back(field, ray, samples, cotangent, Some(gradient)));
    }
}

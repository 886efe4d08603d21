//! Tests of both lanes.

use crate::hashgrid::*;
use i2slam_check::noise;
use i2slam_geometry::{Real, Vec3};

mod convergence;
mod gradients;
mod occupancy;
mod parity;
mod poison;
mod views;

/// A small field: three grids, of which the last is hashed.
pub(super) fn settings() -> FieldSettings {
    FieldSettings {
        levels: 3,
        log2_table: 8,
        base_resolution: 3,
        finest_resolution: 11,
        hidden_width: 8,
        geometry_features: 5,
        ..FieldSettings::cube([0.2, -0.1, 0.4], 1.5)
    }
}

/// A field whose parameters are large enough to matter, and whose densities differ.
pub(super) fn field(settings: FieldSettings, seed: u64) -> HashGridField<f64> {
    let mut field = HashGridField::<f64>::new(settings, seed).expect("settings in range");
    let [table, density, colour] = field.parameters_mut();
    let numbers = noise(seed, table.len());
    table.iter_mut().zip(numbers).for_each(|(v, n)| *v = n);
    for weights in [density, colour] {
        weights.iter_mut().for_each(|w| *w *= 1.7);
    }
    field
}

/// Rays from within the cube, of directions that are not of unit length.
pub(super) fn rays(count: usize, seed: u64) -> Vec<Ray<f64>> {
    let ray = |i: usize| {
        let n = noise(seed * 1000 + i as u64, 7);
        let origin = Vec3::new(0.2 + 0.7 * n[0], -0.1 + 0.7 * n[1], 0.4 + 0.7 * n[2]);
        let direction = Vec3::new(n[3], n[4], n[5] + 0.1) * 1.3;
        Ray { origin, direction, offset: 0.5 + 0.5 * n[6] }
    };
    (0..count).map(ray).collect()
}

/// Samples at even distances, which stay in the cube.
pub(super) fn samples(count: usize) -> Vec<Sample<f64>> {
    let sample = |i: usize| Sample { depth: 0.05 + 0.05 * i as f64, step: 0.05 };
    (0..count).map(sample).collect()
}

/// Random derivatives by what rays show.
pub(super) fn cotangents(count: usize, seed: u64) -> Vec<RayRender<f64>> {
    let n = noise(seed, 5 * count);
    let of = |n: &[f64; 5]| RayRender { radiance: [n[0], n[1], n[2]], depth: n[3], opacity: n[4] };
    n.as_chunks::<5>().0.iter().map(of).collect()
}

/// `⟨cotangent, render⟩`.
pub(super) fn functional(render: &RayRender<f64>, cotangent: &RayRender<f64>) -> f64 {
    let radiance: f64 = (0..3).map(|c| render.radiance[c] * cotangent.radiance[c]).sum();
    radiance + render.depth * cotangent.depth + render.opacity * cotangent.opacity
}

/// The numbers of what rays show, and of gradients.
pub(super) fn render_row<T: Real>(render: &RayRender<T>) -> [f64; 5] {
    let [r, g, b] = render.radiance;
    [r, g, b, render.depth, render.opacity].map(Real::to_f64)
}

pub(super) fn ray_row<T: Real>(gradient: &RayGradient<T>) -> [f64; 6] {
    let ([a, b, c], [d, e, f]) = (gradient.origin.to_array(), gradient.direction.to_array());
    [a, b, c, d, e, f].map(Real::to_f64)
}

pub(super) fn single(render: &RayRender<f64>) -> RayRender {
    RayRender {
        radiance: render.radiance.map(|v| v as f32),
        depth: render.depth as f32,
        opacity: render.opacity as f32,
    }
}

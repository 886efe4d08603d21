//! The plain lane: one ray and one sample at a time, generic over the scalar, without occupancy
//! and early end: it renders the samples that it is given.

use super::{RayGradient, RayRender};
use crate::hashgrid::encoding::{harmonics, reference as encoding};
use crate::hashgrid::field::truncated_exp;
use crate::hashgrid::network::reference as network;
use crate::hashgrid::{FieldGradient, HashGridField, Ray, Sample};
use i2slam_geometry::{Real, Vec3};

/// Everything that is known about a sample.
struct Point<T> {
    position: [T; 3],
    density_values: Vec<Vec<T>>,
    colour_values: Vec<Vec<T>>,
    density: T,
    colour: [T; 3],
}

fn unit<T: Real>(ray: &Ray<T>) -> [T; 3] {
    (ray.direction * (T::one() / ray.direction.norm())).to_array()
}

fn point<T: Real>(field: &HashGridField<T>, ray: &Ray<T>, depth: T) -> Point<T> {
    let (scale, offset) = field.to_unit();
    let p = (ray.origin + ray.direction * depth).to_array();
    let position = std::array::from_fn(|k| p[k] * scale + offset[k]);
    let (settings, weights) = (field.settings(), field.parameters());
    let mut features = vec![T::zero(); settings.levels * settings.features];
    let table = &weights.table;
    encoding::encode(&field.levels, settings.features, table, position, &mut features);
    let density_values = network::forward(&field.density_shape, &weights.density, features);
    let output = &density_values[density_values.len() - 1];
    let mut input = harmonics::harmonics(unit(ray)).to_vec();
    input.extend_from_slice(&output[1..]);
    let density = truncated_exp(output[0]);
    let colour_values = network::forward(&field.colour_shape, &weights.colour, input);
    let output = &colour_values[colour_values.len() - 1];
    let colour = std::array::from_fn(|c| truncated_exp(output[c]));
    Point { position, density_values, colour_values, density, colour }
}

/// Renders a ray from its samples.
pub fn render<T: Real>(
    field: &HashGridField<T>,
    ray: &Ray<T>,
    samples: &[Sample<T>],
) -> RayRender<T> {
    let (mut out, mut transmittance) = (RayRender::default(), T::one());
    for sample in samples {
        let point = point(field, ray, sample.depth);
        let fade = (-point.density * sample.step * ray.direction.norm()).exp();
        out.add(transmittance * (T::one() - fade), &point.colour, sample.depth);
        transmittance *= fade;
    }
    out
}

/// Pulls `∂L/∂render` back: adds `∂L/∂field` to `gradient` when given, returns `∂L/∂ray`.
pub fn pull_back<T: Real>(
    field: &HashGridField<T>,
    ray: &Ray<T>,
    samples: &[Sample<T>],
    cotangent: &RayRender<T>,
    mut gradient: Option<&mut FieldGradient<T>>,
) -> RayGradient<T> {
    let length = ray.direction.norm();
    let points: Vec<_> = samples.iter().map(|s| point(field, ray, s.depth)).collect();
    let mut transmittances = vec![T::one()];
    for (point, sample) in points.iter().zip(samples) {
        let fade = (-point.density * sample.step * length).exp();
        transmittances.push(transmittances[transmittances.len() - 1] * fade);
    }
    let mut out = RayGradient::default();
    let (mut behind, mut by_unit, mut by_length) = (T::zero(), Vec3::zero(), T::zero());
    for (i, (point, sample)) in points.iter().zip(samples).enumerate().rev() {
        let value = cotangent.by_weight(&point.colour, sample.depth);
        let weight = transmittances[i] - transmittances[i + 1];
        let d_thickness = transmittances[i + 1] * value - behind;
        behind += weight * value;
        by_length += d_thickness * point.density * sample.step;
        let d_density = d_thickness * sample.step * length * point.density;
        let d_colour = (0..3).map(|c| weight * cotangent.radiance[c] * point.colour[c]).collect();
        let (d_position, d_unit) =
            pull_back_point(field, ray, point, d_density, d_colour, gradient.as_deref_mut());
        out.origin += d_position;
        out.direction += d_position * sample.depth;
        by_unit += d_unit;
    }
    out.add_shape(ray.direction, by_unit, by_length);
    out
}

/// From derivatives by exponents to those by the position in the world and the unit direction.
fn pull_back_point<T: Real>(
    field: &HashGridField<T>,
    ray: &Ray<T>,
    point: &Point<T>,
    d_density: T,
    d_colour: Vec<T>,
    mut gradient: Option<&mut FieldGradient<T>>,
) -> (Vec3<T>, Vec3<T>) {
    let (settings, weights) = (field.settings(), field.parameters());
    let d_input = network::pull_back(
        &field.colour_shape,
        &weights.colour,
        &point.colour_values,
        d_colour,
        gradient.as_mut().map(|g| g.colour.as_mut_slice()),
    );
    let (d_harmonics, d_geometry) = d_input.split_at(harmonics::HARMONICS);
    let d_harmonics = std::array::from_fn(|i| d_harmonics[i]);
    let d_unit = harmonics::pull_back(unit(ray), &d_harmonics);
    let mut d_output = vec![d_density];
    d_output.extend_from_slice(d_geometry);
    let d_features = network::pull_back(
        &field.density_shape,
        &weights.density,
        &point.density_values,
        d_output,
        gradient.as_mut().map(|g| g.density.as_mut_slice()),
    );
    let d_position = encoding::pull_back(
        &field.levels,
        settings.features,
        &weights.table,
        point.position,
        &d_features,
        gradient.as_mut().map(|g| g.table.as_mut_slice()),
    );
    let (scale, _) = field.to_unit();
    (Vec3::from_array(d_position) * scale, Vec3::from_array(d_unit))
}

//! Backward pass, from derivatives by renders to those by the field and by the rays.

use super::chunk::{Chunk, Direction, FieldContext, Workspace};
use super::cpu_forward::{colours, densities};
use super::{RayGradient, RayRender};
use crate::hashgrid::Ray;
use crate::hashgrid::encoding::{cpu as encoding, harmonics};
use crate::hashgrid::network::cpu::{self as network, Activations, BLOCK};
use crate::hashgrid::network::product::padded;
use harmonics::HARMONICS;
use i2slam_geometry::Vec3;

#[derive(Clone, Copy)]
pub(super) struct Requested {
    pub(super) field: bool,
    pub(super) rays: bool,
}

/// Derivatives by the exponents of density and colour of a sample.
type ByExponents = [f32; 4];

/// Derivatives by the ray that are not by a position.
#[derive(Clone, Copy, Default)]
struct ByDirection {
    harmonics: [f32; HARMONICS],
    length: f32,
    /// Sum of `w v` over the samples behind the current one.
    behind: f32,
}

/// Undoes the blend: from back to front.
fn composite_backward(
    chunk: &Chunk,
    directions: &[Direction],
    cotangents: &[RayRender],
    by_direction: &mut [ByDirection],
) -> Vec<ByExponents> {
    let mut out = vec![[0.0; 4]; chunk.kept.len()];
    for (kept, out) in chunk.kept.iter().zip(&mut out).rev() {
        let ray = kept.ray as usize;
        let (cotangent, sums) = (&cotangents[ray], &mut by_direction[ray]);
        let value = cotangent.by_weight(&kept.colour, kept.sample.depth);
        let weight = kept.transmittance * (1.0 - kept.fade);
        let d_thickness = kept.transmittance * kept.fade * value - sums.behind;
        sums.behind += weight * value;
        sums.length += d_thickness * kept.density * kept.sample.step;
        out[0] = d_thickness * kept.sample.step * directions[ray].length * kept.density;
        for c in 0..3 {
            out[1 + c] = weight * cotangent.radiance[c] * kept.colour[c];
        }
    }
    out
}

/// Pulls the derivatives by what the rays of a chunk show back, after its `render`.
pub(super) fn pull_back(
    scene: &FieldContext<'_>,
    requested: Requested,
    rays: &[Ray],
    cotangents: &[RayRender],
    chunk: &mut Chunk,
) {
    let directions: Vec<_> = rays.iter().map(Direction::new).collect();
    let mut by_direction = vec![ByDirection::default(); rays.len()];
    let by_exponents = composite_backward(chunk, &directions, cotangents, &mut by_direction);
    chunk.ray_gradients.clear();
    chunk.ray_gradients.resize(rays.len(), RayGradient::default());
    if requested.field {
        scene.density.zero_gradient(&mut chunk.d_density);
        scene.colour.zero_gradient(&mut chunk.d_colour);
        chunk.d_features.resize(chunk.kept.len() * scene.features(), 0.0);
    }
    let mut space = Backward::new(scene);
    for first in (0..chunk.kept.len()).step_by(BLOCK) {
        let block = first..(first + BLOCK).min(chunk.kept.len());
        space.networks(scene, requested, chunk, &block, &directions, &by_exponents[block.clone()]);
        if requested.field {
            space.store_feature_gradients(scene, chunk, &block);
        }
        if requested.rays {
            space.add_rays(scene, chunk, &block, &mut by_direction);
        }
    }
    if requested.rays {
        for ((ray, sums), out) in rays.iter().zip(&by_direction).zip(&mut chunk.ray_gradients) {
            if sums.harmonics == [0.0; HARMONICS] && sums.length == 0.0 {
                continue;
            }
            let unit = Direction::new(ray).unit.to_array();
            let by_unit = Vec3::from_array(harmonics::pull_back(unit, &sums.harmonics));
            out.add_shape(ray.direction, by_unit, sums.length);
        }
    }
}

/// Buffers of a block.
struct Backward {
    values: Workspace,
    d_density: Activations,
    d_colour: Activations,
    d_positions: [[f32; 3]; BLOCK],
}

impl Backward {
    fn new(scene: &FieldContext<'_>) -> Self {
        Self {
            values: Workspace::new(scene),
            d_density: Activations::new(scene.density),
            d_colour: Activations::new(scene.colour),
            d_positions: [[0.0; 3]; BLOCK],
        }
    }

    /// Both networks forward again, then back.
    fn networks(
        &mut self,
        scene: &FieldContext<'_>,
        requested: Requested,
        chunk: &mut Chunk,
        block: &std::ops::Range<usize>,
        directions: &[Direction],
        by_exponents: &[ByExponents],
    ) {
        let (arch, width, count) = (scene.arch, scene.width(), block.len());
        let geometry = scene.field.settings().geometry_features;
        let kept = &chunk.kept[block.clone()];
        densities(
            scene,
            &chunk.encodings[block.start * width..block.end * width],
            &mut self.values,
        );
        let seen = kept.iter().map(|kept| &directions[kept.ray as usize].harmonics);
        colours(scene, seen, count, &mut self.values);

        self.d_colour.output().fill(0.0);
        let rows = self.d_colour.output().chunks_exact_mut(padded(3));
        for (row, by) in rows.zip(by_exponents) {
            row[..3].copy_from_slice(&by[1..]);
        }
        let gradient = requested.field.then_some(&mut chunk.d_colour);
        let (values, d) = (&self.values.colour, &mut self.d_colour);
        network::pull_back(arch, scene.colour, count, values, d, gradient);

        self.d_density.output().fill(0.0);
        let rows = self.d_density.output().chunks_exact_mut(padded(1 + geometry));
        let inputs = self.d_colour.input().chunks_exact(padded(HARMONICS + geometry));
        for ((row, by), input) in rows.zip(by_exponents).zip(inputs) {
            row[0] = by[0];
            row[1..1 + geometry].copy_from_slice(&input[HARMONICS..HARMONICS + geometry]);
        }
        let gradient = requested.field.then_some(&mut chunk.d_density);
        let (values, d) = (&self.values.density, &mut self.d_density);
        network::pull_back(arch, scene.density, count, values, d, gradient);
    }

    /// Puts the derivatives by the encodings in order of the levels.
    fn store_feature_gradients(
        &mut self,
        scene: &FieldContext<'_>,
        chunk: &mut Chunk,
        block: &std::ops::Range<usize>,
    ) {
        let features = scene.field.settings().features;
        let count = chunk.kept.len();
        let rows = self.d_density.input().chunks_exact(scene.width());
        for (i, row) in block.clone().zip(rows) {
            for (l, part) in row[..scene.features()].chunks_exact(features).enumerate() {
                let to = (l * count + i) * features;
                chunk.d_features[to..to + features].copy_from_slice(part);
            }
        }
    }

    /// From the derivatives by the encodings to those by the positions in the unit cube.
    fn by_positions(
        &mut self,
        scene: &FieldContext<'_>,
        chunk: &Chunk,
        block: &std::ops::Range<usize>,
    ) {
        let (field, width) = (scene.field, scene.width());
        let cotangent = &self.d_density.input()[..block.len() * width];
        let out = &mut self.d_positions[..block.len()];
        if !chunk.slopes.is_empty() {
            let slopes = &chunk.slopes[3 * block.start * width..3 * block.end * width];
            scene.arch.dispatch(encoding::BySlopes { cotangent, slopes, width, out });
            return;
        }
        scene.arch.dispatch(encoding::PositionGradient {
            features: field.settings().features,
            levels: &field.levels,
            table: &field.parameters.table,
            positions: &chunk.positions[block.clone()],
            cotangent,
            width,
            out,
        });
    }

    fn add_rays(
        &mut self,
        scene: &FieldContext<'_>,
        chunk: &mut Chunk,
        block: &std::ops::Range<usize>,
        by_direction: &mut [ByDirection],
    ) {
        self.by_positions(scene, chunk, block);
        let field = scene.field;
        let (scale, _) = field.to_unit();
        let inputs = padded(HARMONICS + field.settings().geometry_features);
        let rows = self.d_colour.input().chunks_exact(inputs);
        for ((kept, d), row) in chunk.kept[block.clone()].iter().zip(&self.d_positions).zip(rows) {
            let ray = kept.ray as usize;
            let d_position = Vec3::from_array(*d) * scale;
            chunk.ray_gradients[ray].origin += d_position;
            chunk.ray_gradients[ray].direction += d_position * kept.sample.depth;
            let sums = &mut by_direction[ray].harmonics;
            sums.iter_mut().zip(row).for_each(|(sum, d)| *sum += d);
        }
    }
}

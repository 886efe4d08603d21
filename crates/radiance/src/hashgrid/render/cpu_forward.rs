//! Forward pass, a chunk of rays at a time.
//!
//! All rays of a chunk advance together, some samples at a time, so that a ray that has ended
//! costs no more than the samples of its last advance.

use super::RayRender;
use super::chunk::{Chunk, Direction, Exponentials, FieldContext, RAYS, RenderedSample, Workspace};
use crate::hashgrid::encoding::{cpu as encoding, harmonics::HARMONICS};
use crate::hashgrid::field::EXPONENT_MAX;
use crate::hashgrid::march::RayMarcher;
use crate::hashgrid::network::cpu::{self as network, BLOCK};
use crate::hashgrid::network::product::padded;
use crate::hashgrid::{MarchSettings, Occupancy, Ray, Sample};

/// Samples of an advance, about.
const BATCH_SAMPLES: usize = 512;

/// Samples of one ray in an advance, from and to.
const ADVANCE: [usize; 2] = [8, 32];

/// The samples of an advance.
#[derive(Default)]
struct SampleBatch {
    rays: Vec<u32>,
    samples: Vec<Sample>,
    positions: Vec<[f32; 3]>,
    encodings: Vec<f32>,
    slopes: Vec<f32>,
    densities: Vec<f32>,
    colours: Vec<[f32; 3]>,
    fades: Vec<f32>,
}

impl SampleBatch {
    /// Advance the active rays; those that leave the cube are active no longer.
    fn fill(
        &mut self,
        (march, occupancy): (&MarchSettings, &Occupancy),
        marchers: &mut [RayMarcher],
        active: &mut Vec<u32>,
    ) {
        self.rays.clear();
        self.samples.clear();
        self.positions.clear();
        let most = (BATCH_SAMPLES / active.len()).clamp(ADVANCE[0], ADVANCE[1]);
        active.retain(|&ray| {
            for _ in 0..most {
                let next = marchers[ray as usize].next(march, occupancy);
                let Some((sample, position)) = next else { return false };
                self.rays.push(ray);
                self.samples.push(sample);
                self.positions.push(position);
            }
            true
        });
    }

    fn evaluate(
        &mut self,
        scene: &FieldContext<'_>,
        directions: &[Direction],
        space: &mut Workspace,
    ) {
        let (count, width) = (self.rays.len(), scene.width());
        self.encodings.resize(count * width, 0.0);
        let kept = if scene.keep_slopes { 3 * count * width } else { 0 };
        self.slopes.resize(kept, 0.0);
        encode(scene, &self.positions, &mut self.encodings, &mut self.slopes);
        self.densities.clear();
        self.colours.clear();
        for first in (0..count).step_by(BLOCK) {
            let block = first..(first + BLOCK).min(count);
            let encodings = &self.encodings[block.start * width..block.end * width];
            densities(scene, encodings, space);
            let seen = self.rays[block.clone()].iter().map(|&r| &directions[r as usize].harmonics);
            colours(scene, seen, block.len(), space);
            let [density, red, green, blue] = &space.exponentials;
            self.densities.extend_from_slice(&density[..block.len()]);
            self.colours.extend((0..block.len()).map(|i| [red[i], green[i], blue[i]]));
        }
        self.fades.clear();
        for i in 0..count {
            let length = directions[self.rays[i] as usize].length;
            self.fades.push(-self.densities[i] * self.samples[i].step * length);
        }
        scene.arch.dispatch(Exponentials(&mut self.fades));
    }

    /// Adds the samples to their rays up to where those end.
    fn composite(
        &self,
        march: &MarchSettings,
        width: usize,
        transmittances: &mut [f32],
        out: &mut Chunk,
    ) {
        for (i, (&ray, &sample)) in self.rays.iter().zip(&self.samples).enumerate() {
            let transmittance = transmittances[ray as usize];
            if transmittance < march.transmittance_min {
                continue;
            }
            let (fade, colour) = (self.fades[i], self.colours[i]);
            out.renders[ray as usize].add(transmittance * (1.0 - fade), &colour, sample.depth);
            transmittances[ray as usize] = transmittance * fade;
            let density = self.densities[i];
            out.kept.push(RenderedSample { ray, sample, density, transmittance, fade, colour });
            out.positions.push(self.positions[i]);
            out.encodings.extend_from_slice(&self.encodings[i * width..(i + 1) * width]);
            if !self.slopes.is_empty() {
                out.slopes.extend_from_slice(&self.slopes[3 * i * width..3 * (i + 1) * width]);
            }
        }
    }
}

/// Encodings of positions in the unit cube, and their slopes unless that is empty.
pub(super) fn encode(
    scene: &FieldContext<'_>,
    positions: &[[f32; 3]],
    out: &mut [f32],
    slopes: &mut [f32],
) {
    let (field, width) = (scene.field, scene.width());
    scene.arch.dispatch(encoding::Encode {
        features: field.settings().features,
        levels: &field.levels,
        table: &field.parameters.table,
        positions,
        out,
        width,
        slopes,
    });
}

/// Density network and density of a block, from its encodings.
pub(super) fn densities(scene: &FieldContext<'_>, encodings: &[f32], space: &mut Workspace) {
    let count = encodings.len() / scene.width();
    space.density.input()[..encodings.len()].copy_from_slice(encodings);
    network::forward(scene.arch, scene.density, count, &mut space.density);
    let width = padded(1 + scene.field.settings().geometry_features);
    let rows = space.density.output().chunks_exact(width);
    exponents(rows, 0, count, &mut space.exponentials[0]);
    scene.arch.dispatch(Exponentials(&mut space.exponentials[0]));
}

/// Colour network and colours of a block, after [`densities`].
pub(super) fn colours<'a>(
    scene: &FieldContext<'_>,
    seen: impl Iterator<Item = &'a [f32; HARMONICS]>,
    count: usize,
    space: &mut Workspace,
) {
    let geometry = scene.field.settings().geometry_features;
    let rows = space.density.output().chunks_exact(padded(1 + geometry));
    let inputs = space.colour.input().chunks_exact_mut(padded(HARMONICS + geometry));
    for ((seen, row), input) in seen.zip(rows).zip(inputs) {
        input[..HARMONICS].copy_from_slice(seen);
        input[HARMONICS..HARMONICS + geometry].copy_from_slice(&row[1..1 + geometry]);
    }
    network::forward(scene.arch, scene.colour, count, &mut space.colour);
    for c in 0..3 {
        let rows = space.colour.output().chunks_exact(padded(3));
        exponents(rows, c, count, &mut space.exponentials[1 + c]);
    }
    scene.arch.dispatch(Exponentials(space.exponentials[1..].as_flattened_mut()));
}

/// Column `column` of the first `count` rows, within the bound of exponents.
fn exponents<'a>(
    rows: impl Iterator<Item = &'a [f32]>,
    column: usize,
    count: usize,
    out: &mut [f32; BLOCK],
) {
    let most = EXPONENT_MAX as f32;
    for (out, row) in out.iter_mut().zip(rows.take(count)) {
        *out = row[column].max(-most).min(most);
    }
}

pub(super) fn render(
    scene: &FieldContext<'_>,
    (march, occupancy): (&MarchSettings, &Occupancy),
    rays: &[Ray],
    out: &mut Chunk,
) {
    debug_assert!(rays.len() <= RAYS);
    out.clear();
    out.renders.resize(rays.len(), RayRender::default());
    let directions: Vec<_> = rays.iter().map(Direction::new).collect();
    let marcher = |ray| RayMarcher::new(scene.field, march, ray);
    let mut marchers: Vec<_> = rays.iter().map(marcher).collect();
    let mut active: Vec<u32> = (0..rays.len() as u32).collect();
    let mut transmittances = vec![1.0_f32; rays.len()];
    let (mut batch, mut space) = (SampleBatch::default(), Workspace::new(scene));
    while !active.is_empty() {
        batch.fill((march, occupancy), &mut marchers, &mut active);
        batch.evaluate(scene, &directions, &mut space);
        batch.composite(march, scene.width(), &mut transmittances, out);
        active.retain(|&r| transmittances[r as usize] >= march.transmittance_min);
    }
}

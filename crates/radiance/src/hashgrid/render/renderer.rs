//! Renderer of batches of rays.

use super::chunk::{Chunk, FieldContext, RAYS, Workspace};
use super::cpu_backward::{self, Requested};
use super::{RayGradient, RayRender, cpu_forward};
use crate::hashgrid::encoding::cpu as encoding;
use crate::hashgrid::network::cpu::{BLOCK, Packed, add_gradient};
use crate::hashgrid::{FieldGradient, HashGridField, MarchSettings, Occupancy, Ray};
use i2slam_geometry::Vec3;
use pulp::Arch;
use rayon::prelude::*;

/// The fast lane: all threads of the current `rayon` pool and the widest vectors found at run
/// time, in `f32`.
///
/// Buffers are kept from call to call: about 350 bytes per sample of the last render, of the
/// default field. What rays show and gradients are bitwise the same for any number of threads on
/// one machine; the width of its vectors changes the order of some sums.
pub struct FieldRenderer {
    march: MarchSettings,
    arch: Arch,
    chunks: Vec<Chunk>,
    rays: usize,
    keep_slopes: bool,
}

impl FieldRenderer {
    /// A renderer that has rendered nothing yet.
    pub fn new(march: MarchSettings) -> Self {
        Self { march, arch: Arch::new(), chunks: Vec::new(), rays: 0, keep_slopes: false }
    }

    /// A renderer on a chosen instruction set.
    #[cfg(test)]
    pub(crate) fn on(arch: Arch, march: MarchSettings) -> Self {
        Self { arch, ..Self::new(march) }
    }

    /// Makes renders keep the slopes of the table for [`pull_back`](Self::pull_back): faster, for
    /// twice the memory, equal up to rounding. Returns the setting before.
    pub fn keep_slopes(&mut self, keep: bool) -> bool {
        std::mem::replace(&mut self.keep_slopes, keep)
    }

    /// Samples of the last render that took part: the measure of work.
    pub fn samples(&self) -> usize {
        self.chunks[..self.rays.div_ceil(RAYS)].iter().map(|chunk| chunk.kept.len()).sum()
    }

    /// Writes what each ray, of any number of frames, shows into `out`, whose allocation is reused.
    pub fn render(
        &mut self,
        field: &HashGridField,
        occupancy: &Occupancy,
        rays: &[Ray],
        out: &mut Vec<RayRender>,
    ) {
        let networks = Networks::new(field);
        let scene =
            FieldContext { keep_slopes: self.keep_slopes, ..networks.scene(self.arch, field) };
        let march = (&self.march, occupancy);
        let count = rays.len().div_ceil(RAYS);
        self.rays = rays.len();
        self.chunks.resize_with(self.chunks.len().max(count), Chunk::default);
        let chunks = self.chunks[..count].par_iter_mut();
        chunks
            .zip(rays.par_chunks(RAYS))
            .for_each(|(chunk, rays)| cpu_forward::render(&scene, march, rays, chunk));
        out.clear();
        self.chunks[..count].iter().for_each(|chunk| out.extend_from_slice(&chunk.renders));
    }

    /// Pulls `∂L/∂render` back through the last [`render`](Self::render), which must have been of
    /// this `field` and these `rays`. Adds `∂L/∂field` to `gradient` when given, and writes
    /// `∂L/∂ray` into `ray_gradients` when given.
    ///
    /// # Panics
    /// If `rays` or `cotangents` are not as many as in the last render, or `gradient` is not of
    /// the size of `field`.
    pub fn pull_back(
        &mut self,
        field: &HashGridField,
        rays: &[Ray],
        cotangents: &[RayRender],
        gradient: Option<&mut FieldGradient>,
        ray_gradients: Option<&mut Vec<RayGradient>>,
    ) {
        let as_rendered = rays.len() == self.rays && cotangents.len() == self.rays;
        assert!(as_rendered, "pull_back needs the rays of the last render");
        let networks = Networks::new(field);
        let scene = networks.scene(self.arch, field);
        let requested = Requested { field: gradient.is_some(), rays: ray_gradients.is_some() };
        let chunks = &mut self.chunks[..rays.len().div_ceil(RAYS)];
        let work = rays.par_chunks(RAYS).zip(cotangents.par_chunks(RAYS));
        chunks.par_iter_mut().zip(work).for_each(|(chunk, (rays, cotangents))| {
            cpu_backward::pull_back(&scene, requested, rays, cotangents, chunk);
        });
        if let Some(gradient) = gradient {
            assert!(gradient.fits(&field.parameters), "a gradient of another field");
            for chunk in &*chunks {
                add_gradient(&field.density_shape, &chunk.d_density, &mut gradient.density);
                add_gradient(&field.colour_shape, &chunk.d_colour, &mut gradient.colour);
            }
            scatter(self.arch, field, chunks, &mut gradient.table);
        }
        if let Some(out) = ray_gradients {
            out.clear();
            chunks.iter().for_each(|chunk| out.extend_from_slice(&chunk.ray_gradients));
        }
    }

    /// Densities \[1/m\] at points of the world; 0 outside of the cube.
    pub fn densities(&self, field: &HashGridField, points: &[Vec3<f32>]) -> Vec<f32> {
        let (scale, offset) = field.to_unit();
        let unit = |p: &Vec3<f32>| {
            let p = p.to_array();
            std::array::from_fn(|k| p[k] * scale + offset[k])
        };
        let positions: Vec<[f32; 3]> = points.iter().map(unit).collect();
        let mut densities = self.unit_densities(field, &positions);
        for (density, position) in densities.iter_mut().zip(&positions) {
            let inside = position.iter().all(|x| (0.0..=1.0).contains(x));
            *density = if inside { *density } else { 0.0 };
        }
        densities
    }

    /// Densities at positions in the unit cube.
    pub(crate) fn unit_densities(&self, field: &HashGridField, positions: &[[f32; 3]]) -> Vec<f32> {
        let networks = Networks::new(field);
        let scene = networks.scene(self.arch, field);
        let mut out = vec![0.0; positions.len()];
        let blocks = out.par_chunks_mut(BLOCK).zip(positions.par_chunks(BLOCK));
        blocks.for_each_init(
            || (Workspace::new(&scene), vec![0.0; BLOCK * scene.width()]),
            |(space, encodings), (out, positions)| {
                let encodings = &mut encodings[..positions.len() * scene.width()];
                cpu_forward::encode(&scene, positions, encodings, &mut []);
                cpu_forward::densities(&scene, encodings, space);
                out.copy_from_slice(&space.exponentials[0][..out.len()]);
            },
        );
        out
    }
}

/// The networks of a field, ready for products.
struct Networks {
    density: Packed,
    colour: Packed,
}

impl Networks {
    fn new(field: &HashGridField) -> Self {
        Self {
            density: Packed::new(&field.density_shape, &field.parameters.density),
            colour: Packed::new(&field.colour_shape, &field.parameters.colour),
        }
    }

    fn scene<'a>(&'a self, arch: Arch, field: &'a HashGridField) -> FieldContext<'a> {
        FieldContext {
            arch,
            field,
            density: &self.density,
            colour: &self.colour,
            keep_slopes: false,
        }
    }
}

/// Adds the derivatives by the encodings to the table, level by level in one order of sums.
fn scatter(arch: Arch, field: &HashGridField, chunks: &[Chunk], table: &mut [f32]) {
    let features = field.settings().features;
    let mut rest = table;
    let mut parts = Vec::with_capacity(field.levels.len());
    for level in &field.levels {
        let (part, after) = rest.split_at_mut(level.entries * features);
        parts.push((level, part));
        rest = after;
    }
    parts.into_par_iter().enumerate().with_max_len(1).for_each(|(l, (level, gradient))| {
        for chunk in chunks {
            let count = chunk.kept.len() * features;
            let cotangent = &chunk.d_features[l * count..(l + 1) * count];
            let positions = &chunk.positions;
            arch.dispatch(encoding::Scatter { features, level, positions, cotangent, gradient });
        }
    });
}

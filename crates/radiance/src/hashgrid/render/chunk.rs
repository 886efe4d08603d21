//! State of a chunk of rays between forward and backward pass.

use super::RayRender;
use crate::hashgrid::encoding::harmonics::{HARMONICS, harmonics};
use crate::hashgrid::network::cpu::{Activations, BLOCK, Packed};
use crate::hashgrid::network::product::padded;
use crate::hashgrid::{HashGridField, Ray, Sample};
use i2slam_compute::simd;
use i2slam_geometry::Vec3;
use pulp::{Arch, Simd, WithSimd};

/// Rays of a chunk: the piece of work of a thread, and of every sum.
pub(in crate::hashgrid) const RAYS: usize = 64;

/// The field, packed for the fast lane.
pub(super) struct FieldContext<'a> {
    pub(super) arch: Arch,
    pub(super) field: &'a HashGridField,
    pub(super) density: &'a Packed,
    pub(super) colour: &'a Packed,
    /// Keeps the slopes of encodings for the backward pass.
    pub(super) keep_slopes: bool,
}

impl FieldContext<'_> {
    /// Width of a row of encodings.
    pub(super) fn width(&self) -> usize {
        padded(self.features())
    }

    /// Numbers of an encoding.
    pub(super) fn features(&self) -> usize {
        self.field.settings().levels * self.field.settings().features
    }
}

/// A sample that took part in a picture.
#[derive(Clone, Copy, Debug)]
pub(in crate::hashgrid) struct RenderedSample {
    /// Its ray, within the chunk.
    pub(super) ray: u32,
    pub(super) sample: Sample,
    /// Density \[1/m\].
    pub(super) density: f32,
    /// Transmittance of the ray before it, `T`.
    pub(super) transmittance: f32,
    /// Transmittance of its own, `f`.
    pub(super) fade: f32,
    pub(super) colour: [f32; 3],
}

/// A chunk of rays and its samples, which of each ray are in order of depth.
#[derive(Default)]
pub(super) struct Chunk {
    pub(super) kept: Vec<RenderedSample>,
    /// Positions in the unit cube.
    pub(super) positions: Vec<[f32; 3]>,
    /// Encodings, one row per sample.
    pub(super) encodings: Vec<f32>,
    /// Slopes of the encodings, three rows per sample, if they are kept.
    pub(super) slopes: Vec<f32>,
    pub(super) renders: Vec<RayRender>,
    /// `∂L/∂encoding`, level after level, `features` numbers per sample.
    pub(super) d_features: Vec<f32>,
    /// `∂L/∂weights`, padded.
    pub(super) d_density: Vec<Vec<f32>>,
    pub(super) d_colour: Vec<Vec<f32>>,
    pub(super) ray_gradients: Vec<super::RayGradient>,
}

impl Chunk {
    pub(super) fn clear(&mut self) {
        self.kept.clear();
        self.positions.clear();
        self.encodings.clear();
        self.slopes.clear();
        self.renders.clear();
    }
}

/// Buffers of a thread for a block of samples.
pub(super) struct Workspace {
    pub(super) density: Activations,
    pub(super) colour: Activations,
    /// Exponents, then their exponentials: density, and the channels one after another.
    pub(super) exponentials: [[f32; BLOCK]; 4],
}

impl Workspace {
    pub(super) fn new(scene: &FieldContext<'_>) -> Self {
        Self {
            density: Activations::new(scene.density),
            colour: Activations::new(scene.colour),
            exponentials: [[0.0; BLOCK]; 4],
        }
    }
}

/// Direction of a ray: unit vector, metres per unit of its depth, and the colour network's input.
#[derive(Clone, Copy)]
pub(super) struct Direction {
    pub(super) unit: Vec3<f32>,
    pub(super) length: f32,
    pub(super) harmonics: [f32; HARMONICS],
}

impl Direction {
    pub(super) fn new(ray: &Ray) -> Self {
        let length = ray.direction.norm();
        let unit = ray.direction * (1.0 / length);
        Self { unit, length, harmonics: harmonics(unit.to_array()) }
    }
}

/// Exponentials in place, of arguments below 88.
pub(super) struct Exponentials<'a>(pub(super) &'a mut [f32]);

impl WithSimd for Exponentials<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let (vectors, rest) = S::as_mut_simd_f32s(self.0);
        for v in vectors {
            *v = simd::exp(simd, *v);
        }
        for v in rest {
            *v = v.exp();
        }
    }
}

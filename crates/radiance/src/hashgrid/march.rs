//! Marching along a ray through occupied cells.

use super::ray::cube_range;
use super::{Ray, Sample};
use crate::hashgrid::{HashGridField, MarchSettings, Occupancy};

/// A ray on its way through the occupied cells.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RayMarcher {
    /// Position in the unit cube, `origin + depth · direction`.
    origin: [f32; 3],
    direction: [f32; 3],
    /// One over each part of the direction.
    inverse: [f32; 3],
    /// Shortest and longest step.
    steps_from: f32,
    steps_to: f32,
    depth: f32,
    end: f32,
    steps: u32,
}

impl RayMarcher {
    /// From where the ray enters the cube of the field.
    pub(crate) fn new(field: &HashGridField, settings: &MarchSettings, ray: &Ray) -> Self {
        let (scale, offset) = field.to_unit();
        let (o, d) = (ray.origin.to_array(), ray.direction.to_array());
        let origin = std::array::from_fn(|k| o[k] * scale + offset[k]);
        let direction = d.map(|d| d * scale);
        let length = ray.direction.norm();
        let (enter, mut end) = cube_range(origin, direction);
        let depth = enter.max(settings.near).max(0.0);
        let finite = ray.origin.is_finite() && length.is_finite() && ray.offset.is_finite();
        if !finite || length == 0.0 {
            end = f32::MIN;
        }
        let inverse = direction.map(|d| 1.0 / d);
        let step_min = settings.step_min.max(1e-6);
        let (steps_from, steps_to) = (step_min / length, settings.step_max.max(step_min) / length);
        let steps = settings.steps_max;
        let mut marcher =
            Self { origin, direction, inverse, steps_from, steps_to, depth, end, steps };
        marcher.depth += ray.offset.clamp(0.0, 1.0) * marcher.step(settings);
        marcher
    }

    /// Length of the present step. Comparisons are faster than `max` and `min`, which test for NaN.
    fn step(&self, settings: &MarchSettings) -> f32 {
        let step = settings.cone * self.depth;
        let step = if step > self.steps_from { step } else { self.steps_from };
        if step < self.steps_to { step } else { self.steps_to }
    }

    /// Position in the unit cube at a depth.
    fn position(&self, depth: f32) -> [f32; 3] {
        std::array::from_fn(|k| self.origin[k] + depth * self.direction[k])
    }

    /// The next sample in an occupied cell, and its position in the unit cube.
    pub(crate) fn next(
        &mut self,
        settings: &MarchSettings,
        occupancy: &Occupancy,
    ) -> Option<(Sample, [f32; 3])> {
        while self.depth < self.end && self.steps > 0 {
            let (position, step) = (self.position(self.depth), self.step(settings));
            let Some(exit) = occupancy.empty_until(position, self.inverse) else {
                let sample = Sample { depth: self.depth, step };
                self.advance(step);
                return Some((sample, position));
            };
            let until = self.depth + exit;
            self.advance(step);
            while self.depth < until && self.steps > 0 {
                self.advance(self.step(settings));
            }
        }
        None
    }

    fn advance(&mut self, step: f32) {
        self.depth += step;
        self.steps -= 1;
    }
}

impl Occupancy {
    /// All samples of a ray in occupied cells, also those behind where it would end.
    pub fn samples(
        &self,
        field: &HashGridField,
        settings: &MarchSettings,
        ray: &Ray,
    ) -> Vec<Sample> {
        let mut marcher = RayMarcher::new(field, settings, ray);
        std::iter::from_fn(|| marcher.next(settings, self).map(|(sample, _)| sample)).collect()
    }
}

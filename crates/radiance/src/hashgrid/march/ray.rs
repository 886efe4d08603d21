//! Samples along a ray.

use super::Occupancy;
use crate::hashgrid::{HashGridField, MarchSettings};
use i2slam_geometry::{Real, Vec3};

/// A half-line `origin + depth · direction`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray<T = f32> {
    /// Where it starts, in the world \[m\].
    pub origin: Vec3<T>,
    /// Direction in the world, of any length but zero. Depths count in it: with a direction that
    /// goes 1 m along the optical axis they are metres along that axis.
    pub direction: Vec3<T>,
    /// Where in its step a sample lies, in `[0, 1)`: ½ for pictures, random for training.
    pub offset: T,
}

impl<T: Real> Ray<T> {
    /// The same ray in another scalar type.
    pub fn cast<U: Real>(&self) -> Ray<U> {
        let offset = U::of(self.offset.to_f64());
        Ray { origin: self.origin.cast(), direction: self.direction.cast(), offset }
    }
}

/// Where a ray is sampled.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample<T = f32> {
    /// Depth \[units of the ray's direction\].
    pub depth: T,
    /// The part of the ray that it stands for \[units of the ray's direction\].
    pub step: T,
}

/// Between which depths a ray lies in the unit cube; the first is the larger if it never does.
pub(super) fn inside(origin: [f32; 3], direction: [f32; 3]) -> (f32, f32) {
    let (mut enter, mut end) = (f32::MIN, f32::MAX);
    for (o, d) in std::iter::zip(origin, direction) {
        let (a, b) = ((0.0 - o) / d, (1.0 - o) / d);
        if d != 0.0 {
            (enter, end) = (enter.max(a.min(b)), end.min(a.max(b)));
        } else if !(0.0..=1.0).contains(&o) {
            end = f32::MIN;
        }
    }
    (enter, end)
}

/// A ray on its way through the occupied cells.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Walk {
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

impl Walk {
    /// From where the ray enters the cube of the field.
    pub(crate) fn new(field: &HashGridField, settings: &MarchSettings, ray: &Ray) -> Self {
        let (scale, offset) = field.to_unit();
        let (o, d) = (ray.origin.to_array(), ray.direction.to_array());
        let origin = std::array::from_fn(|k| o[k] * scale + offset[k]);
        let direction = d.map(|d| d * scale);
        let length = ray.direction.norm();
        let (enter, mut end) = inside(origin, direction);
        let depth = enter.max(settings.near).max(0.0);
        let finite = ray.origin.is_finite() && length.is_finite() && ray.offset.is_finite();
        if !finite || length == 0.0 {
            end = f32::MIN;
        }
        let inverse = direction.map(|d| 1.0 / d);
        let (steps_from, steps_to) = settings.steps();
        let (steps_from, steps_to) = (steps_from / length, steps_to / length);
        let steps = settings.steps_max;
        let mut walk = Self { origin, direction, inverse, steps_from, steps_to, depth, end, steps };
        walk.depth += ray.offset.clamp(0.0, 1.0) * walk.step(settings);
        walk
    }

    /// Length of the step at the present depth. Comparisons, because this is the longest chain of
    /// dependent operations of a march, and `max` and `min` look for NaN.
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
            let Some(exit) = occupancy.exit(position, self.inverse) else {
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

//! Rays, and samples along them.

use i2slam_geometry::{Real, Vec3};

/// A half-line `origin + depth · direction`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray<T = f32> {
    /// Origin in the world \[m\].
    pub origin: Vec3<T>,
    /// Direction in the world, of any length but zero; depths count in its lengths.
    pub direction: Vec3<T>,
    /// Place of a sample in its step, in `[0, 1)`: ½ for pictures, random for training.
    pub offset: T,
}

impl<T: Real> Ray<T> {
    /// Converts to another scalar type.
    pub fn cast<U: Real>(&self) -> Ray<U> {
        let offset = U::of(self.offset.to_f64());
        Ray { origin: self.origin.cast(), direction: self.direction.cast(), offset }
    }
}

/// A sample of a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample<T = f32> {
    /// Depth \[units of the ray's direction\].
    pub depth: T,
    /// The part of the ray that it stands for \[units of the ray's direction\].
    pub step: T,
}

/// Depths at which a ray enters and leaves the unit cube; the first is the larger if it misses.
pub(super) fn cube_range(origin: [f32; 3], direction: [f32; 3]) -> (f32, f32) {
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

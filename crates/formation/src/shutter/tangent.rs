//! Tangents and cotangents of both shutter poses at once: twelve numbers.

use i2slam_geometry::{Real, Tangent};

/// A tangent (or a cotangent, the gradient with respect to it) of both shutter poses.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct ShutterTangent<T> {
    /// At shutter open, in the camera frame of that moment [m, rad].
    pub start: Tangent<T>,
    /// At shutter close, in the camera frame of that moment [m, rad].
    pub end: Tangent<T>,
}

impl<T: Real> ShutterTangent<T> {
    /// The zero tangent.
    pub fn zero() -> Self {
        Self { start: Tangent::zero(), end: Tangent::zero() }
    }

    /// The sum of two tangents at the same poses.
    pub fn plus(self, other: Self) -> Self {
        Self { start: self.start.plus(other.start), end: self.end.plus(other.end) }
    }

    /// Every number multiplied by `s`.
    pub fn scaled(self, s: T) -> Self {
        Self { start: self.start.scaled(s), end: self.end.scaled(s) }
    }

    /// As `[start ρ, start φ, end ρ, end φ]`, three numbers each.
    pub fn to_array(self) -> [T; 12] {
        let (start, end) = (self.start.to_array(), self.end.to_array());
        std::array::from_fn(|i| if i < 6 { start[i] } else { end[i - 6] })
    }

    /// From `[start ρ, start φ, end ρ, end φ]`, three numbers each.
    pub fn from_array(a: [T; 12]) -> Self {
        Self {
            start: Tangent::from_array(std::array::from_fn(|i| a[i])),
            end: Tangent::from_array(std::array::from_fn(|i| a[i + 6])),
        }
    }
}

//! Rigid transforms, named so that they cancel: `world_from_camera * point_in_camera`.

use crate::{Real, Rotation, Vec3};
use std::ops::Mul;

/// A rigid transform `a_from_b`: maps points of frame `b` into frame `a`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose<T> {
    /// Rotation part.
    pub rotation: Rotation<T>,
    /// Translation part: the origin of `b` in `a` [m].
    pub translation: Vec3<T>,
}

/// A tangent of a pose `a_from_b`, in frame `b`: translation first, rotation second.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct Tangent<T> {
    /// Translation ρ [m], in frame `b`.
    pub translation: Vec3<T>,
    /// Rotation vector φ [rad], in frame `b`.
    pub rotation: Vec3<T>,
}

impl<T: Real> Tangent<T> {
    /// The zero tangent.
    pub fn zero() -> Self {
        Self { translation: Vec3::zero(), rotation: Vec3::zero() }
    }

    /// From `[ρx, ρy, ρz, φx, φy, φz]`.
    pub fn from_array(a: [T; 6]) -> Self {
        Self { translation: Vec3::new(a[0], a[1], a[2]), rotation: Vec3::new(a[3], a[4], a[5]) }
    }

    /// As `[ρx, ρy, ρz, φx, φy, φz]`.
    pub fn to_array(self) -> [T; 6] {
        let (t, r) = (self.translation, self.rotation);
        [t.x, t.y, t.z, r.x, r.y, r.z]
    }

    /// Both parts multiplied by `s`.
    pub fn scaled(self, s: T) -> Self {
        Self { translation: self.translation * s, rotation: self.rotation * s }
    }

    /// The sum of two tangents at the same pose.
    pub fn plus(self, o: Self) -> Self {
        Self { translation: self.translation + o.translation, rotation: self.rotation + o.rotation }
    }

    /// Converts to another scalar type.
    pub fn cast<U: Real>(self) -> Tangent<U> {
        Tangent { translation: self.translation.cast(), rotation: self.rotation.cast() }
    }
}

impl<T: Real> Pose<T> {
    /// The identity transform.
    pub fn identity() -> Self {
        Self { rotation: Rotation::identity(), translation: Vec3::zero() }
    }

    /// A transform from its parts.
    pub fn new(rotation: Rotation<T>, translation: Vec3<T>) -> Self {
        Self { rotation, translation }
    }

    /// `b_from_a` of `a_from_b`.
    pub fn inverse(self) -> Self {
        let rotation = self.rotation.inverse();
        Self { rotation, translation: -rotation.rotate(self.translation) }
    }

    /// The pose moved by a tangent in its own frame:
    /// `R ← R Exp(φ)`, `t ← t + R ρ`.
    ///
    /// Rotation and translation are retracted apart (not by the SE(3) exponential): this is the
    /// chart in which Slerp and Lerp of the shutter are linear, and it agrees with the
    /// exponential to first order.
    pub fn retract(self, tangent: Tangent<T>) -> Self {
        Self {
            rotation: self.rotation * Rotation::exp(tangent.rotation),
            translation: self.translation + self.rotation.rotate(tangent.translation),
        }
    }

    /// The tangent that [`retract`](Self::retract)s `self` to `other`.
    pub fn local(self, other: Self) -> Tangent<T> {
        let inverse = self.rotation.inverse();
        Tangent {
            translation: inverse.rotate(other.translation - self.translation),
            rotation: (inverse * other.rotation).log(),
        }
    }

    /// Slerp of the rotation, Lerp of the translation (eq. 7 of the paper).
    pub fn interpolate(self, other: Self, u: T) -> Self {
        Self {
            rotation: self.rotation.slerp(other.rotation, u),
            translation: self.translation.lerp(other.translation, u),
        }
    }

    /// Converts to another scalar type.
    pub fn cast<U: Real>(self) -> Pose<U> {
        Pose { rotation: self.rotation.cast(), translation: self.translation.cast() }
    }

    /// Whether every number is finite.
    pub fn is_finite(self) -> bool {
        self.translation.is_finite() && self.rotation.w.is_finite() && self.rotation.v.is_finite()
    }
}

impl<T: Real> Mul for Pose<T> {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self {
            rotation: self.rotation * o.rotation,
            translation: self.rotation.rotate(o.translation) + self.translation,
        }
    }
}

impl<T: Real> Mul<Vec3<T>> for Pose<T> {
    type Output = Vec3<T>;
    #[expect(clippy::suspicious_arithmetic_impl, reason = "a rigid transform adds its translation")]
    fn mul(self, point_in_b: Vec3<T>) -> Vec3<T> {
        self.rotation.rotate(point_in_b) + self.translation
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Pose<f64> {
        Pose::new(Rotation::exp(Vec3::new(0.4, -0.2, 0.9)), Vec3::new(1.0, -2.0, 0.5))
    }

    #[test]
    fn inverse_cancels() {
        let p = Vec3::new(0.3, 0.7, -1.1);
        assert!((example().inverse() * (example() * p) - p).norm() < 1e-12);
        assert!((example() * example().inverse()).translation.norm() < 1e-12);
    }

    #[test]
    fn local_inverts_retract() {
        let tangent = Tangent::from_array([0.1, -0.2, 0.3, 0.05, 0.4, -0.3]);
        let back = example().local(example().retract(tangent)).to_array();
        for (a, b) in back.iter().zip(tangent.to_array()) {
            assert!((a - b).abs() < 1e-12);
        }
    }

    #[test]
    fn interpolation_meets_both_ends_and_the_middle() {
        let end = example().retract(Tangent::from_array([0.1, 0.0, 0.3, 0.2, -0.1, 0.3]));
        let ends = [(0.0, example()), (1.0, end)];
        for (u, expected) in ends {
            let d = example().interpolate(end, u).local(expected);
            assert!(d.translation.norm() + d.rotation.norm() < 1e-12);
        }
        let forward = example().interpolate(end, 0.5);
        let backward = end.interpolate(example(), 0.5);
        let d = forward.local(backward);
        assert!(d.translation.norm() + d.rotation.norm() < 1e-12);
    }
}

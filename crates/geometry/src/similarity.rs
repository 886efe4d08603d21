//! Similarity transforms Sim(3): rotation, translation and scale.

use crate::{Pose, Real, Rotation, Vec3};

/// A similarity `a_from_b`: `p ↦ scale · rotation p + translation`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity<T> {
    /// Scale, above zero.
    pub scale: T,
    /// Rotation.
    pub rotation: Rotation<T>,
    /// Translation: the origin of `b` in `a`.
    pub translation: Vec3<T>,
}

impl<T: Real> Similarity<T> {
    /// A rigid transform with a scale.
    pub fn from_pose(pose: Pose<T>, scale: T) -> Self {
        Self { scale, rotation: pose.rotation, translation: pose.translation }
    }

    /// Rotation and translation without the scale.
    pub fn pose(&self) -> Pose<T> {
        Pose::new(self.rotation, self.translation)
    }

    /// `b_from_a` of `a_from_b`.
    pub fn inverse(&self) -> Self {
        let (scale, rotation) = (self.scale.recip(), self.rotation.inverse());
        Self { scale, rotation, translation: -rotation.rotate(self.translation) * scale }
    }

    /// `a_from_c` of `self = a_from_b` and `other = b_from_c`.
    pub fn compose(&self, other: &Self) -> Self {
        Self {
            scale: self.scale * other.scale,
            rotation: self.rotation * other.rotation,
            translation: self.apply(other.translation),
        }
    }

    /// A point of `b` in `a`.
    pub fn apply(&self, point: Vec3<T>) -> Vec3<T> {
        self.rotation.rotate(point) * self.scale + self.translation
    }

    /// A pose in `b` as a pose in `a`: its centre moves as a point, its axes turn.
    pub fn apply_to_pose(&self, pose: Pose<T>) -> Pose<T> {
        Pose::new(self.rotation * pose.rotation, self.apply(pose.translation))
    }

    /// The similarity moved by a tangent `(ρ, φ, σ)` in its own frame: `R ← R Exp(φ)`,
    /// `t ← t + s R ρ`, `s ← s exp(σ)`.
    pub fn retract(&self, tangent: &[T; 7]) -> Self {
        let [x, y, z, a, b, c, sigma] = *tangent;
        Self {
            scale: self.scale * sigma.exp(),
            rotation: (self.rotation * Rotation::exp(Vec3::new(a, b, c))).normalized(),
            translation: self.apply(Vec3::new(x, y, z)),
        }
    }

    /// Coordinates `(t, log R, ln s)`, zero for the identity.
    pub fn coordinates(&self) -> [T; 7] {
        let (t, phi) = (self.translation, self.rotation.log());
        [t.x, t.y, t.z, phi.x, phi.y, phi.z, self.scale.ln()]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_similarity_and_its_inverse_cancel() {
        let rotation = Rotation::exp(Vec3::new(0.3, -0.2, 0.5));
        let s: Similarity<f64> =
            Similarity { scale: 1.7, rotation, translation: Vec3::new(1.0, 2.0, -0.5) };
        assert!(s.compose(&s.inverse()).coordinates().iter().all(|v| v.abs() < 1e-12));
        let point = Vec3::new(0.4, -1.0, 2.0);
        assert!((s.inverse().apply(s.apply(point)) - point).norm() < 1e-12);
    }
}

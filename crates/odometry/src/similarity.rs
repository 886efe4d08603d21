//! Poses with a scale.

use i2slam_geometry::{Pose, Rotation, Vec3};

/// `x ↦ scale · rotation x + translation`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Similarity {
    pub(crate) scale: f64,
    pub(crate) rotation: Rotation<f64>,
    pub(crate) translation: Vec3<f64>,
}

impl Similarity {
    /// A pose at a scale.
    pub(crate) fn of(pose: Pose<f64>, scale: f64) -> Self {
        Self { scale, rotation: pose.rotation, translation: pose.translation }
    }

    /// The pose of a camera that is placed so; its own scale is lost.
    pub(crate) fn pose(&self) -> Pose<f64> {
        Pose::new(self.rotation, self.translation)
    }

    pub(crate) fn inverse(&self) -> Self {
        let (scale, rotation) = (self.scale.recip(), self.rotation.inverse());
        Self { scale, rotation, translation: -rotation.rotate(self.translation) * scale }
    }

    /// First `other`, then this.
    pub(crate) fn after(&self, other: &Self) -> Self {
        Self {
            scale: self.scale * other.scale,
            rotation: self.rotation * other.rotation,
            translation: self.point(other.translation),
        }
    }

    pub(crate) fn point(&self, point: Vec3<f64>) -> Vec3<f64> {
        self.rotation.rotate(point) * self.scale + self.translation
    }

    /// `R ← R Exp(φ)`, `t ← t + s R ρ`, `s ← s exp(σ)` for `(ρ, φ, σ)`.
    pub(crate) fn retract(&self, tangent: &[f64; 7]) -> Self {
        let [x, y, z, a, b, c, sigma] = *tangent;
        Self {
            scale: self.scale * sigma.exp(),
            rotation: (self.rotation * Rotation::exp(Vec3::new(a, b, c))).normalized(),
            translation: self.point(Vec3::new(x, y, z)),
        }
    }

    /// `(t, log R, ln s)`: zero for the identity.
    pub(crate) fn chart(&self) -> [f64; 7] {
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
        let s = Similarity { scale: 1.7, rotation, translation: Vec3::new(1.0, 2.0, -0.5) };
        assert!(s.after(&s.inverse()).chart().iter().all(|v| v.abs() < 1e-12));
        let point = Vec3::new(0.4, -1.0, 2.0);
        assert!((s.inverse().point(s.point(point)) - point).norm() < 1e-12);
    }
}

//! Rotations as unit quaternions, with exponential, logarithm and the Jacobians of both.
//!
//! Tangents are rotation vectors in radians. A perturbation acts on the right:
//! `R ⊞ φ = R · Exp(φ)`, so φ lives in the frame that the rotation maps *from*.

use crate::{Mat3, Real, Vec3};
use std::ops::Mul;

/// A rotation, stored as a unit quaternion `w + xi + yj + zk`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rotation<T> {
    /// Real part.
    pub w: T,
    /// Imaginary part `(x, y, z)`.
    pub v: Vec3<T>,
}

impl<T: Real> Rotation<T> {
    /// No rotation.
    pub fn identity() -> Self {
        Self { w: T::one(), v: Vec3::zero() }
    }

    /// From quaternion components in the order `w, x, y, z`, normalised.
    /// The zero quaternion and components that are not finite give `None`.
    pub fn from_wxyz(w: T, x: T, y: T, z: T) -> Option<Self> {
        let norm = (w * w + x * x + y * y + z * z).sqrt();
        let usable = norm.is_finite() && norm > T::of(1e-12);
        usable.then(|| Self { w: w / norm, v: Vec3::new(x / norm, y / norm, z / norm) })
    }

    /// The inverse rotation.
    pub fn inverse(self) -> Self {
        Self { w: self.w, v: -self.v }
    }

    /// `R · p`.
    pub fn rotate(self, p: Vec3<T>) -> Vec3<T> {
        let t = self.v.cross(p) * T::of(2.0);
        p + t * self.w + self.v.cross(t)
    }

    /// The rotation matrix.
    pub fn matrix(self) -> Mat3<T> {
        let columns = [
            self.rotate(Vec3::new(T::one(), T::zero(), T::zero())).to_array(),
            self.rotate(Vec3::new(T::zero(), T::one(), T::zero())).to_array(),
            self.rotate(Vec3::new(T::zero(), T::zero(), T::one())).to_array(),
        ];
        Mat3 { rows: columns }.transpose()
    }

    /// The rotation of a proper orthogonal matrix (Shepperd's method).
    pub fn from_matrix(m: &Mat3<T>) -> Self {
        let one = T::one();
        let r = &m.rows;
        let trace = r[0][0] + r[1][1] + r[2][2];
        let candidates = [
            [one + trace, r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]],
            [
                r[2][1] - r[1][2],
                one + r[0][0] - r[1][1] - r[2][2],
                r[1][0] + r[0][1],
                r[0][2] + r[2][0],
            ],
            [
                r[0][2] - r[2][0],
                r[1][0] + r[0][1],
                one - r[0][0] + r[1][1] - r[2][2],
                r[2][1] + r[1][2],
            ],
            [
                r[1][0] - r[0][1],
                r[0][2] + r[2][0],
                r[2][1] + r[1][2],
                one - r[0][0] - r[1][1] + r[2][2],
            ],
        ];
        let best = (0..4).fold(0, |b, i| if candidates[i][i] > candidates[b][b] { i } else { b });
        let [w, x, y, z] = candidates[best];
        Self::from_wxyz(w, x, y, z).unwrap_or_else(Self::identity)
    }

    /// The exponential of a rotation vector [rad].
    pub fn exp(phi: Vec3<T>) -> Self {
        let half = T::of(0.5);
        let theta = phi.norm();
        let sinc = if theta < T::of(1e-6) {
            half - theta * theta / T::of(48.0)
        } else {
            (theta * half).sin() / theta
        };
        Self { w: (theta * half).cos(), v: phi * sinc }.normalized()
    }

    /// The rotation vector [rad], of length at most π.
    pub fn log(self) -> Vec3<T> {
        let (w, v) = if self.w < T::zero() { (-self.w, -self.v) } else { (self.w, self.v) };
        let sine = v.norm();
        if sine < T::of(1e-7) {
            return v * (T::of(2.0) / w);
        }
        v * (T::of(2.0) * sine.atan2(w) / sine)
    }

    /// Spherical interpolation `self · Exp(u · Log(self⁻¹ · other))` along the shorter arc.
    pub fn slerp(self, other: Self, u: T) -> Self {
        self * Self::exp((self.inverse() * other).log() * u)
    }

    /// Scales the quaternion to length one.
    pub fn normalized(self) -> Self {
        let norm = (self.w * self.w + self.v.norm_squared()).sqrt();
        Self { w: self.w / norm, v: self.v * norm.recip() }
    }

    /// Converts to another scalar type.
    pub fn cast<U: Real>(self) -> Rotation<U> {
        Rotation { w: U::of(self.w.to_f64()), v: self.v.cast() }.normalized()
    }
}

impl<T: Real> Mul for Rotation<T> {
    type Output = Self;
    fn mul(self, o: Self) -> Self {
        Self {
            w: self.w * o.w - self.v.dot(o.v),
            v: o.v * self.w + self.v * o.w + self.v.cross(o.v),
        }
        .normalized()
    }
}

/// The right Jacobian of the exponential: `Exp(φ + δ) ≈ Exp(φ) · Exp(J_r(φ) δ)`.
///
/// `J_r = I - (1 - cos θ)/θ² [φ]× + (θ - sin θ)/θ³ [φ]×²` (Chirikjian; Solà et al. 2018, eq. 143).
pub fn right_jacobian<T: Real>(phi: Vec3<T>) -> Mat3<T> {
    let theta2 = phi.norm_squared();
    let (a, b) = if theta2 < T::of(1e-6) {
        (T::of(0.5) - theta2 / T::of(24.0), T::of(1.0 / 6.0) - theta2 / T::of(120.0))
    } else {
        let theta = theta2.sqrt();
        ((T::one() - theta.cos()) / theta2, (theta - theta.sin()) / (theta2 * theta))
    };
    let k = Mat3::skew(phi);
    Mat3::identity() + k.scaled(-a) + (k * k).scaled(b)
}

/// The inverse of [`right_jacobian`] (Solà et al. 2018, eq. 144), for `‖φ‖ < 2π`; that of the left
/// Jacobian is `J_l⁻¹(φ) = J_r⁻¹(-φ)`.
pub fn right_jacobian_inverse<T: Real>(phi: Vec3<T>) -> Mat3<T> {
    let theta2 = phi.norm_squared();
    let b = if theta2 < T::of(1e-6) {
        T::of(1.0 / 12.0) + theta2 / T::of(720.0)
    } else {
        let theta = theta2.sqrt();
        theta2.recip() - (T::one() + theta.cos()) / (T::of(2.0) * theta * theta.sin())
    };
    let k = Mat3::skew(phi);
    Mat3::identity() + k.scaled(T::of(0.5)) + (k * k).scaled(b)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn examples() -> Vec<Vec3<f64>> {
        vec![
            Vec3::zero(),
            Vec3::new(1e-9, -2e-9, 3e-9),
            Vec3::new(1e-4, 2e-4, -1e-4),
            Vec3::new(0.3, -0.2, 0.5),
            Vec3::new(-1.5, 1.0, 2.0),
        ]
    }

    #[test]
    fn log_inverts_exp() {
        for phi in examples() {
            assert!((Rotation::exp(phi).log() - phi).norm() < 1e-12);
        }
    }

    #[test]
    fn matrix_round_trip() {
        for phi in examples() {
            let r = Rotation::exp(phi);
            let back = Rotation::from_matrix(&r.matrix());
            assert!((r.inverse() * back).log().norm() < 1e-12);
            assert!((r.matrix().determinant() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn right_jacobian_agrees_with_differences() {
        let step = 1e-6;
        for phi in examples() {
            let jacobian = right_jacobian(phi);
            for axis in 0..3 {
                let mut delta = [0.0; 3];
                delta[axis] = step;
                let delta = Vec3::from_array(delta);
                let plus = Rotation::exp(phi).inverse() * Rotation::exp(phi + delta);
                let minus = Rotation::exp(phi).inverse() * Rotation::exp(phi - delta);
                let numeric = (plus.log() - minus.log()) * (0.5 / step);
                let column = jacobian * (delta * (1.0 / step));
                assert!((numeric - column).norm() < 1e-7, "{phi:?} {numeric:?} {column:?}");
            }
        }
    }

    #[test]
    fn jacobian_inverses_cancel() {
        for phi in examples() {
            let product = right_jacobian(phi) * right_jacobian_inverse(phi);
            for r in 0..3 {
                for c in 0..3 {
                    let expected = if r == c { 1.0 } else { 0.0 };
                    assert!((product[(r, c)] - expected).abs() < 1e-10);
                }
            }
        }
    }

    #[test]
    fn zero_and_nan_quaternions_are_refused() {
        assert!(Rotation::from_wxyz(0.0, 0.0, 0.0, 0.0).is_none());
        assert!(Rotation::from_wxyz(f64::NAN, 0.0, 0.0, 1.0).is_none());
    }
}

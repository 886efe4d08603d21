//! Small matrices of the reference projection, and their ways back.

use i2slam_geometry::{Mat3, Real};

/// The inverse of the symmetric matrix `[[a, b], [b, c]]`, if it is positive definite.
pub(super) fn inverse<T: Real>([a, b, c]: [T; 3]) -> Option<[T; 3]> {
    let determinant = a * c - b * b;
    (determinant > T::zero()).then(|| [c / determinant, -b / determinant, a / determinant])
}

/// `∂L/∂Σ` as a symmetric matrix `[xx, xy, yy]` from `∂L/∂[A, B, C]` of `K = Σ⁻¹`:
/// `-K G K` with `G = [[dA, dB/2], [dB/2, dC]]`.
pub(super) fn inverse_cotangent<T: Real>([a, b, c]: [T; 3], [da, db, dc]: [T; 3]) -> [T; 3] {
    let db = db * T::of(0.5);
    let (p, q) = (a * da + b * db, a * db + b * dc);
    let (r, s) = (b * da + c * db, b * db + c * dc);
    [-(p * a + q * b), -(p * b + q * c), -(r * b + s * c)]
}

/// `∂L/∂q` of the rotation matrix of `q / |q|`, from `∂L/∂R`.
pub(super) fn quaternion_cotangent<T: Real>(q: [T; 4], d: &Mat3<T>) -> [T; 4] {
    let norm = q.iter().map(|v| *v * *v).sum::<T>().sqrt();
    let [w, x, y, z] = q.map(|v| v / norm);
    let (two, m) = (T::of(2.0), &d.rows);
    let unit = [
        two * (x * (m[2][1] - m[1][2]) + y * (m[0][2] - m[2][0]) + z * (m[1][0] - m[0][1])),
        two * (y * (m[0][1] + m[1][0]) + z * (m[0][2] + m[2][0]) + w * (m[2][1] - m[1][2])
            - two * x * (m[1][1] + m[2][2])),
        two * (x * (m[0][1] + m[1][0]) + z * (m[1][2] + m[2][1]) + w * (m[0][2] - m[2][0])
            - two * y * (m[0][0] + m[2][2])),
        two * (x * (m[0][2] + m[2][0]) + y * (m[1][2] + m[2][1]) + w * (m[1][0] - m[0][1])
            - two * z * (m[0][0] + m[1][1])),
    ];
    let along = unit[0] * w + unit[1] * x + unit[2] * y + unit[3] * z;
    std::array::from_fn(|i| (unit[i] - [w, x, y, z][i] * along) / norm)
}

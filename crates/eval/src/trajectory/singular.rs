//! Singular value decomposition of 3x3 matrices by one-sided Jacobi rotations.

use i2slam_geometry::{Mat3, Vec3};

/// The right singular vectors of a matrix `m` with their images, in order of falling length:
/// `m · right[k] = image[k]`, the images orthogonal, their lengths the singular values.
pub(super) struct Singular {
    /// Orthonormal right singular vectors.
    pub(super) right: [Vec3<f64>; 3],
    /// Their images under the matrix: left singular vectors times singular values.
    pub(super) image: [Vec3<f64>; 3],
}

/// One-sided Jacobi (Hestenes 1958; Golub & Van Loan, Matrix Computations, 8.6.3): rotate pairs
/// of columns of `B = M V` until all are orthogonal. Small singular values keep their relative
/// accuracy, which forming `MᵀM` would lose.
pub(super) fn singular(m: &Mat3<f64>) -> Singular {
    let mut image = m.transpose().rows.map(Vec3::from_array);
    let mut right = Mat3::<f64>::identity().rows.map(Vec3::from_array);
    for _ in 0..40 {
        let mut orthogonal = true;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (image[p].norm_squared(), image[q].norm_squared());
            let overlap = image[p].dot(image[q]);
            if overlap.abs() <= f64::EPSILON * (a * b).sqrt() {
                continue;
            }
            orthogonal = false;
            let zeta = (b - a) / (2.0 * overlap);
            let tangent = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
            turn(&mut image, p, q, tangent);
            turn(&mut right, p, q, tangent);
        }
        if orthogonal {
            break;
        }
    }
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| image[b].norm().total_cmp(&image[a].norm()));
    Singular { right: order.map(|k| right[k]), image: order.map(|k| image[k]) }
}

/// Rotate columns `p` and `q` by the angle of the given tangent.
fn turn(columns: &mut [Vec3<f64>; 3], p: usize, q: usize, tangent: f64) {
    let cosine = (1.0 + tangent * tangent).sqrt().recip();
    let sine = cosine * tangent;
    let (a, b) = (columns[p], columns[q]);
    columns[p] = a * cosine - b * sine;
    columns[q] = a * sine + b * cosine;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn matrices() -> Vec<Mat3<f64>> {
        let of =
            |v: &[f64]| Mat3 { rows: [[v[0], v[1], v[2]], [v[3], v[4], v[5]], [v[6], v[7], v[8]]] };
        let mut all: Vec<_> = (0..20).map(|seed| of(&i2slam_check::noise(seed, 9))).collect();
        all.push(Mat3::identity());
        all.push(Mat3::zero());
        all.push(of(&[1.0, 2.0, 3.0, 2.0, 4.0, 6.0, -1.0, -2.0, -3.0]));
        all.push(of(&[1.0, 1.0, 1.0, 1.0, 1.0 + 1e-14, 1.0, 1.0, 1.0, 1.0 - 1e-14]));
        all
    }

    #[test]
    fn vectors_are_orthogonal_and_reproduce_the_matrix() {
        for m in matrices() {
            let s = singular(&m);
            for i in 0..3 {
                assert!((m * s.right[i] - s.image[i]).norm() < 1e-14 * 10.0);
                assert!((s.right[i].norm() - 1.0).abs() < 1e-14);
                for j in 0..i {
                    assert!(s.right[i].dot(s.right[j]).abs() < 1e-14);
                    let scale = s.image[0].norm_squared().max(1.0);
                    assert!(s.image[i].dot(s.image[j]).abs() < 1e-14 * scale);
                    assert!(s.image[j].norm() >= s.image[i].norm());
                }
            }
        }
    }

    #[test]
    fn known_values() {
        let m = Mat3::diagonal(Vec3::new(2.0, -5.0, 0.5));
        let lengths = singular(&m).image.map(|v| v.norm());
        assert_eq!(lengths, [5.0, 2.0, 0.5]);
    }
}

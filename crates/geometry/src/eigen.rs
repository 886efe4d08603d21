//! Eigenvalues of symmetric 3x3 matrices, by Jacobi's rotations.

use crate::{Mat3, Real, Vec3};

/// Sweeps over the three entries beside the diagonal; convergence is quadratic, five are usual.
const SWEEPS: usize = 16;

/// Eigenvalues of a symmetric matrix, largest first, and the orthonormal eigenvectors as columns
/// of a proper rotation: `A = V diag(λ) Vᵀ`.
///
/// Cyclic Jacobi (Golub and Van Loan, Matrix Computations, 8.5): every rotation makes one entry
/// beside the diagonal zero. Only the upper half of `a` is read.
pub fn symmetric_eigen<T: Real>(a: &Mat3<T>) -> (Vec3<T>, Mat3<T>) {
    let upper = |r: usize, c: usize| a.rows[r.min(c)][r.max(c)];
    let mut a = Mat3 { rows: std::array::from_fn(|r| std::array::from_fn(|c| upper(r, c))) };
    let mut v = Mat3::identity();
    for _ in 0..SWEEPS {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if a[(p, q)] != T::zero() {
                let turn = rotation(&a, p, q);
                a = turn.transpose() * a * turn;
                (a[(p, q)], a[(q, p)]) = (T::zero(), T::zero());
                v = v * turn;
            }
        }
    }
    sorted(&a, &v)
}

/// The rotation in the plane of axes `p` and `q` after which their entry is zero.
fn rotation<T: Real>(a: &Mat3<T>, p: usize, q: usize) -> Mat3<T> {
    let two = T::of(2.0);
    let ratio = (a[(q, q)] - a[(p, p)]) / (two * a[(p, q)]);
    let sign = if ratio < T::zero() { -T::one() } else { T::one() };
    // The smaller root of t² + 2 ratio t = 1; zero where the ratio is beyond its type.
    let tangent = sign / (sign * ratio + (ratio * ratio + T::one()).sqrt());
    let cosine = (tangent * tangent + T::one()).sqrt().recip();
    let sine = tangent * cosine;
    let mut turn = Mat3::identity();
    (turn[(p, p)], turn[(q, q)]) = (cosine, cosine);
    (turn[(p, q)], turn[(q, p)]) = (sine, -sine);
    turn
}

/// Values of the diagonal in falling order and their columns, the third turned so that the frame
/// is right-handed.
fn sorted<T: Real>(a: &Mat3<T>, v: &Mat3<T>) -> (Vec3<T>, Mat3<T>) {
    let mut order = [0, 1, 2];
    for (i, j) in [(0, 1), (1, 2), (0, 1)] {
        if a[(order[i], order[i])] < a[(order[j], order[j])] {
            order.swap(i, j);
        }
    }
    let values = Vec3::from_array(order.map(|k| a[(k, k)]));
    let columns = v.transpose().rows;
    let [first, second, _] = order.map(|k| Vec3::from_array(columns[k]));
    let third = first.cross(second);
    (values, Mat3 { rows: [first, second, third].map(Vec3::to_array) }.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rotation;

    fn assert_near(found: [f64; 3], expected: [f64; 3]) {
        for (found, expected) in found.into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
    }

    fn assert_solves(a: &Mat3<f64>, expected: [f64; 3]) {
        let (values, vectors) = symmetric_eigen(a);
        assert_near(values.to_array(), expected);
        let back = vectors * Mat3::diagonal(values) * vectors.transpose();
        let unit = vectors.transpose() * vectors;
        for r in 0..3 {
            assert_near(back.rows[r], a.rows[r]);
            assert_near(unit.rows[r], Mat3::identity().rows[r]);
        }
        assert!((vectors.determinant() - 1.0).abs() < 1e-12);
    }

    #[test]
    fn turned_diagonals_are_found_again() {
        let turns =
            [[0.0; 3], [0.3, -0.2, 0.5], [-1.5, 1.0, 2.0], [0.0, 0.0, 1.0], [1e-9, 0.0, 1e-5]];
        let values =
            [[3.0, 2.0, 1.0], [2.0, 2.0, 1e-8], [1.0, 1.0, 1.0], [5.0, 0.0, -4.0], [0.0; 3]];
        for turn in turns.map(|t| Rotation::exp(Vec3::from_array(t)).matrix()) {
            for value in values {
                for [i, j, k] in [[0, 1, 2], [2, 0, 1], [1, 0, 2], [2, 1, 0]] {
                    let diagonal = Mat3::diagonal(Vec3::new(value[i], value[j], value[k]));
                    assert_solves(&(turn * diagonal * turn.transpose()), value);
                }
            }
        }
    }

    #[test]
    fn entries_far_apart_in_size_give_finite_results() {
        let a = Mat3 { rows: [[1.0, 1e-200, 0.0], [1e-200, 2.0, 1e-300], [0.0, 1e-300, 0.0]] };
        assert_solves(&a, [2.0, 1.0, 0.0]);
    }
}

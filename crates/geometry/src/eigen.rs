//! Eigenvalues of small symmetric matrices, by Jacobi's rotations.

use crate::{Mat3, Vec3};

/// Sweeps over the entries beside the diagonal; convergence is quadratic, eight are usual.
const SWEEPS: usize = 30;
/// Share of the diagonal's size from which on an entry beside it counts.
const NEGLIGIBLE: f64 = 1e-17;

/// Eigenvalues of a symmetric `N x N` matrix, in no order, and the orthonormal eigenvectors as
/// columns: `A = V diag(λ) Vᵀ`.
///
/// Cyclic Jacobi (Golub and Van Loan, Matrix Computations, 8.5). Only the upper half of `a` is
/// read.
pub fn symmetric_eigen_of<const N: usize>(a: &[[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut a: [[f64; N]; N] =
        std::array::from_fn(|r| std::array::from_fn(|c| a[r.min(c)][r.max(c)]));
    let mut v = [[0.0; N]; N];
    (0..N).for_each(|i| v[i][i] = 1.0);
    for _ in 0..SWEEPS {
        let mut turned = false;
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q].abs() > NEGLIGIBLE * (a[p][p].abs() + a[q][q].abs()) {
                    turn(&mut a, &mut v, (p, q));
                    turned = true;
                }
            }
        }
        if !turned {
            break;
        }
    }
    (std::array::from_fn(|i| a[i][i]), v)
}

/// Turns the plane of axes `p` and `q` so that their entry becomes zero.
fn turn<const N: usize>(a: &mut [[f64; N]; N], v: &mut [[f64; N]; N], (p, q): (usize, usize)) {
    let ratio = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let sign = if ratio < 0.0 { -1.0 } else { 1.0 };
    // The smaller root of t² + 2 ratio t = 1; zero where the ratio is beyond its type.
    let tangent = sign / (sign * ratio + (ratio * ratio + 1.0).sqrt());
    let cosine = (tangent * tangent + 1.0).sqrt().recip();
    let sine = tangent * cosine;
    let both = |x: f64, y: f64| (cosine * x - sine * y, sine * x + cosine * y);
    for row in &mut *a {
        (row[p], row[q]) = both(row[p], row[q]);
    }
    for column in 0..N {
        (a[p][column], a[q][column]) = both(a[p][column], a[q][column]);
    }
    (a[p][q], a[q][p]) = (0.0, 0.0);
    for row in v {
        (row[p], row[q]) = both(row[p], row[q]);
    }
}

/// Eigenvalues of a symmetric 3x3 matrix, largest first, and the eigenvectors as columns of a
/// proper rotation.
pub fn symmetric_eigen(a: &Mat3<f64>) -> (Vec3<f64>, Mat3<f64>) {
    let (values, rows) = symmetric_eigen_of(&a.rows);
    let mut order = [0, 1, 2];
    order.sort_by(|i, j| values[*j].total_cmp(&values[*i]));
    let columns = Mat3 { rows }.transpose().rows;
    let [first, second, _] = order.map(|k| Vec3::from_array(columns[k]));
    let vectors = [first, second, first.cross(second)].map(Vec3::to_array);
    (Vec3::from_array(order.map(|k| values[k])), Mat3 { rows: vectors }.transpose())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Rotation;

    fn assert_decomposes<const N: usize>(a: [[f64; N]; N]) -> [f64; N] {
        let (values, v) = symmetric_eigen_of(&a);
        for r in 0..N {
            for c in 0..N {
                let back: f64 = (0..N).map(|k| v[r][k] * values[k] * v[c][k]).sum();
                let unit: f64 = (0..N).map(|k| v[k][r] * v[k][c]).sum();
                assert!((back - a[r.min(c)][r.max(c)]).abs() < 1e-11, "{r} {c}: {back}");
                assert!((unit - f64::from(u8::from(r == c))).abs() < 1e-12, "{r} {c}: {unit}");
            }
        }
        values
    }

    #[test]
    fn known_matrices() {
        let mut values = assert_decomposes([[2.0, 1.0], [f64::NAN, 2.0]]);
        values.sort_by(f64::total_cmp);
        assert!((values[0] - 1.0).abs() < 1e-12 && (values[1] - 3.0).abs() < 1e-12);
        assert_eq!(assert_decomposes([[0.0; 4]; 4]), [0.0; 4]);
        assert_decomposes([[1e-20, 1e-12, 0.0], [0.0, 5.0, -1e-9], [0.0, 0.0, 1e3]]);
    }

    #[test]
    fn a_gram_matrix_of_low_rank() {
        let row = |i: usize, seed: f64| ((i as f64 + 1.0) * seed).sin();
        let gram = std::array::from_fn(|r| {
            std::array::from_fn(|c| {
                [0.7, 1.9, 3.1, 4.3].iter().map(|s| row(r, *s) * row(c, *s)).sum()
            })
        });
        let values: [f64; 12] = assert_decomposes(gram);
        assert_eq!(values.iter().filter(|v| v.abs() < 1e-12).count(), 8);
        assert!(values.iter().all(|v| *v > -1e-12));
    }

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

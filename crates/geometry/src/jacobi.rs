//! Eigenvalues of symmetric matrices of any small size, by Jacobi's rotations.

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

#[cfg(test)]
mod tests {
    use super::*;

    fn assert_solves<const N: usize>(a: [[f64; N]; N]) -> [f64; N] {
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
        let mut values = assert_solves([[2.0, 1.0], [f64::NAN, 2.0]]);
        values.sort_by(f64::total_cmp);
        assert!((values[0] - 1.0).abs() < 1e-12 && (values[1] - 3.0).abs() < 1e-12);
        assert_eq!(assert_solves([[0.0; 4]; 4]), [0.0; 4]);
        assert_solves([[1e-20, 1e-12, 0.0], [0.0, 5.0, -1e-9], [0.0, 0.0, 1e3]]);
    }

    #[test]
    fn a_gram_matrix_of_low_rank() {
        let row = |i: usize, seed: f64| ((i as f64 + 1.0) * seed).sin();
        let gram = std::array::from_fn(|r| {
            std::array::from_fn(|c| {
                [0.7, 1.9, 3.1, 4.3].iter().map(|s| row(r, *s) * row(c, *s)).sum()
            })
        });
        let values: [f64; 12] = assert_solves(gram);
        assert_eq!(values.iter().filter(|v| v.abs() < 1e-12).count(), 8);
        assert!(values.iter().all(|v| *v > -1e-12));
    }
}

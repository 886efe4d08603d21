//! Camera preconditioning (CamP, Park et al. 2023) on photometric errors.

use crate::objective::ShutterGram;
use i2slam_geometry::symmetric_eigen_of;

/// Least that is added to the diagonal.
const MIN_PRECONDITIONER: f64 = 1e-8;

/// `P = (JᵀJ + diag(max(1e-8, r diag(JᵀJ))))^(-1/2)`, `r` being `damping`: with `ξ = P z`, every
/// coordinate of `z` changes the picture alike, and none changes what another does.
pub(super) fn preconditioner(gram: &ShutterGram, damping: f64) -> ShutterGram {
    inverse_root(gram, |i| (damping * gram[i][i]).max(MIN_PRECONDITIONER))
}

/// The same with the damping of a coordinate never less than that of the mean translation or
/// rotation: one that the picture hardly shows is not stepped far on what little it says, and
/// takes nothing from the length of steps along those that it shows.
pub(super) fn levelled(gram: &ShutterGram, damping: f64) -> ShutterGram {
    let rotates = |i: usize| i % 6 >= 3;
    let mean =
        |kind: bool| (0..12).filter(|&i| rotates(i) == kind).map(|i| gram[i][i]).sum::<f64>() / 6.0;
    let means = [mean(false), mean(true)];
    let least = |i: usize| means[usize::from(rotates(i))];
    inverse_root(gram, |i| (damping * gram[i][i].max(least(i))).max(MIN_PRECONDITIONER))
}

/// The inverse square root of a matrix to whose diagonal something is added.
fn inverse_root(gram: &ShutterGram, added: impl Fn(usize) -> f64) -> ShutterGram {
    let mut damped = *gram;
    for (i, row) in damped.iter_mut().enumerate() {
        row[i] += added(i);
    }
    let (values, v) = symmetric_eigen_of(&damped);
    let roots = values.map(|value| value.max(MIN_PRECONDITIONER).sqrt().recip());
    std::array::from_fn(|r| {
        std::array::from_fn(|c| (0..12).map(|k| v[r][k] * roots[k] * v[c][k]).sum())
    })
}

/// A multiple of `P` that leaves the length of vectors as it is, in the root mean square over all
/// directions.
pub(super) fn as_long(matrix: &ShutterGram) -> ShutterGram {
    let squares: f64 = matrix.iter().flatten().map(|v| v * v).sum();
    let factor = (12.0 / squares.max(MIN_PRECONDITIONER)).sqrt();
    matrix.map(|row| row.map(|v| factor * v))
}

/// The product with a vector; the matrix is symmetric.
pub(super) fn times(matrix: &ShutterGram, vector: [f64; 12]) -> [f64; 12] {
    matrix.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gram() -> ShutterGram {
        let rows: Vec<[f64; 12]> = (0..40)
            .map(|n| {
                std::array::from_fn(|i| ((1 + n * (i + 2)) as f64 * 0.37).sin() * (1 + i) as f64)
            })
            .collect();
        std::array::from_fn(|r| std::array::from_fn(|c| rows.iter().map(|j| j[r] * j[c]).sum()))
    }

    #[test]
    fn the_jacobian_of_preconditioned_coordinates_is_orthonormal() {
        let gram = gram();
        let p = preconditioner(&gram, 1e-12);
        for c in 0..12 {
            let unit = std::array::from_fn(|i| f64::from(u8::from(i == c)));
            let back = times(&p, times(&gram, times(&p, unit)));
            for (r, value) in back.into_iter().enumerate() {
                assert!((value - unit[r]).abs() < 1e-6, "{r} {c}: {value}");
            }
        }
    }

    #[test]
    fn a_step_keeps_its_length() {
        let p = preconditioner(&gram(), 0.1);
        let [once, scaled] = [as_long(&p), as_long(&p.map(|row| row.map(|v| 7.0 * v)))];
        let unit = |c: usize| std::array::from_fn(|i| f64::from(u8::from(i == c)));
        let squares = (0..12).flat_map(|c| times(&once, unit(c))).map(|v| v * v).sum::<f64>();
        assert!((squares - 12.0).abs() < 1e-9, "{squares}");
        let apart = once.iter().flatten().zip(scaled.iter().flatten()).map(|(a, b)| (a - b).abs());
        assert!(apart.fold(0.0, f64::max) < 1e-9);
    }

    #[test]
    fn what_no_pixel_sees_takes_nothing_from_the_rest() {
        let mut gram = gram();
        let before = as_long(&levelled(&gram, 0.1));
        for i in 0..12 {
            (gram[i][5], gram[5][i]) = (0.0, 0.0);
        }
        let blind = as_long(&levelled(&gram, 0.1));
        let plain = as_long(&preconditioner(&gram, 0.1));
        let others =
            |p: &ShutterGram| (0..12).filter(|&i| i != 5).map(|i| p[i][i]).fold(f64::MAX, f64::min);
        assert!(others(&blind) > 0.3 * others(&before), "{} {}", others(&blind), others(&before));
        assert!(others(&plain) < 0.01 * others(&before), "{}", others(&plain));
        assert!(blind[5][5] < 4.0, "{}", blind[5][5]);
    }

    #[test]
    fn what_no_pixel_sees_is_stepped_no_farther_than_damping_says() {
        let mut gram = gram();
        for i in 0..12 {
            (gram[i][5], gram[5][i]) = (0.0, 0.0);
        }
        let p = preconditioner(&gram, 0.1);
        assert!((p[5][5] - MIN_PRECONDITIONER.sqrt().recip()).abs() < 1e-3);
        assert!(p.iter().flatten().all(|v| v.is_finite()));
    }
}

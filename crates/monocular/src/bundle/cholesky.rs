//! Large symmetric systems.

/// Numbers that are added side by side, so that sums become vectors.
const LANES: usize = 8;

/// Solves `A x = b` in place by Cholesky's factorisation; `a` is `n x n`, row-major, its lower
/// triangle is read. Returns whether `A` was positive definite; if not, `b` holds nothing useful.
pub(super) fn solve(a: &mut [f64], b: &mut [f64]) -> bool {
    let n = b.len();
    for i in 0..n {
        let (above, row) = a.split_at_mut(i * n);
        for j in 0..i {
            let other = &above[j * n..j * n + j + 1];
            row[j] = (row[j] - dot(&row[..j], &other[..j])) / other[j];
        }
        let square = row[i] - dot(&row[..i], &row[..i]);
        if !(square.is_finite() && square > 0.0) {
            return false;
        }
        row[i] = square.sqrt();
        b[i] = (b[i] - dot(&row[..i], &b[..i])) / row[i];
    }
    for i in (0..n).rev() {
        b[i] /= a[i * n + i];
        let (known, row) = (b[i], &a[i * n..i * n + i]);
        b[..i].iter_mut().zip(row).for_each(|(b, l)| *b -= l * known);
    }
    true
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; LANES];
    let (a_parts, b_parts) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = a_parts.remainder().iter().zip(b_parts.remainder()).map(|(x, y)| x * y);
    let rest: f64 = rest.sum();
    for (x, y) in a_parts.zip(b_parts) {
        for i in 0..LANES {
            lanes[i] += x[i] * y[i];
        }
    }
    lanes.iter().sum::<f64>() + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_close, noise};

    #[test]
    fn a_system_is_solved_and_an_indefinite_one_refused() {
        let n = 37;
        let m = noise(1, n * n);
        let entry = |i: usize, j: usize| {
            let ridge = if i == j { 0.1 } else { 0.0 };
            (0..n).map(|k| m[i * n + k] * m[j * n + k]).sum::<f64>() + ridge
        };
        let mut a: Vec<f64> = (0..n * n).map(|k| entry(k / n, k % n)).collect();
        let x = noise(2, n);
        let mut b: Vec<f64> = (0..n).map(|i| (0..n).map(|j| a[i * n + j] * x[j]).sum()).collect();
        assert!(solve(&mut a, &mut b));
        assert_close("solution", &b, &x, 1e-9);
        assert!(!solve(&mut [1.0, 2.0, 2.0, 1.0], &mut [1.0, 1.0]));
    }
}

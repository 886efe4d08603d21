//! Small dense systems of Gauss-Newton steps.

/// `H x = b` with `H = Σ w j jᵀ` and `b = Σ w r j`: the normal equations of `N` unknowns.
#[derive(Clone, Debug)]
pub struct NormalEquations<const N: usize> {
    /// Upper triangle of `H`, row by row; the lower one is not kept.
    pub hessian: [[f64; N]; N],
    /// `Σ w r j`.
    pub gradient: [f64; N],
    /// `Σ w r²`.
    pub cost: f64,
    /// Number of residuals.
    pub count: usize,
}

impl<const N: usize> Default for NormalEquations<N> {
    fn default() -> Self {
        Self { hessian: [[0.0; N]; N], gradient: [0.0; N], cost: 0.0, count: 0 }
    }
}

impl<const N: usize> NormalEquations<N> {
    /// Adds a residual `r` with derivative `j` and weight `w`.
    pub fn add(&mut self, j: &[f64; N], r: f64, w: f64) {
        for a in 0..N {
            let wj = w * j[a];
            self.gradient[a] += wj * r;
            for b in a..N {
                self.hessian[a][b] += wj * j[b];
            }
        }
        self.cost += w * r * r;
        self.count += 1;
    }

    /// Adds the sums of another part.
    pub fn merge(&mut self, other: &Self) {
        for a in 0..N {
            self.gradient[a] += other.gradient[a];
            for b in a..N {
                self.hessian[a][b] += other.hessian[a][b];
            }
        }
        self.cost += other.cost;
        self.count += other.count;
    }

    /// The step `-(H + λ diag H)⁻¹ b`; `None` if `H` is not positive definite.
    pub fn step(&self, damping: f64) -> Option<[f64; N]> {
        let mut h = vec![0.0; N * N];
        for a in 0..N {
            for b in a..N {
                h[a * N + b] = self.hessian[a][b];
                h[b * N + a] = self.hessian[a][b];
            }
            h[a * N + a] += damping * self.hessian[a][a] + 1e-12;
        }
        let mut x: Vec<f64> = self.gradient.iter().map(|g| -g).collect();
        solve_positive_definite(&mut h, &mut x).then(|| std::array::from_fn(|i| x[i]))
    }
}

/// Solve `A x = b` in place by Cholesky's factorisation; `a` is `n x n`, row-major, symmetric.
/// Returns whether `A` was positive definite; if not, `b` holds nothing useful.
pub fn solve_positive_definite(a: &mut [f64], b: &mut [f64]) -> bool {
    let is_positive_definite = factorize_cholesky(a, b.len());
    if is_positive_definite {
        solve_cholesky(a, b);
    }
    is_positive_definite
}

/// Replaces the lower triangle of the symmetric `n x n` matrix `A`, row-major, by Cholesky's factor;
/// the upper one is not read. Returns whether `A` was positive definite.
pub fn factorize_cholesky(a: &mut [f64], n: usize) -> bool {
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let value = a[i * n + j] - dot;
            if i != j {
                a[i * n + j] = value / a[j * n + j];
            } else if value > 0.0 && value.is_finite() {
                a[i * n + i] = value.sqrt();
            } else {
                return false;
            }
        }
    }
    true
}

/// Solves `A x = b` in place, from the factor of `A` that [`factorize_cholesky`] found.
pub fn solve_cholesky(a: &[f64], b: &mut [f64]) {
    let n = b.len();
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| a[i * n + k] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * n + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| a[k * n + i] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * n + i];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solves_a_least_squares_line() {
        let mut equations = NormalEquations::<2>::default();
        for i in 0..10 {
            let x = f64::from(i);
            equations.add(&[x, 1.0], -(3.0 * x - 2.0), 1.0);
        }
        let solution = equations.step(0.0).expect("ten points define a line");
        assert!((solution[0] - 3.0).abs() < 1e-9 && (solution[1] + 2.0).abs() < 1e-9);
    }

    #[test]
    fn one_factor_solves_for_several_sides() {
        let a = [4.0, 1.0, 0.5, 1.0, 3.0, -0.2, 0.5, -0.2, 2.0];
        let mut factor = a;
        factor[1..3].fill(f64::NAN);
        factor[5] = f64::NAN;
        assert!(factorize_cholesky(&mut factor, 3));
        for x in [[1.0, 0.0, 0.0], [0.3, -2.0, 5.0]] {
            let row = |i: usize| (0..3).map(|k| a[3 * i + k] * x[k]).sum::<f64>();
            let mut found = [row(0), row(1), row(2)];
            solve_cholesky(&factor, &mut found);
            assert!(found.iter().zip(x).all(|(found, x)| (found - x).abs() < 1e-12), "{found:?}");
        }
    }

    #[test]
    fn refuses_an_indefinite_matrix() {
        assert!(!solve_positive_definite(&mut [1.0, 2.0, 2.0, 1.0], &mut [1.0, 1.0]));
    }
}

//! Covariance of an alignment from the scatter between tiles of the picture.
//!
//! Residuals of neighbouring pixels err together (texture, a bent surface, a sensor's distortion),
//! so that the inverse Hessian claims far too much. With the gradients `g_b = Σ w r j` and Hessians
//! `H_b` of the tiles, `Σ_b g_b = 0` at the minimum, and tile `b` left out the minimum moves by
//! `δ_b = (H - H_b)⁻¹ g_b`. The jackknife (a cluster-robust sandwich, CR3 of MacKinnon and White
//! 1985)
//!
//! ```text
//! Σ = (G - 1)/G · Σ_b δ_b δ_bᵀ
//! ```
//!
//! takes tiles to be independent, and nothing else. `H` is the curvature of the cost, `(ν+1)/(ν+3)`
//! of the reweighted sums under a t-distribution with `ν` degrees of freedom. With few tiles the
//! eigenvalues of `Σ H` scatter: they are drawn towards their mean, and have a least value.

use super::residual::{DEGREES_OF_FREEDOM, Equations, WHITE_BALANCE};
use i2slam_compute::solve_positive_definite;
use i2slam_geometry::symmetric_eigen_of;

/// Unknowns of a dense alignment among those of the residuals: the pose, then the gains.
pub(super) const FREE: [usize; SIZE] =
    [0, 1, 2, 3, 4, 5, WHITE_BALANCE, WHITE_BALANCE + 1, WHITE_BALANCE + 2];
const SIZE: usize = 9;
/// Unknowns of the pose.
const POSE: usize = 6;
/// Fewest tiles with residuals: twice the unknowns of the pose, that a scatter can be seen.
const MIN_TILES: usize = 2 * POSE;
/// Least eigenvalue of a covariance relative to the inverse Hessian: scales follow mean absolute
/// residuals, which tails widen to up to twice the deviation of most.
const MIN_EIGENVALUE: f64 = 0.25;
/// Share of the Hessian of both kinds that stands in for what one kind does not show.
const OTHER_KIND_SHARE: f64 = 1e-3;
/// Curvature of the cost over the reweighted Hessian.
const CURVATURE: f64 = (DEGREES_OF_FREEDOM as f64 + 1.0) / (DEGREES_OF_FREEDOM as f64 + 3.0);

type Matrix<const N: usize> = [[f64; N]; N];

/// Hessian and gradient by the free unknowns.
#[derive(Clone, Copy, Debug)]
struct Sums {
    hessian: Matrix<SIZE>,
    gradient: [f64; SIZE],
}

impl Sums {
    fn zero() -> Self {
        Self { hessian: [[0.0; SIZE]; SIZE], gradient: [0.0; SIZE] }
    }

    fn of(equations: &Equations) -> Self {
        let entry = |a: usize, b: usize| equations.hessian[FREE[a.min(b)]][FREE[a.max(b)]];
        Self {
            hessian: std::array::from_fn(|a| std::array::from_fn(|b| entry(a, b))),
            gradient: FREE.map(|i| equations.gradient[i]),
        }
    }

    /// `self + factor · other`.
    fn plus(&self, factor: f64, other: &Self) -> Self {
        let hessian = |a: usize, b: usize| self.hessian[a][b] + factor * other.hessian[a][b];
        Self {
            hessian: std::array::from_fn(|a| std::array::from_fn(|b| hessian(a, b))),
            gradient: std::array::from_fn(|i| self.gradient[i] + factor * other.gradient[i]),
        }
    }
}

/// Sums of the tiles that have residuals.
pub(super) struct BlockSums {
    /// Of depth, then of the picture.
    tiles: Vec<[Sums; 2]>,
}

impl BlockSums {
    /// From the equations of depth and of the picture, tile by tile.
    pub(super) fn new(tiles: impl Iterator<Item = [Equations; 2]>) -> Self {
        let has_residuals = |kinds: &[Equations; 2]| kinds.iter().any(|kind| kind.count > 0);
        let sums = |kinds: [Equations; 2]| kinds.map(|kind| Sums::of(&kind));
        Self { tiles: tiles.filter(has_residuals).map(sums).collect() }
    }

    /// The weight of the picture under which its gradients scatter between tiles as those of depth
    /// do, each against its Hessian: both then count by their effective number of residuals.
    /// `current` is the weight that the sums were made with.
    pub(super) fn image_weight(&self, current: f64, [least, most]: [f64; 2]) -> f64 {
        let [depth, image] = [0, 1].map(|kind| self.inflation(kind));
        let weight = match (depth, image) {
            (Some(depth), Some(image)) => current * depth / image,
            _ => current,
        };
        if weight.is_finite() && weight > 0.0 { weight.clamp(least, most) } else { current }
    }

    /// `tr(H⁻¹ Σ e_b e_bᵀ) / tr(H⁻¹ Σ H_b)` of depth (0) or picture (1), with `H` of both and
    /// `e_b = g_b - H_b x` the gradients at the minimum `x` of that kind alone: where depth and
    /// picture disagree, that is no scatter of either.
    fn inflation(&self, kind: usize) -> Option<f64> {
        let total = self.total();
        let inverse = inverse(&pinned(&total.hessian))?;
        let alone = self.tiles.iter().fold(Sums::zero(), |sum, tile| sum.plus(1.0, &tile[kind]));
        // A little of both, because one kind need not show all unknowns.
        let matrix = alone.plus(OTHER_KIND_SHARE, &total).hessian;
        let minimum = solve(&pinned(&matrix), &alone.gradient)?;
        let (mut scatter, mut curvature) = (0.0, 0.0);
        for tile in &self.tiles {
            let Sums { hessian, gradient } = &tile[kind];
            let own: [f64; SIZE] = std::array::from_fn(|a| {
                gradient[a] - (0..SIZE).map(|b| hessian[a][b] * minimum[b]).sum::<f64>()
            });
            for a in 0..SIZE {
                for b in 0..SIZE {
                    scatter += inverse[a][b] * own[a] * own[b];
                    curvature += inverse[a][b] * hessian[a][b];
                }
            }
        }
        Some(scatter / curvature)
    }

    /// Inverse covariance of the pose; `None` from too few tiles, or where they do not determine
    /// it.
    pub(super) fn information(&self) -> Option<Matrix<POSE>> {
        if self.tiles.len() < MIN_TILES {
            return None;
        }
        let total = self.total();
        let formal = pose_part(&inverse(&pinned(&scaled(&total.hessian)))?);
        let count = self.tiles.len() as f64;
        let mut covariance = [[0.0; POSE]; POSE];
        for [depth, image] in &self.tiles {
            let tile = depth.plus(1.0, image);
            let others = pinned(&scaled(&total.plus(-1.0, &tile).hessian));
            let moved = solve(&others, &tile.gradient)?;
            for a in 0..POSE {
                for b in 0..POSE {
                    covariance[a][b] += (count - 1.0) / count * moved[a] * moved[b];
                }
            }
        }
        information_above(&covariance, &formal, count)
    }

    fn total(&self) -> Sums {
        let all = self.tiles.iter().flatten();
        all.fold(Sums::zero(), |sum, part| sum.plus(1.0, part))
    }
}

/// Inverse of `covariance`, whose eigenvalues relative to `formal` are drawn to their mean as if
/// that had been seen in as many more tiles than `count` as there are unknowns.
fn information_above(
    covariance: &Matrix<POSE>,
    formal: &Matrix<POSE>,
    count: f64,
) -> Option<Matrix<POSE>> {
    let root = cholesky(formal)?;
    // L⁻¹ C L⁻ᵀ, rows first, then columns.
    let half = transposed(&covariance.map(|row| forward(&root, &row)));
    let mut relative = half.map(|row| forward(&root, &row));
    let mean = (0..POSE).map(|i| relative[i][i]).sum::<f64>() / POSE as f64;
    let share = POSE as f64 / (POSE as f64 + count);
    for a in 0..POSE {
        relative[a].iter_mut().for_each(|v| *v *= 1.0 - share);
        relative[a][a] += share * mean;
    }
    let (values, vectors) = symmetric_eigen_of(&relative);
    // Columns L⁻ᵀ v of each eigenvector.
    let mut information = [[0.0; POSE]; POSE];
    for k in 0..POSE {
        let column = backward(&root, &std::array::from_fn(|i| vectors[i][k]));
        let weight = 1.0 / values[k].max(MIN_EIGENVALUE);
        for a in 0..POSE {
            (0..POSE).for_each(|b| information[a][b] += weight * column[a] * column[b]);
        }
    }
    information.iter().flatten().all(|v| v.is_finite()).then_some(information)
}

fn scaled(matrix: &Matrix<SIZE>) -> Matrix<SIZE> {
    matrix.map(|row| row.map(|v| CURVATURE * v))
}

fn pose_part(matrix: &Matrix<SIZE>) -> Matrix<POSE> {
    std::array::from_fn(|a| std::array::from_fn(|b| matrix[a][b]))
}

fn transposed(matrix: &Matrix<POSE>) -> Matrix<POSE> {
    std::array::from_fn(|a| std::array::from_fn(|b| matrix[b][a]))
}

/// With unknowns that nothing shows held in place.
fn pinned(matrix: &Matrix<SIZE>) -> Matrix<SIZE> {
    let mut pinned = *matrix;
    for i in 0..SIZE {
        if matrix[i][i] <= 0.0 {
            (0..SIZE).for_each(|a| (pinned[a][i], pinned[i][a]) = (0.0, 0.0));
            pinned[i][i] = 1.0;
        }
    }
    pinned
}

fn solve(matrix: &Matrix<SIZE>, right: &[f64; SIZE]) -> Option<[f64; SIZE]> {
    let mut x = *right;
    solve_positive_definite(matrix.concat().as_mut_slice(), &mut x).then_some(x)
}

fn inverse(matrix: &Matrix<SIZE>) -> Option<Matrix<SIZE>> {
    let mut columns = [[0.0; SIZE]; SIZE];
    for (i, column) in columns.iter_mut().enumerate() {
        let unit = std::array::from_fn(|k| if k == i { 1.0 } else { 0.0 });
        *column = solve(matrix, &unit)?;
    }
    Some(columns)
}

/// `L` of `L Lᵀ`; `None` where the matrix is not positive definite.
pub(crate) fn cholesky(matrix: &Matrix<POSE>) -> Option<Matrix<POSE>> {
    let mut root = [[0.0; POSE]; POSE];
    for i in 0..POSE {
        for j in 0..=i {
            let rest = matrix[i][j] - (0..j).map(|k| root[i][k] * root[j][k]).sum::<f64>();
            root[i][j] = if i == j { rest.sqrt() } else { rest / root[j][j] };
        }
    }
    (0..POSE).all(|i| root[i][i] > 0.0 && root[i][i].is_finite()).then_some(root)
}

/// `L⁻¹ x`.
fn forward(root: &Matrix<POSE>, x: &[f64; POSE]) -> [f64; POSE] {
    let mut out = [0.0; POSE];
    for i in 0..POSE {
        let sum: f64 = (0..i).map(|k| root[i][k] * out[k]).sum();
        out[i] = (x[i] - sum) / root[i][i];
    }
    out
}

/// `L⁻ᵀ x`.
fn backward(root: &Matrix<POSE>, x: &[f64; POSE]) -> [f64; POSE] {
    let mut out = [0.0; POSE];
    for i in (0..POSE).rev() {
        let sum: f64 = (i + 1..POSE).map(|k| root[k][i] * out[k]).sum();
        out[i] = (x[i] - sum) / root[i][i];
    }
    out
}

//! Covariance of the aligned pose at mid-exposure (a sandwich estimator).
//!
//! The cost `Σ s_k ρ(r/σ)`, `ρ(z) = (ν+1) ln(1 + z²/ν)` with weights `w(z) = (ν+1)/(ν+z²)`, has the
//! reweighted sums `H_k = Σ s_k w j jᵀ / σ²` for depth (`s` = 1) and picture. Where residuals are
//! normal with spread `n` against their scales, noise of independent pixels moves the minimum with
//! the covariance
//!
//! ```text
//! C = B⁻¹ M B⁻¹,   B = Σ_k c_k H_k + priors,   M = Σ_k s_k m_k H_k
//! c = E[ρ''(z)/2] / E[w(z)],   m = E[w(z)² z²] / E[w(z)],   z ~ N(0, n²)
//! ```
//!
//! and `n` is the one whose expected cost `E[ρ(z)]` equals the mean cost of the residuals. Priors
//! stiffen `B` but are no noise in `M`. The result is formal: neighbouring pixels, the channels of
//! a pixel and all errors of the map are taken to be independent.

use super::levenberg_marquardt::{AlignmentOutcome, EvaluationMode};
use super::residual::{DEGREES_OF_FREEDOM, Equations, ResidualSums, UNKNOWNS};
use super::target::active_targets;
use super::{FrameAlignment, TrackingState};
use i2slam_compute::solve_positive_definite;

/// Number of unknowns of the pose at mid-exposure, which come first: ρ, then φ.
const POSE: usize = 6;

/// Samples of the normal density, over [`SIGMA_RANGE`] standard deviations to either side.
const SAMPLES: usize = 64;
const SIGMA_RANGE: f64 = 6.0;
/// Bounds of the spread `n`, between which it is found by bisection on a logarithmic scale.
const SPREAD_BOUNDS: (f64, f64) = (1e-3, 1e3);
const BISECTIONS: usize = 40;

/// A symmetric matrix over all unknowns.
type Matrix = [[f64; UNKNOWNS]; UNKNOWNS];

/// Covariance of (ρ, φ) at mid-exposure [m², m rad, rad²].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PoseCovariance(pub(super) [[f64; POSE]; POSE]);

impl PoseCovariance {
    /// `B⁻¹ M B⁻¹` from the upper triangles of `bread` (`B`) and `meat` (`M`); `None` where `bread` is
    /// not positive definite.
    pub(super) fn new(bread: &Matrix, meat: &Matrix) -> Option<Self> {
        let full = |m: &Matrix, a: usize, b: usize| if a <= b { m[a][b] } else { m[b][a] };
        let mut columns = [[0.0; UNKNOWNS]; POSE];
        for (k, column) in columns.iter_mut().enumerate() {
            let each = (0..UNKNOWNS * UNKNOWNS).map(|i| full(bread, i / UNKNOWNS, i % UNKNOWNS));
            let mut matrix: Vec<f64> = each.collect();
            column[k] = 1.0;
            if !solve_positive_definite(&mut matrix, column) {
                return None;
            }
        }
        let product = |a: usize, b: usize| {
            let row = |i| (0..UNKNOWNS).map(|j| full(meat, i, j) * columns[b][j]).sum::<f64>();
            (0..UNKNOWNS).map(|i| columns[a][i] * row(i)).sum::<f64>()
        };
        let all = std::array::from_fn(|a| std::array::from_fn(|b| product(a, b)));
        Some(Self(all))
    }

    /// Root of the summed variances of the three numbers from `first` on.
    fn deviation(&self, first: usize) -> f64 {
        (first..first + 3).map(|i| self.0[i][i].max(0.0)).sum::<f64>().sqrt()
    }

    /// Standard deviation of the position [m].
    pub(super) fn position(&self) -> f64 {
        self.deviation(0)
    }

    /// Standard deviation of the rotation [rad].
    pub(super) fn rotation(&self) -> f64 {
        self.deviation(3)
    }
}

impl FrameAlignment<'_> {
    /// The formal covariance at the end of an optimisation.
    pub(super) fn covariance(&self, end: &AlignmentOutcome) -> Option<PoseCovariance> {
        let (mut bread, mut meat) = (Equations::default(), [[0.0; UNKNOWNS]; UNKNOWNS]);
        let cameras = self.virtual_cameras(0, &end.state);
        for (_, target) in active_targets(&end.targets) {
            let share = f64::from(self.image_weight(target));
            let of = |mode| self.residuals(target, 0, &end.state, cameras, mode);
            let depth = of(EvaluationMode::DepthOnly);
            let all = if share > 0.0 { of(EvaluationMode::Full) } else { depth.clone() };
            let [by_depth, by_image] = noises(&depth, &all, share);
            for a in 0..UNKNOWNS {
                for b in a..UNKNOWNS {
                    let (d, sum) = (depth.equations.hessian[a][b], all.equations.hessian[a][b]);
                    let image = sum - d;
                    bread.hessian[a][b] += by_depth.curvature * d + by_image.curvature * image;
                    meat[a][b] += by_depth.spread * d + share * by_image.spread * image;
                }
            }
        }
        self.with_priors(&end.state, bread, meat)
    }

    /// Adds the priors and takes out the unknowns that are not free.
    fn with_priors(
        &self,
        state: &TrackingState,
        mut bread: Equations,
        mut meat: Matrix,
    ) -> Option<PoseCovariance> {
        self.add_priors(state, &mut bread);
        for i in 0..UNKNOWNS {
            let alone = (0..UNKNOWNS).all(|a| a == i || bread.hessian[a.min(i)][a.max(i)] == 0.0);
            if alone {
                // Frozen, or without influence.
                bread.hessian[i][i] = 1.0;
                (0..UNKNOWNS).for_each(|a| meat[a.min(i)][a.max(i)] = 0.0);
            }
        }
        PoseCovariance::new(&bread.hessian, &meat)
    }
}

/// The noise of depth and image residuals, from the costs of depth alone and of both.
fn noises(depth: &ResidualSums, all: &ResidualSums, share: f64) -> [ResidualNoise; 2] {
    let (depth, all) = (&depth.equations, &all.equations);
    let mean = |cost: f64, count: usize| if count > 0 { cost / count as f64 } else { 0.0 };
    let share = if share > 0.0 { share } else { 1.0 };
    let image = mean((all.cost - depth.cost) / share, all.count - depth.count);
    [mean(depth.cost, depth.count), image].map(ResidualNoise::of_mean_cost)
}

/// Noise terms of normal residuals under the cost `ρ`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct ResidualNoise {
    /// `E[ρ''(z)/2] / E[w(z)]`.
    curvature: f64,
    /// `E[w(z)² z²] / E[w(z)]`.
    spread: f64,
}

impl ResidualNoise {
    /// For the spread whose expected cost `E[ρ(z)]` is `cost`.
    fn of_mean_cost(cost: f64) -> Self {
        let freedom = f64::from(DEGREES_OF_FREEDOM);
        let rho = |z: f64| (freedom + 1.0) * (z * z / freedom).ln_1p();
        let (mut low, mut high) = (SPREAD_BOUNDS.0.ln(), SPREAD_BOUNDS.1.ln());
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + high);
            match expected(middle.exp(), rho) < cost {
                true => low = middle,
                false => high = middle,
            }
        }
        Self::of_spread(low.exp())
    }

    /// For residuals with `spread` times their scale as standard deviation.
    fn of_spread(spread: f64) -> Self {
        let freedom = f64::from(DEGREES_OF_FREEDOM);
        let weight = |z: f64| (freedom + 1.0) / (freedom + z * z);
        let bend = |z: f64| weight(z) * (freedom - z * z) / (freedom + z * z);
        let sum = expected(spread, weight);
        // Residuals beyond the turning point of the cost would make its curvature negative.
        let curvature = (expected(spread, bend) / sum).max(0.05);
        Self { curvature, spread: expected(spread, |z| (weight(z) * z).powi(2)) / sum }
    }
}

/// `E[f(z)]` for `z ~ N(0, spread²)`.
fn expected(spread: f64, f: impl Fn(f64) -> f64) -> f64 {
    let place = |i: usize| SIGMA_RANGE * ((2 * i + 1) as f64 / SAMPLES as f64 - 1.0);
    let (mut sum, mut total) = (0.0, 0.0);
    for x in (0..SAMPLES).map(place) {
        let density = (-0.5 * x * x).exp();
        sum += density * f(spread * x);
        total += density;
    }
    sum / total
}

#[cfg(test)]
mod tests;

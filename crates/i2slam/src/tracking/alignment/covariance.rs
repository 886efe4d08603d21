//! How sure an alignment is: the covariance of the pose at mid-exposure.
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
//! and `n` is the one whose expected cost `E[ρ(z)]` is the mean cost that was found. Priors hold
//! but are no noise. This is formal: neighbouring pixels, the channels of one and all errors of the
//! map are taken to be independent.

use super::levenberg_marquardt::{Outcome, Purpose};
use super::noise::Noise;
use super::residual::{Equations, Sums, UNKNOWNS};
use super::target::cleanest;
use super::{Frame, State};
use i2slam_compute::solve_positive_definite;

/// Unknowns of the pose at mid-exposure: ρ, then φ.
const POSE: usize = 6;

/// A symmetric matrix of all unknowns.
type Matrix = [[f64; UNKNOWNS]; UNKNOWNS];

/// Covariance of (ρ, φ) at mid-exposure [m², m rad, rad²].
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PoseCovariance(pub(super) [[f64; POSE]; POSE]);

impl PoseCovariance {
    /// `B⁻¹ M B⁻¹`, of which the upper triangles of `bread` and `meat` are read; `None` where
    /// `bread` is not positive definite.
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

impl Frame<'_> {
    /// The formal covariance where a descent ended.
    pub(super) fn covariance(&self, end: &Outcome) -> Option<PoseCovariance> {
        let (mut bread, mut meat) = (Equations::default(), [[0.0; UNKNOWNS]; UNKNOWNS]);
        let cameras = self.virtual_cameras(0, &end.state);
        for (_, reference) in cleanest(&end.references) {
            let share = f64::from(self.image_weight(reference));
            let of = |purpose| self.residuals(reference, 0, &end.state, cameras, purpose);
            let depth = of(Purpose::StepByDepth);
            let all = if share > 0.0 { of(Purpose::Step) } else { depth.clone() };
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

    /// Adds the priors and takes out what is not free.
    fn with_priors(
        &self,
        state: &State,
        mut bread: Equations,
        mut meat: Matrix,
    ) -> Option<PoseCovariance> {
        self.add_prior(state, &mut bread);
        for i in 0..UNKNOWNS {
            let alone = (0..UNKNOWNS).all(|a| a == i || bread.hessian[a.min(i)][a.max(i)] == 0.0);
            if alone {
                // Frozen, or nothing depends on it.
                bread.hessian[i][i] = 1.0;
                (0..UNKNOWNS).for_each(|a| meat[a.min(i)][a.max(i)] = 0.0);
            }
        }
        PoseCovariance::new(&bread.hessian, &meat)
    }
}

/// The noise of depth and picture, from the costs of depth alone and of both.
fn noises(depth: &Sums, all: &Sums, share: f64) -> [Noise; 2] {
    let (depth, all) = (&depth.equations, &all.equations);
    let mean = |cost: f64, count: usize| if count > 0 { cost / count as f64 } else { 0.0 };
    let share = if share > 0.0 { share } else { 1.0 };
    let image = mean((all.cost - depth.cost) / share, all.count - depth.count);
    [mean(depth.cost, depth.count), image].map(Noise::of_mean_cost)
}

#[cfg(test)]
mod tests;

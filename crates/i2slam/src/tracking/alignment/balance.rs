//! The inertia of the white balance in second-order tracking.
//!
//! A camera changes its white balance slowly, if at all, while a map that is not quite right asks
//! for another one in every frame, and would take over its colours. With `h_c` the curvature of
//! the picture's cost by channel `c`, the prior `λ h_c (ln wb_c − ln wb'_c)²` lets a frame take
//! `1 / (1 + λ)` of what it asks for beyond the last frame's white balance `wb'`.

use super::residual::Equations;

/// First index of the white balance among the unknowns.
const BALANCE: usize = 13;

/// A Gaussian prior on the logarithms of the white balance.
pub(super) struct BalancePrior {
    precisions: [f64; 3],
    last: [f32; 3],
}

impl BalancePrior {
    /// With the precisions that the picture's own `equations` times `inertia` have.
    pub(super) fn new(equations: &Equations, inertia: f32, last: [f32; 3]) -> Self {
        let precision = |c: usize| f64::from(inertia) * equations.hessian[BALANCE + c][BALANCE + c];
        Self { precisions: std::array::from_fn(precision), last }
    }

    /// `Σ precision · error²`, of which [`add_to`](Self::add_to) adds half the gradient.
    pub(super) fn cost(&self, now: [f32; 3]) -> f64 {
        let errors = self.errors(now);
        (0..3).map(|c| self.precisions[c] * errors[c] * errors[c]).sum()
    }

    /// Adds the prior's normal equations.
    pub(super) fn add_to(&self, now: [f32; 3], equations: &mut Equations) {
        let errors = self.errors(now);
        for c in 0..3 {
            equations.hessian[BALANCE + c][BALANCE + c] += self.precisions[c];
            equations.gradient[BALANCE + c] += self.precisions[c] * errors[c];
        }
    }

    fn errors(&self, now: [f32; 3]) -> [f64; 3] {
        std::array::from_fn(|c| f64::from(now[c]) - f64::from(self.last[c]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One unknown whose cost `h (x − 1)²` asks for 1.
    #[test]
    fn a_frame_takes_its_share_of_what_it_asks_for() {
        let mut picture = Equations::default();
        for i in 0..picture.gradient.len() {
            picture.hessian[i][i] = 7.0;
        }
        picture.gradient[BALANCE] = -7.0;
        let prior = BalancePrior::new(&picture, 4.0, [0.0; 3]);
        let mut equations = picture.clone();
        prior.add_to([0.0; 3], &mut equations);
        let step = equations.step(0.0).expect("positive definite");
        assert!((step[BALANCE] - 0.2).abs() < 1e-12, "{}", step[BALANCE]);
        // There the whole cost is the least.
        let cost = |x: f32| 7.0 * (f64::from(x) - 1.0).powi(2) + prior.cost([x, 0.0, 0.0]);
        assert!(cost(0.2) < cost(0.19) && cost(0.2) < cost(0.21));
    }
}

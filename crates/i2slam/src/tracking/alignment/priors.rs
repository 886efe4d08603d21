//! Gaussian priors of second-order tracking: on the motion during the exposure and on the white
//! balance.

use i2slam_geometry::Tangent;
use i2slam_odometry::alignment::{Equations, UNKNOWNS, VELOCITY, WHITE_BALANCE};

/// Standard deviation of the velocity at rest where the motion since the last frame is known [px].
pub(super) const MIN_SIGMA_PX: f64 = 0.05;
/// Its growth with the motion since the last frame: across that motion, and along it, where the
/// shutter time is uncertain.
const SIGMA_RATIO_ACROSS: f64 = 0.1_f32 as f64;
const SIGMA_RATIO_ALONG: f64 = 0.5;

/// Prior that the exposure lies on the trajectory.
///
/// With `Δ` the motion since the last frame, the motion during the exposure should be `κ Δ`,
/// `κ = 2 a Δt` (eqs. 15 to 17 solved for the velocity). Measured in pixels, the velocity may leave
/// that line by little and its length by more: brightness gives the shutter time only roughly,
/// because a camera also changes its gain.
pub(super) struct MotionPrior {
    pub(super) pixels_per_unit: [f64; 6],
    /// Motion `Δ` since the last frame; of a photograph the one during its exposure, with `κ` = 1.
    pub(super) step: Tangent<f64>,
    /// Expected share `κ` of it during the exposure.
    pub(super) share: f64,
    /// Standard deviation of the velocity at rest [px].
    pub(super) sigma_at_rest: f64,
    /// Weight against single residuals.
    pub(super) weight: f64,
}

impl MotionPrior {
    /// `weight · eᵀ P e`, of which [`add_to`](Self::add_to) adds half the gradient; motion and
    /// share count as constants.
    pub(super) fn cost(&self, velocity: Tangent<f64>) -> f64 {
        let (step, now) = (self.to_pixels(self.step), self.to_pixels(velocity));
        let (length, across, along) = self.precisions(&step);
        let (mut square, mut dot) = (0.0, 0.0);
        for i in 0..6 {
            let error = now[i] - self.share * step[i];
            square += error * error;
            dot += if length > 0.0 { error * step[i] / length } else { 0.0 };
        }
        self.weight * (across * square + (along - across) * dot * dot)
    }

    /// Adds the prior's normal equations at `velocity`.
    pub(super) fn add_to(&self, velocity: Tangent<f64>, equations: &mut Equations) {
        let step = self.to_pixels(self.step);
        let (length, across, along) = self.precisions(&step);
        let direction = step.map(|v| if length > 0.0 { v / length } else { 0.0 });
        let target = step.map(|v| v * self.share);
        let now = self.to_pixels(velocity);
        let error: [f64; 6] = std::array::from_fn(|i| now[i] - target[i]);
        for a in 0..6 {
            let mut gradient = 0.0;
            for b in 0..6 {
                let same = if a == b { across } else { 0.0 };
                let precision = same + (along - across) * direction[a] * direction[b];
                gradient += precision * error[b];
                if b >= a {
                    equations.hessian[VELOCITY + a][VELOCITY + b] +=
                        self.weight * precision * self.pixels_per_unit[a] * self.pixels_per_unit[b];
                }
            }
            equations.gradient[VELOCITY + a] += self.weight * gradient * self.pixels_per_unit[a];
        }
    }

    /// Length of the motion [px], and the precisions across and along it [1/px²].
    fn precisions(&self, step: &[f64; 6]) -> (f64, f64, f64) {
        let length = step.iter().map(|v| v * v).sum::<f64>().sqrt();
        let precision = |ratio: f64| 1.0 / (self.sigma_at_rest + ratio * length).powi(2);
        (length, precision(SIGMA_RATIO_ACROSS), precision(SIGMA_RATIO_ALONG))
    }

    /// Share of the motion since the last frame that `velocity` covers, and the length of that
    /// motion [px].
    pub(super) fn measured_share(&self, velocity: Tangent<f64>) -> (f64, f64) {
        let (step, now) = (self.to_pixels(self.step), self.to_pixels(velocity));
        let square: f64 = step.iter().map(|v| v * v).sum();
        let dot: f64 = step.iter().zip(now).map(|(a, b)| a * b).sum();
        (if square > 0.0 { dot / square } else { self.share }, square.sqrt())
    }

    fn to_pixels(&self, tangent: Tangent<f64>) -> [f64; 6] {
        let values = tangent.to_array();
        std::array::from_fn(|i| values[i] * self.pixels_per_unit[i])
    }
}

/// Inertia of the white balance.
///
/// A camera changes its white balance slowly, if at all, while a map that is not quite right asks
/// for another one in every frame, and would take over its colours. With `h_c` the curvature of
/// the image cost by channel `c`, the prior `λ h_c (ln wb_c − ln wb'_c)²` lets a frame move by
/// `1 / (1 + λ)` of what its picture asks for from the last frame's white balance `wb'`.
pub(super) struct WhiteBalancePrior {
    precisions: [f64; 3],
    last: [f32; 3],
}

impl WhiteBalancePrior {
    /// With `inertia` (λ) times the precisions of the image residuals in `equations`.
    pub(super) fn new(equations: &Equations, inertia: f32, last: [f32; 3]) -> Self {
        let precision =
            |c: usize| f64::from(inertia) * equations.hessian[WHITE_BALANCE + c][WHITE_BALANCE + c];
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
            equations.hessian[WHITE_BALANCE + c][WHITE_BALANCE + c] += self.precisions[c];
            equations.gradient[WHITE_BALANCE + c] += self.precisions[c] * errors[c];
        }
    }

    fn errors(&self, now: [f32; 3]) -> [f64; 3] {
        std::array::from_fn(|c| f64::from(now[c]) - f64::from(self.last[c]))
    }
}

/// Fixes the unknowns `frozen` at their values.
pub(super) fn freeze(equations: &mut Equations, frozen: std::ops::Range<usize>) {
    for i in frozen {
        for a in 0..UNKNOWNS {
            equations.hessian[a.min(i)][a.max(i)] = 0.0;
        }
        equations.hessian[i][i] = 1.0;
        equations.gradient[i] = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_gradient, noise};

    #[test]
    fn normal_equations_are_half_the_derivative_of_the_cost() {
        let tangent = |seed| Tangent::from_array(std::array::from_fn(|i| noise(seed, 6)[i] * 0.02));
        for step in [tangent(1), Tangent::zero()] {
            let prior = MotionPrior {
                pixels_per_unit: [130.0, 130.0, 130.0, 260.0, 260.0, 260.0],
                step,
                share: 0.4,
                sigma_at_rest: MIN_SIGMA_PX,
                weight: 200.0,
            };
            let velocity = tangent(2).to_array();
            let mut equations = Equations::default();
            prior.add_to(Tangent::from_array(velocity), &mut equations);
            let gradient: Vec<f64> = equations.gradient[6..12].iter().map(|g| 2.0 * g).collect();
            assert_gradient("motion prior", &velocity, &gradient, 1e-4, 1e-6, |x| {
                prior.cost(Tangent::from_array(std::array::from_fn(|i| x[i])))
            });
        }
    }

    #[test]
    fn frozen_unknowns_do_not_move() {
        let mut equations = Equations::default();
        equations.add(&std::array::from_fn(|i| 1.0 + i as f64), 1.0, 1.0);
        freeze(&mut equations, 3..UNKNOWNS);
        let step = equations.step(1e-3).expect("positive definite");
        assert!(step[3..].iter().all(|&s| s == 0.0) && step[0] != 0.0);
    }

    /// One unknown whose cost `h (x − 1)²` asks for 1.
    #[test]
    fn white_balance_moves_by_its_share() {
        let mut picture = Equations::default();
        for i in 0..picture.gradient.len() {
            picture.hessian[i][i] = 7.0;
        }
        picture.gradient[WHITE_BALANCE] = -7.0;
        let prior = WhiteBalancePrior::new(&picture, 4.0, [0.0; 3]);
        let mut equations = picture.clone();
        prior.add_to([0.0; 3], &mut equations);
        let step = equations.step(0.0).expect("positive definite");
        assert!((step[WHITE_BALANCE] - 0.2).abs() < 1e-12, "{}", step[WHITE_BALANCE]);
        // There the whole cost is the least.
        let cost = |x: f32| 7.0 * (f64::from(x) - 1.0).powi(2) + prior.cost([x, 0.0, 0.0]);
        assert!(cost(0.2) < cost(0.19) && cost(0.2) < cost(0.21));
    }
}

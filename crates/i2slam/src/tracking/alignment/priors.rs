//! The trajectory prior of second-order tracking: the exposure lies on the global trajectory.
//!
//! With `Δ` the motion from the last frame to this one, the motion during the exposure should be
//! `κ Δ`, `κ = 2 a Δt` (eqs. 15 to 17 solved for the velocity). Measured in pixels, the velocity
//! may leave that line by little and its length by more: brightness tells the shutter time only
//! roughly, because a camera also changes its gain.

use super::residual::{Equations, UNKNOWNS};
use i2slam_geometry::Tangent;

/// First index of the velocity among the unknowns.
const VELOCITY: usize = 6;
/// Least uncertainty [px].
const FLOOR: f64 = 0.05;

/// A Gaussian prior on the velocity.
pub(super) struct MotionPrior {
    /// Pixels per unit of each tangent coordinate.
    pub(super) pixels: [f64; 6],
    /// Motion between the frames.
    pub(super) step: Tangent<f64>,
    /// Expected share of it during the exposure.
    pub(super) share: f64,
    /// Standard deviation across the trajectory, as a share of the motion.
    pub(super) across: f64,
    /// Standard deviation along it, as a share of the motion.
    pub(super) along: f64,
    /// Weight against the residuals.
    pub(super) weight: f64,
}

impl MotionPrior {
    /// `weight · eᵀ P e`, of which [`add_to`](Self::add_to) adds half the gradient; motion and
    /// share are held fixed.
    pub(super) fn cost(&self, velocity: Tangent<f64>) -> f64 {
        let (step, now) = (self.in_pixels(self.step), self.in_pixels(velocity));
        let length = step.iter().map(|v| v * v).sum::<f64>().sqrt();
        let across = 1.0 / (FLOOR + self.across * length).powi(2);
        let along = 1.0 / (FLOOR + self.along * length).powi(2);
        let (mut square, mut dot) = (0.0, 0.0);
        for i in 0..6 {
            let error = now[i] - self.share * step[i];
            square += error * error;
            dot += if length > 0.0 { error * step[i] / length } else { 0.0 };
        }
        self.weight * (across * square + (along - across) * dot * dot)
    }

    /// Adds the prior's normal equations at velocity `velocity`.
    pub(super) fn add_to(&self, velocity: Tangent<f64>, equations: &mut Equations) {
        let step = self.in_pixels(self.step);
        let length = step.iter().map(|v| v * v).sum::<f64>().sqrt();
        let across = 1.0 / (FLOOR + self.across * length).powi(2);
        let along = 1.0 / (FLOOR + self.along * length).powi(2);
        let direction = step.map(|v| if length > 0.0 { v / length } else { 0.0 });
        let target = step.map(|v| v * self.share);
        let now = self.in_pixels(velocity);
        let error: [f64; 6] = std::array::from_fn(|i| now[i] - target[i]);
        for a in 0..6 {
            let mut gradient = 0.0;
            for b in 0..6 {
                let same = if a == b { across } else { 0.0 };
                let precision = same + (along - across) * direction[a] * direction[b];
                gradient += precision * error[b];
                if b >= a {
                    equations.hessian[VELOCITY + a][VELOCITY + b] +=
                        self.weight * precision * self.pixels[a] * self.pixels[b];
                }
            }
            equations.gradient[VELOCITY + a] += self.weight * gradient * self.pixels[a];
        }
    }

    /// The share of the motion between frames that `velocity` covers, and the motion [px].
    pub(super) fn measured_share(&self, velocity: Tangent<f64>) -> (f64, f64) {
        let (step, now) = (self.in_pixels(self.step), self.in_pixels(velocity));
        let square: f64 = step.iter().map(|v| v * v).sum();
        let dot: f64 = step.iter().zip(now).map(|(a, b)| a * b).sum();
        (if square > 0.0 { dot / square } else { self.share }, square.sqrt())
    }

    fn in_pixels(&self, tangent: Tangent<f64>) -> [f64; 6] {
        let values = tangent.to_array();
        std::array::from_fn(|i| values[i] * self.pixels[i])
    }
}

/// Keeps the unknowns of `frozen` where they are.
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
                pixels: [130.0, 130.0, 130.0, 260.0, 260.0, 260.0],
                step,
                share: 0.4,
                across: 0.1,
                along: 0.5,
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
}

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

//! Bundle adjustment: poses, landmarks and, when asked, focal length and lens or readout of the
//! rows, all at once.
//!
//! Minimises `Σ huber(‖projection - observation‖ / σ)` by Levenberg-Marquardt; landmarks are
//! eliminated first (Schur complement; Triggs et al. 2000, section 6).

mod covariance;
mod normal_equations;
mod sparsity;

pub(crate) use covariance::Covariance;

use crate::multiview::landmark::Landmark;
use crate::multiview::robust_loss::huber;
use crate::progress::{Progress, Stage};
use i2slam_compute::reduce_in_order;
use i2slam_geometry::{Camera, Pose, Tangent};
use normal_equations::{Curvature, Linear, Step};
use sparsity::Structure;
use std::sync::Arc;

/// Landmarks per task.
const CHUNK: usize = 128;
/// A landmark behind a camera costs what a residual of so many standard deviations does.
const BEHIND: f64 = 50.0;
/// Damping beyond which no step lowers the cost.
const STUCK: f64 = 1e6;
/// Steps of so few poses are not worth telling.
const TOLD: usize = 64;
/// A step that lowers the cost by less than this share is the last one.
const CONVERGED: f64 = 1e-5;
/// Unknowns that all sights share: the logarithm of the focal length, two [`Moves`].
const GLOBALS: usize = 3;
/// The most that a step changes each of them.
const MAX_STEP: [f64; GLOBALS] = [0.2, 0.1, 0.1];

/// What a position moves by for each unknown of the camera beside the focal length [px]: the two
/// coefficients of the lens, or the readout of the rows and nothing.
pub(crate) type Moves = [[f64; 2]; 2];

/// A landmark as one camera sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sight {
    /// Which pose of the bundle.
    pub(crate) pose: usize,
    /// Image position [px].
    pub(crate) at: [f64; 2],
    /// Its standard deviation [px].
    pub(crate) sigma: f64,
    /// What lens or rows move it by.
    pub(crate) moves: Moves,
}

/// All that is adjusted, and what it is adjusted to.
#[derive(Clone, Debug)]
pub(crate) struct Bundle {
    pub(crate) camera: Camera<f64>,
    /// `world_from_camera`.
    pub(crate) poses: Vec<Pose<f64>>,
    /// Poses that stay.
    pub(crate) fixed: Vec<bool>,
    pub(crate) landmarks: Vec<Landmark>,
    /// For every landmark its sights in order of poses, no two by one camera.
    pub(crate) sights: Arc<Vec<Vec<Sight>>>,
    /// By how much lens or readout differ from those that the sights are free of.
    pub(crate) change: [f64; 2],
    /// What is unknown of the camera.
    pub(crate) unknown: Unknown,
}

/// What of the camera is adjusted with the poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Unknown {
    Nothing,
    FocalLength,
    FocalLengthAndRows,
    FocalLengthAndLens,
}

impl Sight {
    /// Where another lens or readout would leave it [px].
    fn freed(&self, change: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|i| {
            self.at[i] + change[0] * self.moves[0][i] + change[1] * self.moves[1][i]
        })
    }
}

impl Bundle {
    /// Takes at most `steps` steps, fewer where `progress` has had enough; returns the cost per sight,
    /// in variances.
    pub(crate) fn adjust(&mut self, steps: usize, progress: &Progress) -> f64 {
        let mut cost = self.cost();
        let mut damping = 1e-4;
        let structure = Structure::new(self);
        let mut linear = Linear::new(self, &structure, Curvature::Bounding);
        for done in 0..steps {
            if progress.is_cancelled() {
                break;
            }
            if self.poses.len() > TOLD {
                progress.report(Stage::BundleAdjustment, done, steps);
            }
            let moved = linear.step(damping).map(|step| self.moved(&step));
            let next = moved.as_ref().map_or(f64::INFINITY, Self::cost);
            match moved {
                Some(moved) if next < cost => {
                    let gained = cost - next;
                    (*self, cost, damping) = (moved, next, (damping * 0.2).max(1e-9));
                    if gained < CONVERGED * cost {
                        break;
                    }
                    linear = Linear::new(self, &structure, Curvature::Bounding);
                }
                _ => damping *= 8.0,
            }
            if damping > STUCK {
                break;
            }
        }
        cost / self.sights.iter().map(Vec::len).sum::<usize>().max(1) as f64
    }

    /// Variance of every landmark's inverse depth while poses stay; `None` where it is not
    /// defined.
    pub(crate) fn inverse_depth_variances(&self) -> Vec<Option<f64>> {
        let structure = Structure::new(self);
        Linear::new(self, &structure, Curvature::Bounding).inverse_depth_variances()
    }

    /// How many of the unknowns that all sights share are looked for.
    fn globals(&self) -> usize {
        match self.unknown {
            Unknown::Nothing => 0,
            Unknown::FocalLength => 1,
            Unknown::FocalLengthAndRows => 2,
            Unknown::FocalLengthAndLens => GLOBALS,
        }
    }

    /// The cost of all sights, in variances.
    fn cost(&self) -> f64 {
        let part = |range: std::ops::Range<usize>| -> f64 {
            range.map(|i| self.sights[i].iter().map(|s| self.sight_cost(i, s)).sum::<f64>()).sum()
        };
        let mut total = 0.0;
        reduce_in_order(self.landmarks.len(), CHUNK, part, |sum| total += sum);
        if total.is_finite() { total } else { f64::INFINITY }
    }

    fn sight_cost(&self, landmark: usize, sight: &Sight) -> f64 {
        huber(self.residual(landmark, sight)).1
    }

    /// Length of a residual [standard deviations].
    pub(crate) fn residual(&self, landmark: usize, sight: &Sight) -> f64 {
        let at = self.landmarks[landmark].image_position(&self.camera, &self.poses[sight.pose]);
        let seen = sight.freed(self.change);
        at.map_or(BEHIND, |at| (at[0] - seen[0]).hypot(at[1] - seen[1]) / sight.sigma)
    }

    fn moved(&self, step: &Step) -> Self {
        let mut out = self.clone();
        for (pose, tangent) in out.poses.iter_mut().zip(&step.poses) {
            *pose = pose.retract(Tangent::from_array(*tangent));
        }
        for (landmark, change) in out.landmarks.iter_mut().zip(&step.landmarks) {
            (0..3).for_each(|i| landmark.values[i] += change[i]);
        }
        let globals: [f64; GLOBALS] =
            std::array::from_fn(|i| step.globals[i].clamp(-MAX_STEP[i], MAX_STEP[i]));
        (0..2).for_each(|i| out.change[i] += globals[1 + i]);
        let scale = globals[0].exp();
        (out.camera.fx, out.camera.fy) = (out.camera.fx * scale, out.camera.fy * scale);
        out
    }
}

#[cfg(test)]
mod tests;

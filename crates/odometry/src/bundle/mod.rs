//! Bundle adjustment of poses, landmarks and, on demand, focal length with lens distortion or
//! rolling-shutter readout.
//!
//! Minimises
//!
//! ```text
//! Σ huber(‖projection - observation‖_Σ) + Σ huber(|1/z - measured 1/z| / σ_d)
//!     + Σ huber(‖measured⁻¹ · relative pose‖_Λ)
//! ```
//!
//! over observations with covariance `Σ` (`‖r‖_Σ² = rᵀ Σ⁻¹ r`), measured depths and relative poses
//! with information `Λ`, by Levenberg-Marquardt; landmarks are eliminated by the Schur complement
//! (Triggs et al. 2000, section 6), and placed anew after every step ([`intersection`]).

mod blocks;
mod covariance;
mod intersection;
mod normal_equations;
mod picture_region;
mod pose_scatter;
mod relative_pose;
mod resection;
mod response;
mod sparsity;

pub(crate) use covariance::IntrinsicsCovariance;
pub(crate) use pose_scatter::PoseScatter;
pub(crate) use relative_pose::RelativePoseFactor;

use crate::multiview::landmark::Landmark;
use crate::multiview::lens_distortion::CameraJacobian;
use crate::multiview::robust_loss::{huber, length};
use crate::multiview::whitening::Whitening;
use crate::progress::{Progress, Stage};
use crate::track::tracks::DepthReading;
use blocks::Curvature;
use i2slam_compute::reduce_in_order;
use i2slam_geometry::{Camera, Pose, Tangent};
use normal_equations::{BundleStep, SchurSystem};
use sparsity::BlockSparsity;
use std::sync::Arc;

/// Landmarks per task.
const LANDMARKS_PER_TASK: usize = 128;
/// Residual of a landmark behind a camera [standard deviations]: farther than any before it, whose deviation
/// may be a twentieth of a pixel.
const BEHIND_CAMERA_ERROR: f64 = 1e4;
/// Damping at which the iteration gives up.
const MAX_DAMPING: f64 = 1e6;
/// Poses from which on progress is reported: smaller bundles take milliseconds.
const MIN_REPORTED_POSES: usize = 64;
/// Relative decrease of the cost at which a resection has converged.
const MIN_RELATIVE_DECREASE: f64 = 1e-5;
/// Decrease of the cost by a step that ends the iteration, as a ratio to [`Bundle::excess_at_truth`]. Further
/// steps follow the noise along what pictures hardly tell, such as the length of a path behind a weak link.
const CONVERGED_DECREASE: f64 = 0.01;
/// Parameters shared by all observations: logarithm of the focal length, [`CameraJacobian`]'s.
const GLOBALS: usize = 3;
/// Largest change of each of them per step.
const MAX_GLOBAL_STEP: [f64; GLOBALS] = [0.2, 0.1, 0.1];

/// Observation of a landmark by one pose of the bundle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BundleObservation {
    /// Index of the pose.
    pub(crate) pose: usize,
    /// Corrected image position [px].
    pub(crate) at: [f64; 2],
    /// Its deviation.
    pub(crate) whitening: Whitening,
    /// Its derivatives by distortion or readout.
    pub(crate) camera_jacobian: CameraJacobian,
    /// The measured inverse depth, if there is one.
    pub(crate) depth: Option<DepthReading>,
}

/// A bundle adjustment problem and its current solution.
#[derive(Clone, Debug)]
pub(crate) struct Bundle {
    pub(crate) camera: Camera<f64>,
    /// `world_from_camera`.
    pub(crate) poses: Vec<Pose<f64>>,
    /// Poses that are not adjusted.
    pub(crate) fixed: Vec<bool>,
    pub(crate) landmarks: Vec<Landmark>,
    /// Observations of every landmark in order of poses, at most one per pose.
    pub(crate) observations: Arc<Vec<Vec<BundleObservation>>>,
    /// Measured relative poses.
    pub(crate) relative_poses: Arc<Vec<RelativePoseFactor>>,
    /// Change of distortion or readout relative to what the observations are corrected for.
    pub(crate) camera_change: [f64; 2],
    /// Intrinsics that are adjusted.
    pub(crate) free_intrinsics: FreeIntrinsics,
}

/// Intrinsics that are adjusted with the poses; the value is the number of parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FreeIntrinsics {
    None = 0,
    FocalLength = 1,
    FocalLengthAndReadout = 2,
    FocalLengthAndDistortion = 3,
}

impl BundleObservation {
    /// The position corrected for changed distortion or readout [px].
    fn corrected(&self, camera_change: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|i| {
            self.at[i]
                + camera_change[0] * self.camera_jacobian[0][i]
                + camera_change[1] * self.camera_jacobian[1][i]
        })
    }

    /// Robust cost where the landmark is behind the camera.
    fn cost_behind_camera(&self) -> f64 {
        huber(BEHIND_CAMERA_ERROR).1 * if self.depth.is_some() { 2.0 } else { 1.0 }
    }
}

impl Bundle {
    /// Takes up to `steps` steps; returns the mean cost per observation [variances].
    pub(crate) fn adjust(&mut self, steps: usize, progress: &Progress) -> f64 {
        let mut cost = self.cost();
        let mut damping = 1e-4;
        let min_decrease = CONVERGED_DECREASE * self.excess_at_truth();
        let sparsity = BlockSparsity::new(self);
        let mut linear = SchurSystem::new(self, &sparsity, Curvature::Majorizing);
        for done in 0..steps {
            if progress.is_cancelled() {
                break;
            }
            if self.poses.len() > MIN_REPORTED_POSES {
                progress.report(Stage::BundleAdjustment, done, steps);
            }
            let mut moved = linear.step(damping).map(|step| self.apply_step(&step));
            moved.iter_mut().for_each(Self::intersect_landmarks);
            let next = moved.as_ref().map_or(f64::INFINITY, Self::cost);
            match moved {
                Some(moved) if next < cost => {
                    let gained = cost - next;
                    (*self, cost, damping) = (moved, next, (damping * 0.2).max(1e-9));
                    if gained < min_decrease * cost {
                        break;
                    }
                    linear = SchurSystem::new(self, &sparsity, Curvature::Majorizing);
                }
                _ => damping *= 8.0,
            }
            if damping > MAX_DAMPING {
                break;
            }
        }
        cost / self.observations.iter().map(Vec::len).sum::<usize>().max(1) as f64
    }

    /// Ratio by which the cost of the true poses exceeds that of the minimum in the mean, for independent noise:
    /// the number of their parameters over that of the residuals less all parameters, at most 1.
    fn excess_at_truth(&self) -> f64 {
        let observations = self.observations.iter().flatten();
        let rows: usize = observations.map(|o| 2 + usize::from(o.depth.is_some())).sum();
        let rows = rows + 6 * self.relative_poses.len();
        let free = self.fixed.iter().filter(|fixed| !**fixed).count();
        let poses = 6 * free + self.free_intrinsics as usize;
        let redundant = rows.saturating_sub(poses + 3 * self.landmarks.len());
        (poses as f64 / redundant.max(1) as f64).min(1.0)
    }

    /// Multiplies the standard deviations of all measured depths.
    pub(crate) fn scale_depth_deviations(&mut self, by: f64) {
        let observations = Arc::make_mut(&mut self.observations).iter_mut().flatten();
        observations.filter_map(|o| o.depth.as_mut()).for_each(|depth| depth.sigma *= by);
    }

    /// Variance of every landmark's inverse depth with poses fixed; `None` where it is not defined.
    pub(crate) fn inverse_depth_variances(&self) -> Vec<Option<f64>> {
        let sparsity = BlockSparsity::new(self);
        SchurSystem::new(self, &sparsity, Curvature::Majorizing).inverse_depth_variances()
    }

    /// Robust cost of all observations [variances].
    fn cost(&self) -> f64 {
        let part =
            |range: std::ops::Range<usize>| -> f64 { range.map(|i| self.landmark_cost(i)).sum() };
        let mut total = self.relative_poses.iter().map(|f| f.cost(&self.poses)).sum::<f64>();
        reduce_in_order(self.landmarks.len(), LANDMARKS_PER_TASK, part, |sum| total += sum);
        if total.is_finite() { total } else { f64::INFINITY }
    }

    /// Cost of all observations of a landmark.
    fn landmark_cost(&self, index: usize) -> f64 {
        let landmark = &self.landmarks[index];
        self.observations[index].iter().map(|o| self.observation_cost(landmark, o)).sum()
    }

    fn observation_cost(&self, landmark: &Landmark, observation: &BundleObservation) -> f64 {
        let pose = &self.poses[observation.pose];
        let Some(at) = landmark.image_position(&self.camera, pose) else {
            return observation.cost_behind_camera();
        };
        let seen = observation.corrected(self.camera_change);
        let whitening = &observation.whitening;
        let of_position = huber(length(whitening.apply([at[0] - seen[0], at[1] - seen[1]]))).1;
        let Some(depth) = &observation.depth else { return of_position };
        let off = (landmark.inverse_depth_in(pose) - depth.inverse).abs() / depth.sigma;
        of_position + huber(off).1
    }

    fn apply_step(&self, step: &BundleStep) -> Self {
        let mut out = self.clone();
        for (pose, tangent) in out.poses.iter_mut().zip(&step.poses) {
            *pose = pose.retract(Tangent::from_array(*tangent));
        }
        for (landmark, change) in out.landmarks.iter_mut().zip(&step.landmarks) {
            (0..3).for_each(|i| landmark.values[i] += change[i]);
        }
        let globals: [f64; GLOBALS] =
            std::array::from_fn(|i| step.globals[i].clamp(-MAX_GLOBAL_STEP[i], MAX_GLOBAL_STEP[i]));
        (0..2).for_each(|i| out.camera_change[i] += globals[1 + i]);
        let scale = globals[0].exp();
        (out.camera.fx, out.camera.fy) = (out.camera.fx * scale, out.camera.fy * scale);
        out
    }
}

#[cfg(test)]
mod tests;

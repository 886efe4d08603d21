//! Absolute trajectory error.

use super::association::finite_pairs;
use super::{Alignment, Association, align};
use crate::EvalError;
use crate::statistics::Summary;
use i2slam_geometry::{Similarity, StampedPose, Vec3};
use serde::Serialize;

/// Absolute trajectory error (ATE): distances of camera centres after alignment,
/// `e_i = ‖c_i - (s R ĉ_i + t)‖` with estimate `ĉ`, truth `c` (Sturm et al. 2012).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrajectoryError {
    /// Kind of alignment.
    pub alignment: Alignment,
    /// `sqrt(1/n Σ e²)` [m]: the field's ATE.
    pub ate_rmse_m: f64,
    /// Mean of `e` [m].
    pub ate_mean_m: f64,
    /// Median of `e` [m].
    pub ate_median_m: f64,
    /// Largest `e` [m].
    pub ate_max_m: f64,
    /// Standard deviation of `e`, `sqrt(1/n Σ (e - mean)²)` [m].
    pub ate_std_m: f64,
    /// Number of pairs.
    pub pairs: usize,
    /// Scale that was multiplied onto the estimate; 1 for [`Alignment::Se3`].
    pub scale: f64,
    /// SplaTAM's "ATE RMSE" [m]: the *mean* distance of the
    /// *world-to-camera translations*, `t_i = -R_iᵀ c_i`, after a rigid alignment (always without
    /// scale). These vectors depend on the origin of the world; as there, it is the first pose
    /// (here: of the first pair) in both trajectories. Not comparable with `ate_rmse_m`.
    pub splatam_mean_m: f64,
    /// `e` of every pair [m], in order of time.
    #[serde(skip)]
    pub errors_m: Vec<f64>,
    /// The pairs, in order of time.
    #[serde(skip)]
    pub associations: Vec<Association>,
    /// The transform that aligns the estimate with the truth.
    #[serde(skip)]
    pub truth_from_estimate: Similarity<f64>,
    /// The whole estimate (including poses without a pair), aligned with the truth.
    #[serde(skip)]
    pub aligned_estimate: Vec<StampedPose>,
}

/// Associates (at most `tolerance` seconds apart) at least three pairs, aligns and measures.
pub fn absolute_trajectory_error(
    estimate: &[StampedPose],
    truth: &[StampedPose],
    alignment: Alignment,
    tolerance: f64,
) -> Result<TrajectoryError, EvalError> {
    let associations = finite_pairs(estimate, truth, tolerance, 3)?;
    let estimated = |p: &Association| estimate[p.estimate];
    let true_pose = |p: &Association| truth[p.truth];
    let source = centres(associations.iter().map(estimated));
    let target = centres(associations.iter().map(true_pose));
    let fit = align(&source, &target, alignment)?;
    let errors_m = distances(&fit, &source, &target);
    let summary = Summary::of(&errors_m)?;
    let splatam_mean_m = splatam_mean(
        &world_to_camera_translations(associations.iter().map(estimated)),
        &world_to_camera_translations(associations.iter().map(true_pose)),
    )?;
    let moved = |p: &StampedPose| StampedPose {
        timestamp: p.timestamp,
        world_from_camera: fit.apply_to_pose(p.world_from_camera),
    };
    Ok(TrajectoryError {
        alignment,
        ate_rmse_m: summary.rmse,
        ate_mean_m: summary.mean,
        ate_median_m: summary.median,
        ate_max_m: summary.max,
        ate_std_m: summary.std,
        pairs: summary.count,
        scale: fit.scale,
        splatam_mean_m,
        errors_m,
        associations,
        truth_from_estimate: fit,
        aligned_estimate: estimate.iter().map(moved).collect(),
    })
}

fn centres(poses: impl Iterator<Item = StampedPose>) -> Vec<Vec3<f64>> {
    poses.map(|p| p.world_from_camera.translation).collect()
}

fn distances(fit: &Similarity<f64>, source: &[Vec3<f64>], target: &[Vec3<f64>]) -> Vec<f64> {
    source.iter().zip(target).map(|(&s, &t)| (fit.apply(s) - t).norm()).collect()
}

/// Translations of `camera_from_world` with the first camera as the world.
fn world_to_camera_translations(poses: impl Iterator<Item = StampedPose>) -> Vec<Vec3<f64>> {
    let mut poses = poses.map(|p| p.world_from_camera).peekable();
    let Some(&world_from_first) = poses.peek() else { return Vec::new() };
    poses.map(|p| (p.inverse() * world_from_first).translation).collect()
}

fn splatam_mean(estimate: &[Vec3<f64>], truth: &[Vec3<f64>]) -> Result<f64, EvalError> {
    let fit = align(estimate, truth, Alignment::Se3)?;
    Ok(Summary::of(&distances(&fit, estimate, truth))?.mean)
}

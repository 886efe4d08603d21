//! Relative pose error: drift from frame to frame.

use super::absolute::check_finite;
use super::associate;
use crate::EvalError;
use crate::statistics::Summary;
use i2slam_geometry::{Pose, StampedPose};
use serde::Serialize;

/// Relative pose error (RPE) between successive pairs, `E_i = (Q_i⁻¹ Q_{i+1})⁻¹ (P_i⁻¹ P_{i+1})`
/// with truth `Q` and estimate `P` (Sturm et al. 2012, eq. 2). Needs no alignment; the estimate of
/// a system without scale is to be scaled first
/// ([`TrajectoryError::aligned_estimate`](super::TrajectoryError::aligned_estimate)).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RelativePoseError {
    /// Root mean square length of the translation of `E` [m per frame].
    pub rpe_translation_rmse_m: f64,
    /// Mean of the same [m per frame].
    pub rpe_translation_mean_m: f64,
    /// Median of the same [m per frame].
    pub rpe_translation_median_m: f64,
    /// Largest of the same [m per frame].
    pub rpe_translation_max_m: f64,
    /// Root mean square angle of the rotation of `E` [degrees per frame].
    pub rpe_rotation_rmse_deg: f64,
    /// Mean of the same [degrees per frame].
    pub rpe_rotation_mean_deg: f64,
    /// Median of the same [degrees per frame].
    pub rpe_rotation_median_deg: f64,
    /// Largest of the same [degrees per frame].
    pub rpe_rotation_max_deg: f64,
    /// Number of steps: one less than the number of associated poses.
    pub steps: usize,
}

/// Associates (at most `tolerance` seconds apart) and measures every step to the next pair.
/// A frame without a pair lengthens the step across it.
pub fn relative_pose_error(
    estimate: &[StampedPose],
    truth: &[StampedPose],
    tolerance: f64,
) -> Result<RelativePoseError, EvalError> {
    let pairs = associate(estimate, truth, tolerance)?;
    if pairs.len() < 2 {
        return Err(EvalError::TooFew { what: "pairs of poses", found: pairs.len(), needed: 2 });
    }
    check_finite(estimate, "the estimated poses")?;
    check_finite(truth, "the true poses")?;
    let step = |poses: &[StampedPose], from: usize, to: usize| -> Pose<f64> {
        poses[from].world_from_camera.inverse() * poses[to].world_from_camera
    };
    let (translations, rotations): (Vec<f64>, Vec<f64>) = pairs
        .windows(2)
        .map(|w| {
            let made = step(estimate, w[0].estimate, w[1].estimate);
            let due = step(truth, w[0].truth, w[1].truth);
            let error = due.inverse() * made;
            (error.translation.norm(), error.rotation.log().norm().to_degrees())
        })
        .unzip();
    let (t, r) = (Summary::of(&translations)?, Summary::of(&rotations)?);
    Ok(RelativePoseError {
        rpe_translation_rmse_m: t.rmse,
        rpe_translation_mean_m: t.mean,
        rpe_translation_median_m: t.median,
        rpe_translation_max_m: t.max,
        rpe_rotation_rmse_deg: r.rmse,
        rpe_rotation_mean_deg: r.mean,
        rpe_rotation_median_deg: r.median,
        rpe_rotation_max_deg: r.max,
        steps: t.count,
    })
}

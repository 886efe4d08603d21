//! Relative pose error: drift over a step of frames or seconds.

use super::Association;
use super::association::finite_pairs;
use crate::EvalError;
use crate::statistics::Summary;
use i2slam_geometry::{Pose, StampedPose, nearest_stamp};
use serde::Serialize;

/// Steps over which drift is measured, counted in associated poses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Step {
    /// From every n-th pose to the next such one, `0 → n → 2n …` (`evo_rpe -d n -u f`).
    Frames(usize),
    /// From *every* pose to the n-th after it (`evo_rpe -d n -u f --all_pairs`).
    OverlappingFrames(usize),
    /// From every pose to the one whose estimated stamp is nearest to this many seconds later, by at
    /// most a tenth of the step or the tolerance of the association; steps that end at the last
    /// pose are left out (the pairs of the TUM benchmark's `evaluate_rpe --fixed_delta
    /// --delta_unit s`).
    Seconds(f64),
}

/// Relative pose error (RPE), `E = (Q_i⁻¹ Q_j)⁻¹ (P_i⁻¹ P_j)` with truth `Q` and estimate `P` over
/// the steps from `i` to `j` (Sturm et al. 2012, eq. 2). Needs no alignment; the estimate of
/// a system without scale is to be scaled first
/// ([`TrajectoryError::aligned_estimate`](super::TrajectoryError::aligned_estimate)).
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RelativePoseError {
    /// The kind of step.
    pub rpe_step: Step,
    /// Root mean square length of the translation of `E` [m per step].
    pub rpe_translation_rmse_m: f64,
    /// Mean length [m per step].
    pub rpe_translation_mean_m: f64,
    /// Median length [m per step].
    pub rpe_translation_median_m: f64,
    /// Largest length [m per step].
    pub rpe_translation_max_m: f64,
    /// Root mean square angle of the rotation of `E` [degrees per step].
    pub rpe_rotation_rmse_deg: f64,
    /// Mean angle [degrees per step].
    pub rpe_rotation_mean_deg: f64,
    /// Median angle [degrees per step].
    pub rpe_rotation_median_deg: f64,
    /// Largest angle [degrees per step].
    pub rpe_rotation_max_deg: f64,
    /// Number of steps.
    #[serde(rename = "rpe_steps")]
    pub steps: usize,
}

/// Associates (at most `tolerance` seconds apart) and measures every step between pairs.
pub fn relative_pose_error(
    estimate: &[StampedPose],
    truth: &[StampedPose],
    step: Step,
    tolerance: f64,
) -> Result<RelativePoseError, EvalError> {
    let pairs = finite_pairs(estimate, truth, tolerance, 2)?;
    let moved = |poses: &[StampedPose], from: usize, to: usize| -> Pose<f64> {
        poses[from].world_from_camera.inverse() * poses[to].world_from_camera
    };
    let steps = steps(&pairs, estimate, step, tolerance)?;
    if steps.is_empty() {
        return Err(EvalError::TooFew { what: "steps of this length", found: 0, needed: 1 });
    }
    let (translations, rotations): (Vec<f64>, Vec<f64>) = steps
        .iter()
        .map(|&[from, to]| {
            let made = moved(estimate, pairs[from].estimate, pairs[to].estimate);
            let due = moved(truth, pairs[from].truth, pairs[to].truth);
            let error = due.inverse() * made;
            (error.translation.norm(), error.rotation.log().norm().to_degrees())
        })
        .unzip();
    let (t, r) = (Summary::of(&translations)?, Summary::of(&rotations)?);
    Ok(RelativePoseError {
        rpe_step: step,
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

/// The steps as indices into the list of pairs.
fn steps(
    pairs: &[Association],
    estimate: &[StampedPose],
    step: Step,
    tolerance: f64,
) -> Result<Vec<[usize; 2]>, EvalError> {
    let count = pairs.len();
    match step {
        Step::Frames(0) | Step::OverlappingFrames(0) => Err(EvalError::InvalidStep),
        Step::Frames(n) => Ok((n..count).step_by(n).map(|to| [to - n, to]).collect()),
        Step::OverlappingFrames(n) => Ok((n..count).map(|to| [to - n, to]).collect()),
        Step::Seconds(s) if !(s.is_finite() && s > 0.0) => Err(EvalError::InvalidStep),
        Step::Seconds(s) => {
            let stamps: Vec<f64> = pairs.iter().map(|p| estimate[p.estimate].timestamp).collect();
            let apart = tolerance.max(0.1 * s);
            let end = |from: usize| nearest_stamp(&stamps, stamps[from] + s, apart);
            let inside = |&[from, to]: &[usize; 2]| to > from && to + 1 < count;
            Ok((0..count).filter_map(|i| Some([i, end(i)?])).filter(inside).collect())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_geometry::{Rotation, Vec3};

    fn at(stamps: &[f64]) -> Vec<StampedPose> {
        let pose = |&t: &f64| Pose::new(Rotation::identity(), Vec3::new(t * t, 0.0, 0.0));
        stamps.iter().map(|t| StampedPose { timestamp: *t, world_from_camera: pose(t) }).collect()
    }

    fn places(stamps: &[f64], step: Step) -> Vec<[usize; 2]> {
        let pair = |i| Association { estimate: i, truth: i };
        let pairs: Vec<Association> = (0..stamps.len()).map(pair).collect();
        steps(&pairs, &at(stamps), step, 0.02).unwrap()
    }

    #[test]
    fn steps_by_hand() {
        let stamps = [0.0, 0.1, 0.2, 0.3, 0.6, 0.7];
        assert_eq!(places(&stamps, Step::Frames(2)), [[0, 2], [2, 4]]);
        assert_eq!(places(&stamps, Step::OverlappingFrames(4)), [[0, 4], [1, 5]]);
        // From 0.2 and 0.3 nothing is 0.2 s away; 0.7 is the last pose.
        assert_eq!(places(&stamps, Step::Seconds(0.2)), [[0, 2], [1, 3]]);
        assert_eq!(places(&stamps, Step::Seconds(0.3)), [[0, 3], [3, 4]]);
    }

    #[test]
    fn steps_that_mean_nothing_are_refused() {
        let poses = at(&[0.0, 0.1, 0.2, 0.3]);
        let of = |step| relative_pose_error(&poses, &poses, step, 0.02);
        for step in [Step::Frames(0), Step::Seconds(0.0), Step::Seconds(f64::NAN)] {
            assert_eq!(of(step), Err(EvalError::InvalidStep));
        }
        assert!(matches!(of(Step::Frames(4)), Err(EvalError::TooFew { .. })));
        assert!(matches!(of(Step::Seconds(9.0)), Err(EvalError::TooFew { .. })));
    }
}

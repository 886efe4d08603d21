//! Observability of focal length and distortion.

use crate::bundle::IntrinsicsCovariance;
use crate::register::registration::{adjust_globally, adjust_path};
use crate::sfm_state::{MAX_JOINT_POSES, SfmState};

/// Significance of a distortion: the 99th percentile of a sum of two squared normal variables.
const DISTORTION_SIGNIFICANCE: f64 = 9.21;
/// Relative deviation of the focal length with distortion that is always accepted, and its largest
/// ratio to that without. Looser bounds accepted spurious distortion of pinhole pictures from a
/// camera moving along a line, with focal lengths off by 5 and by 50 percent.
const MAX_FOCAL_DEVIATION: f64 = 0.005;
const MAX_DEVIATION_RATIO: f64 = 1.5;
/// Most adjustments with free intrinsics, and the relative change of the focal length at which they end.
const MAX_ROUNDS: usize = 5;
const CONVERGED_CHANGE: f64 = 1e-3;

/// Adjusts the first [`MAX_JOINT_POSES`] keyframes with free intrinsics; also their covariance.
pub(crate) fn reestimate_intrinsics(
    mut state: SfmState,
) -> (SfmState, Option<IntrinsicsCovariance>) {
    let keyframes = state.tracks.keyframes.iter().copied();
    let posed = keyframes.filter(|f| state.poses[*f].is_some());
    let keyframes: Vec<usize> = posed.take(MAX_JOINT_POSES).collect();
    let mut poses = vec![None; state.poses.len()];
    keyframes.iter().for_each(|f| poses[*f] = state.poses[*f]);
    (state.poses, state.progress) = (poses, state.progress.without_listener());
    // From the map of a wrong camera few observations agree at first.
    for _ in 0..MAX_ROUNDS {
        let before = state.camera.fx;
        adjust_globally(&mut state, true);
        if (state.camera.fx / before).ln().abs() < CONVERGED_CHANGE {
            break;
        }
    }
    let covariance = state.bundle(&keyframes, true).0.camera_covariance();
    (state, covariance)
}

/// Drops a distortion that is not significant or leaves the focal length far less certain (a camera
/// on a line confuses both), and any beside a rolling shutter, which bends pictures alike. Returns
/// whether it was dropped.
pub(crate) fn drop_unobservable_distortion(state: &mut SfmState) -> bool {
    if !state.estimates_distortion || state.distortion == [0.0; 2] {
        return false;
    }
    let mut without = state.clone();
    without.estimates_distortion = false;
    without.update_distortion(state.distortion.map(|v| -v));
    adjust_path(&mut without, true);
    let (reestimated, with_distortion) = reestimate_intrinsics(state.clone());
    let (_, without_distortion) = reestimate_intrinsics(without.clone());
    let is_observable = state.readout == 0.0
        && with_distortion.is_some_and(|with_distortion| {
            is_significant(reestimated.distortion, &with_distortion)
                && keeps_focal_length_certain(&with_distortion, without_distortion)
        });
    if !is_observable {
        *state = without;
    }
    !is_observable
}

/// Whether the focal length stays about as certain as without distortion.
fn keeps_focal_length_certain(
    with_distortion: &IntrinsicsCovariance,
    without_distortion: Option<IntrinsicsCovariance>,
) -> bool {
    let deviation = |covariance: &IntrinsicsCovariance| covariance[0][0].sqrt();
    let found = deviation(with_distortion);
    found < MAX_FOCAL_DEVIATION
        || without_distortion.is_some_and(|without_distortion| {
            found < MAX_DEVIATION_RATIO * deviation(&without_distortion)
        })
}

/// Whether two coefficients are significant by `lensᵀ Σ⁻¹ lens`.
fn is_significant(distortion: [f64; 2], covariance: &IntrinsicsCovariance) -> bool {
    let [_, [_, aa, ab], [_, _, bb]] = covariance;
    let [a, b] = distortion;
    let determinant = aa * bb - ab * ab;
    let square = (a * a * bb - 2.0 * a * b * ab + b * b * aa) / determinant;
    determinant > 0.0 && square > DISTORTION_SIGNIFICANCE
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{self, camera};
    use i2slam_geometry::{Pose, Rotation, Vec3};

    /// A camera on a winding path, every frame a keyframe that begins three points.
    fn winding(frames: usize) -> SfmState {
        let pose = |frame: usize| {
            let s = frame as f64;
            let turn = Vec3::new(0.03 * (0.5 * s).sin(), 0.06 * (0.3 * s).cos(), 0.0);
            Pose::new(Rotation::exp(turn), Vec3::new(0.05 * s, 0.0, 0.1 * (0.4 * s).sin()))
        };
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = camera().project(pose(frame).inverse() * point);
            Some([u + 0.3 * n[0], v + 0.3 * n[1]])
        };
        fixtures::state((frames, 3, 1), [140.0, 100.0], pose, observe)
    }

    /// The camera of a long sequence is estimated from the first keyframes alone.
    #[test]
    fn a_long_sequence_takes_no_more_room_than_its_first_keyframes() {
        let (reestimated, covariance) = reestimate_intrinsics(winding(MAX_JOINT_POSES + 60));
        assert_eq!(reestimated.posed_frames(), (0..MAX_JOINT_POSES).collect::<Vec<_>>());
        let (error, deviation) =
            ((reestimated.camera.fx / 250.0).ln(), covariance.expect("determined")[0][0].sqrt());
        assert!(deviation < 0.01 && error.abs() < 3.0 * deviation, "{error} {deviation}");
    }

    #[test]
    fn a_lens_must_leave_the_focal_length_certain() {
        let of = |deviation: f64| {
            let mut covariance = [[0.0; 3]; 3];
            covariance[0][0] = deviation * deviation;
            covariance
        };
        assert!(keeps_focal_length_certain(&of(0.012), Some(of(0.01))));
        assert!(keeps_focal_length_certain(&of(0.004), Some(of(0.001))));
        assert!(!keeps_focal_length_certain(&of(0.012), Some(of(0.005))));
        assert!(!keeps_focal_length_certain(&of(0.012), None));
    }

    #[test]
    fn a_lens_counts_by_its_own_covariance() {
        // Along (1, -1) hardly anything is known, along (1, 1) much.
        let covariance = [[1.0, 0.0, 0.0], [0.0, 1.01, -0.99], [0.0, -0.99, 1.01]];
        assert!(is_significant([0.4, 0.4], &covariance));
        assert!(!is_significant([0.4, -0.4], &covariance));
        assert!(!is_significant([0.0, 0.0], &covariance));
        assert!(!is_significant([0.4, 0.4], &[[0.0; 3]; 3]));
    }
}

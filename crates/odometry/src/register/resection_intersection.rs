//! Adjustment of the frames between keyframes by resection and intersection in turn (Kraus 2007,
//! section 4.3).
//!
//! Resection poses every frame between keyframes by landmarks, depth and dense constraints to
//! keyframes; intersection places every landmark by all frames. Keyframes hold the path together, so
//! that few rounds do; time and memory rise with the number of observations.

use crate::bundle::{Bundle, BundleObservation, FreeIntrinsics, RelativePoseFactor};
use crate::depth::readings::update_depth_model;
use crate::multiview::landmark::Landmark;
use crate::multiview::triangulation::{PosedObservation, refine_landmark};
use crate::progress::Stage;
use crate::sfm_state::SfmState;
use crate::track::tracks::{DepthReading, Observation};
use i2slam_geometry::Pose;
use rayon::prelude::*;
use std::sync::Arc;

/// Rounds before and after outliers are rejected anew.
const ROUNDS: usize = 3;
/// Steps of a resection in a round.
const STEPS: usize = 6;

/// Adjusts the frames between adjusted keyframes in turn with the landmarks, without outliers.
pub(crate) fn adjust_in_turn(state: &mut SfmState) {
    adjust_between(state);
    state.update_noise_scale();
    update_depth_model(state);
    state.reject_outliers();
    state.triangulate_missing();
    adjust_between(state);
    state.reject_outliers();
}

/// Rounds of resection and intersection.
fn adjust_between(state: &mut SfmState) {
    let constraints = constraints_by_frame(state);
    for done in 0..ROUNDS {
        if state.progress.is_cancelled() {
            return;
        }
        state.progress.report(Stage::BundleAdjustment, done, ROUNDS);
        adjust_frames(state, &constraints);
        adjust_landmarks(state);
    }
}

/// Dense constraints of every frame that is no keyframe, by index.
fn constraints_by_frame(state: &SfmState) -> Vec<Vec<usize>> {
    let mut out = vec![Vec::new(); state.poses.len()];
    for (index, factor) in state.relative_poses.iter().enumerate() {
        for frame in [factor.first, factor.second] {
            if state.tracks.keyframes.binary_search(&frame).is_err() {
                out[frame].push(index);
            }
        }
    }
    out
}

/// Resection of all posed frames between keyframes.
fn adjust_frames(state: &mut SfmState, constraints: &[Vec<usize>]) {
    let is_keyframe = |frame: &usize| state.tracks.keyframes.binary_search(frame).is_ok();
    let is_shared = state.shared_landmarks();
    let resected = |frame: usize| {
        let pose = state.poses[frame].filter(|_| !is_keyframe(&frame))?;
        let mut bundle = bundle_of_frame(state, (frame, pose), &constraints[frame], &is_shared);
        bundle.adjust_free_pose(STEPS);
        bundle.poses.first().copied()
    };
    let found: Vec<Option<Pose<f64>>> =
        (0..state.poses.len()).into_par_iter().map(resected).collect();
    for (pose, found) in state.poses.iter_mut().zip(found) {
        *pose = found.or(*pose);
    }
}

/// The bundle of one frame, its landmarks and the keyframes that it was aligned to.
fn bundle_of_frame(
    state: &SfmState,
    (frame, pose): (usize, Pose<f64>),
    constraints: &[usize],
    is_shared: &[bool],
) -> Bundle {
    let seen = |track: &usize| {
        let landmark = state.landmarks[*track].filter(|_| is_shared[*track])?;
        let o = state.tracks.tracks[*track].observation_in(frame)?;
        (!o.is_outlier).then(|| (landmark, observation(state, o)))
    };
    let (landmarks, observations): (Vec<Landmark>, Vec<Vec<BundleObservation>>) =
        state.by_frame[frame].iter().filter_map(seen).map(|(l, o)| (l, vec![o])).unzip();
    let mut poses = vec![pose];
    let square = state.noise_scale * state.noise_scale;
    let mut place = |other: usize| {
        if other == frame {
            return Some(0);
        }
        poses.push(state.poses[other]?);
        Some(poses.len() - 1)
    };
    let placed = |index: &usize| {
        let factor = &state.relative_poses[*index];
        let information = factor.information.map(|row| row.map(|v| square * v));
        let (first, second) = (place(factor.first)?, place(factor.second)?);
        Some(RelativePoseFactor { first, second, information, ..*factor })
    };
    let relative_poses: Vec<RelativePoseFactor> = constraints.iter().filter_map(placed).collect();
    Bundle {
        camera: state.camera,
        fixed: (0..poses.len()).map(|place| place > 0).collect(),
        poses,
        landmarks,
        observations: Arc::new(observations),
        relative_poses: Arc::new(relative_poses),
        camera_change: [0.0; 2],
        free_intrinsics: FreeIntrinsics::None,
    }
}

/// An observation of the first pose of a bundle.
fn observation(state: &SfmState, o: &Observation) -> BundleObservation {
    let (depth, camera_jacobian) = (scaled_depth(state, o), [[0.0; 2]; 2]);
    BundleObservation { pose: 0, at: o.at(), whitening: *o.whitening(), camera_jacobian, depth }
}

/// The reading of an observation, its deviation as a ratio to those of positions as the tracker
/// claims them, which residuals exceed.
fn scaled_depth(state: &SfmState, o: &Observation) -> Option<DepthReading> {
    o.depth().map(|d| DepthReading { sigma: d.sigma / state.noise_scale, ..d })
}

/// Intersection of all landmarks that two adjusted frames observe.
fn adjust_landmarks(state: &mut SfmState) {
    let intersected = |track: usize| {
        let landmark = state.landmarks[track]?;
        let scaled: Vec<(Observation, Pose<f64>)> = state
            .adjusted_inliers(track)
            .filter_map(|o| Some((o.with_depth(scaled_depth(state, o)), state.poses[o.frame]?)))
            .collect();
        let posed: Vec<PosedObservation<'_>> = scaled.iter().map(|(o, p)| (o, *p)).collect();
        if posed.len() < 2 { None } else { refine_landmark(&state.camera, landmark, &posed) }
    };
    let found: Vec<Option<Landmark>> =
        (0..state.landmarks.len()).into_par_iter().map(intersected).collect();
    for (landmark, found) in state.landmarks.iter_mut().zip(found) {
        *landmark = found.or(*landmark);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;
    use crate::register::registration::{adjust_globally, adjust_keyframes};
    use i2slam_check::noise;
    use i2slam_geometry::{Rotation, Tangent, Vec3};

    const FRAMES: usize = 60;

    fn path(frame: usize) -> Pose<f64> {
        let s = frame as f64;
        let turn = Vec3::new(0.02 * (0.3 * s).sin(), 0.03 * (0.2 * s).cos(), 0.002 * s);
        Pose::new(Rotation::exp(turn), Vec3::new(0.02 * s, 0.04 * (0.3 * s).sin(), 0.0))
    }

    /// Points with 0.4 px of noise and depth with a hundredth of noise in every frame.
    fn noisy() -> SfmState {
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = fixtures::camera().project(path(frame).inverse() * point);
            Some([u + 0.7 * n[0], v + 0.7 * n[1]])
        };
        let mut state = fixtures::state((FRAMES, 12, 4), [150.0, 110.0], path, observe);
        for (index, track) in state.tracks.tracks.iter_mut().enumerate() {
            let Some(landmark) = state.landmarks[index] else { continue };
            let n = noise(9000 + index as u64, track.observations.len());
            for (o, n) in track.observations.iter_mut().zip(n) {
                let inverse = landmark.inverse_depth_in(&path(o.frame));
                let (inverse, sigma) = (inverse * (1.0 + 0.017 * n), 0.01 * inverse);
                *o = o.with_depth(Some(DepthReading { inverse, sigma }));
            }
        }
        state.relative_poses = Arc::new((0..FRAMES).flat_map(constraints).collect());
        state
    }

    /// Constraints of a frame to the keyframes before and after it, of a keyframe to three before it,
    /// with errors of half a millimetre and milliradian.
    fn constraints(frame: usize) -> Vec<RelativePoseFactor> {
        let deviation = 0.0005;
        let information = std::array::from_fn(|i| {
            std::array::from_fn(|j| if i == j { 1.0 / (deviation * deviation) } else { 0.0 })
        });
        let own = noise(700 + frame as u64, 6);
        let off = Tangent::from_array(std::array::from_fn(|i| 1.7 * deviation * own[i]));
        let keyframe = frame - frame % 4;
        let references = match frame == keyframe {
            true => vec![frame.wrapping_sub(4), frame.wrapping_sub(8), frame.wrapping_sub(12)],
            false => vec![keyframe, keyframe + 4],
        };
        let of = |first: usize| RelativePoseFactor {
            first,
            second: frame,
            first_from_second: (path(first).inverse() * path(frame)).retract(off),
            information,
        };
        references.into_iter().filter(|first| *first < FRAMES).map(of).collect()
    }

    fn error(state: &SfmState) -> f64 {
        let first = state.poses[0].expect("posed");
        let there = path(0);
        let off = |(frame, pose): (usize, &Option<Pose<f64>>)| {
            let found = there * (first.inverse() * pose.expect("posed"));
            (found.translation - path(frame).translation).norm_squared()
        };
        let sum: f64 = state.poses.iter().enumerate().map(off).sum();
        (sum / FRAMES as f64).sqrt()
    }

    /// Frames come nearly as near to the truth as by joint adjustment, and nearer than by points of
    /// the keyframes alone.
    #[test]
    fn adjustment_in_turn_is_nearly_as_good_as_the_joint_one() {
        let (mut joint, mut in_turn) = (noisy(), noisy());
        adjust_globally(&mut joint, false);
        adjust_keyframes(&mut in_turn, false);
        let before = error(&in_turn);
        adjust_in_turn(&mut in_turn);
        let (joint, in_turn) = (error(&joint), error(&in_turn));
        assert!(in_turn < 1.5 * joint && in_turn < 0.8 * before, "{joint} {in_turn} {before}");
    }
}

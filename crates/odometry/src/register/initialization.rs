//! Initialization from two keyframes.

use crate::depth::readings::read_depth;
use crate::error::OdometryError;
use crate::multiview::triangulation::parallax;
use crate::multiview::two_view::{
    RelativePose, estimate_relative_pose, fit_rotation, orbit_poses, poses_turned_by, ray_pairs,
};
use crate::sfm_state::SfmState;
use i2slam_compute::median;
use i2slam_geometry::{Pose, Rotation};
use rayon::prelude::*;
use std::ops::Range;

/// Largest number of keyframes from the first to the second of a pair.
const MAX_KEYFRAME_GAP: usize = 12;
/// Pairs for which a relative pose is estimated.
const MAX_CANDIDATES: usize = 12;
/// Points that a pair must share.
const MIN_SHARED: usize = 40;
/// Inlier ratio of a pair's relative pose.
const MIN_INLIER_RATIO: f64 = 0.6;
/// Least median residual of a rotation over the focal length: a pixel at 250.
const MIN_PARALLAX: f64 = 0.004;
/// Residual at which more parallax makes a pair no better, over the focal length.
const SUFFICIENT_PARALLAX: f64 = 0.06;
/// Median motion below which a camera stands still, over the picture's width.
const MAX_STILL_MOTION: f64 = 0.005;
/// Landmarks with a parallax of at least [`MIN_ANGLE`] that a pair must give.
const MIN_LANDMARKS: usize = 20;
/// Three deviations of a tracked position at a focal length of 250 px [rad].
const MIN_ANGLE: f64 = 0.005;

/// A pair of keyframes with the rotation between them.
#[derive(Clone, Copy, Debug)]
struct KeyframePair {
    first: usize,
    second: usize,
    shared: usize,
    rotation: Rotation<f64>,
    /// Median residual of the rotation [px].
    rotation_residual: f64,
    /// Median motion [px].
    motion: f64,
}

/// Poses one of the keyframes in `places` of an empty state whose points have measured depth, or two
/// of them, and triangulates their shared points. Two of them give no unit of length.
pub(crate) fn initialize(state: &mut SfmState, places: Range<usize>) -> Result<(), OdometryError> {
    // A map that began by parallax and was given up did not read depth.
    if std::mem::take(&mut state.is_unscaled) {
        read_depth(state);
    }
    // Photographs agree on a map before one alone is trusted: patterns repeat.
    if state.photographs.is_none() && initialize_from_depth(state, places.clone()) {
        return Ok(());
    }
    leave_out_depth(state);
    initialize_from_parallax(state, places)
}

/// Begins without the unit of length of measured depth, which follows when the map is large enough.
pub(crate) fn leave_out_depth(state: &mut SfmState) {
    state.is_unscaled = true;
    read_depth(state);
}

/// Poses the keyframe with most depth readings; false if none has enough of them.
fn initialize_from_depth(state: &mut SfmState, places: Range<usize>) -> bool {
    let readings = |frame: usize| {
        state
            .observations_in(frame)
            .filter(|(_, observation)| observation.depth().is_some())
            .count()
    };
    let keyframes = state.tracks.keyframes[places].iter();
    let best = keyframes.map(|frame| (readings(*frame), *frame)).max_by_key(|(count, _)| *count);
    let Some((_, frame)) = best.filter(|(count, _)| *count >= MIN_SHARED) else { return false };
    state.poses[frame] = Some(Pose::identity());
    state.triangulate_missing_in(frame);
    true
}

fn initialize_from_parallax(
    state: &mut SfmState,
    places: Range<usize>,
) -> Result<(), OdometryError> {
    let pairs = initial_pairs(state, places)?;
    match pairs.iter().any(|pair| begin_with(state, pair)) {
        true => Ok(()),
        false => Err(OdometryError::NoConsistentMotion),
    }
}

/// Two keyframes with which a map may begin.
pub(crate) struct InitialPair {
    pair: KeyframePair,
    view: RelativePose,
}

impl InitialPair {
    /// The two.
    pub(crate) fn frames(&self) -> [usize; 2] {
        [self.pair.first, self.pair.second]
    }
}

/// Begins a map of an empty state with a pair; false, and the state is empty, if that gives too few landmarks.
pub(crate) fn begin_with(state: &mut SfmState, pair: &InitialPair) -> bool {
    if state.progress.is_cancelled() {
        return false;
    }
    let is_enough = reconstruct_pair(state, &pair.pair, pair.view) >= MIN_LANDMARKS;
    if !is_enough {
        state.reset();
    }
    is_enough
}

/// Pairs of keyframes in `places` with which a map of an empty state may begin by parallax, best first.
pub(crate) fn initial_pairs(
    state: &SfmState,
    places: Range<usize>,
) -> Result<Vec<InitialPair>, OdometryError> {
    let pairs = candidate_pairs(state, places);
    let enough = SUFFICIENT_PARALLAX * state.camera.fx;
    let worth = |p: &KeyframePair| p.rotation_residual.min(enough) * (p.shared as f64).sqrt();
    let moved: Vec<KeyframePair> = {
        let least = MIN_PARALLAX * state.camera.fx;
        let mut moved: Vec<KeyframePair> =
            pairs.iter().filter(|p| p.rotation_residual > least).copied().collect();
        moved.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
        moved.truncate(MAX_CANDIDATES);
        moved
    };
    if moved.is_empty() {
        return Err(diagnose_failure(state, &pairs));
    }
    let tried: Vec<Option<RelativePose>> = moved
        .par_iter()
        .map(|p| {
            if state.progress.is_cancelled() {
                return None;
            }
            let shared = state.shared_positions(p.first, p.second);
            let rays = ray_pairs(&state.camera, &shared);
            match state.photographs.is_some() {
                true => estimate_relative_pose(state.camera.fx, &rays, orbit_poses(&rays)),
                false => {
                    estimate_relative_pose(state.camera.fx, &rays, poses_turned_by(p.rotation))
                }
            }
        })
        .collect();
    let with_view = |(pair, view): (KeyframePair, Option<RelativePose>)| {
        let view = view.filter(|view| view.inlier_ratio >= MIN_INLIER_RATIO)?;
        Some(InitialPair { pair, view })
    };
    let mut candidates: Vec<InitialPair> =
        moved.into_iter().zip(tried).filter_map(with_view).collect();
    let score = |c: &InitialPair| c.view.inlier_ratio * c.view.inlier_ratio * worth(&c.pair);
    candidates.sort_by(|a, b| score(b).total_cmp(&score(a)));
    Ok(candidates)
}

/// All pairs of keyframes in `places` that share enough points.
fn candidate_pairs(state: &SfmState, places: Range<usize>) -> Vec<KeyframePair> {
    let keyframes = &state.tracks.keyframes[places];
    let gap = if state.photographs.is_some() { keyframes.len() } else { MAX_KEYFRAME_GAP };
    let indices: Vec<(usize, usize)> = (0..keyframes.len())
        .flat_map(|i| (i + 1..(i + 1 + gap).min(keyframes.len())).map(move |j| (i, j)))
        .collect();
    indices
        .par_iter()
        .filter_map(|&(i, j)| {
            let (first, second) = (keyframes[i], keyframes[j]);
            let shared = state.shared_positions(first, second);
            if shared.len() < MIN_SHARED || state.progress.is_cancelled() {
                return None;
            }
            let (rotation, rotation_residual) =
                fit_rotation(state.camera.fx, &ray_pairs(&state.camera, &shared))?;
            let motion = median_motion(&shared)?;
            Some(KeyframePair {
                first,
                second,
                shared: shared.len(),
                rotation,
                rotation_residual,
                motion,
            })
        })
        .collect()
}

/// Poses a pair and adjusts both views; returns the number of landmarks with enough parallax.
fn reconstruct_pair(state: &mut SfmState, pair: &KeyframePair, view: RelativePose) -> usize {
    state.poses[pair.first] = Some(Pose::identity());
    state.poses[pair.second] = Some(view.second_from_first.inverse());
    state.triangulate_missing();
    state.adjust(&[pair.second], false, 20);
    state.update_noise_scale();
    state.reject_outliers();
    landmarks_with_parallax(state)
}

/// True if enough landmarks have parallax to begin a map with.
pub(crate) fn has_parallax(state: &SfmState) -> bool {
    landmarks_with_parallax(state) >= MIN_LANDMARKS
}

fn landmarks_with_parallax(state: &SfmState) -> usize {
    let wide = state.landmarks.iter().flatten().filter(|landmark| {
        landmark.inverse_depth() > 0.0
            && parallax(landmark, state.poses.iter().flatten().copied()) > MIN_ANGLE
    });
    wide.count()
}

/// Median motion from the first keyframe to the last frame [px], as a camera that stands still makes
/// one keyframe; `None` if they share too few points.
fn motion_to_last_frame(state: &SfmState) -> Option<f64> {
    let last = state.poses.len().checked_sub(1)?;
    let shared = state.shared_positions(*state.tracks.keyframes.first()?, last);
    (shared.len() >= MIN_SHARED).then(|| median_motion(&shared)).flatten()
}

/// Median distance between positions of the same points [px].
fn median_motion(shared: &[([f64; 2], [f64; 2])]) -> Option<f64> {
    let length = |(a, b): &([f64; 2], [f64; 2])| (a[0] - b[0]).hypot(a[1] - b[1]);
    median(&mut shared.iter().map(length).collect::<Vec<_>>())
}

/// Reason why no pair has parallax.
fn diagnose_failure(state: &SfmState, pairs: &[KeyframePair]) -> OdometryError {
    let most = |f: fn(&KeyframePair) -> f64| pairs.iter().map(f).fold(0.0, f64::max);
    let motion = match pairs.is_empty() {
        true => motion_to_last_frame(state),
        false => Some(most(|p| p.motion)),
    };
    let Some(motion) = motion else { return OdometryError::TooFewPoints };
    if motion < MAX_STILL_MOTION * state.camera.width as f64 {
        return OdometryError::StillCamera { motion };
    }
    if pairs.is_empty() {
        return OdometryError::TooFewPoints;
    }
    OdometryError::RotationOnly { residual: most(|p| p.rotation_residual) }
}

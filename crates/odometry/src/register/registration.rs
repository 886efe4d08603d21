//! Registration of frames to the map, with local and global bundle adjustment.

use crate::depth::readings::update_depth_model;
use crate::multiview::pnp::{PnpSolution, solve_pnp};
use crate::progress::Stage;
use crate::register::photographs::register_next_photograph;
use crate::register::resection_intersection::adjust_in_turn;
use crate::sfm_state::{MAX_JOINT_POSES, MIN_INLIER_RATIO, SfmState};
use i2slam_geometry::Pose;
use rayon::prelude::*;

/// Inliers of a frame's pose, and their ratio of the landmarks that it observes: many may be a smaller
/// part, because positions in a strongly blurred picture err by several of their deviations.
const MIN_INLIERS: [(usize, f64); 2] = [(12, MIN_INLIER_RATIO), (30, 0.25)];
/// Poses that are adjusted after each new one.
const LOCAL_WINDOW: usize = 8;
/// Growth of the number of poses at which all are adjusted.
pub(crate) const GLOBAL_ADJUSTMENT_GROWTH: f64 = 1.3;
/// Frames from which on the focal length is adjusted: few views leave it undetermined.
pub(crate) const MIN_FOCAL_FRAMES: usize = 5;
/// Distance in keyframes from a registered one within which keyframes are tried first.
const NEIGHBOURHOOD: usize = 3;
/// Frames up to which all are adjusted jointly every time.
pub(crate) const MAX_JOINTLY_ADJUSTED_FRAMES: usize = 300;
const LOCAL_STEPS: usize = 6;
const GLOBAL_STEPS: usize = 20;

/// Registers all keyframes that share enough landmarks with registered ones, up to `most`.
pub(crate) fn register_keyframes(state: &mut SfmState, adjust_focal: bool, most: usize) {
    let mut adjusted_at = state.posed_frames().len();
    while state.posed_frames().len() < most && !state.progress.is_cancelled() {
        let Some(frame) = register_next_keyframe(state) else { break };
        state.triangulate_missing_in(frame);
        let count = state.posed_frames().len();
        state.progress.report(Stage::Registration, count, state.tracks.keyframes.len());
        if count as f64 >= GLOBAL_ADJUSTMENT_GROWTH * adjusted_at as f64 {
            adjusted_at = count;
            adjust_globally(state, adjust_focal && count >= MIN_FOCAL_FRAMES);
        } else {
            adjust_nearest(state, frame);
        }
    }
}

/// Adjusts the frames nearest to one; of photographs all.
pub(crate) fn adjust_nearest(state: &mut SfmState, frame: usize) {
    let near = match state.photographs.is_some() {
        true => state.adjusted_frames(),
        false => nearest_posed(&state.adjusted_frames(), frame),
    };
    state.adjust(&near, false, LOCAL_STEPS);
    state.reject_outliers_in(&near);
}

/// Adjusts all poses twice, without outliers; returns the mean cost per observation.
pub(crate) fn adjust_globally(state: &mut SfmState, adjust_focal: bool) -> f64 {
    let all = state.adjusted_frames();
    state.adjust(&all, adjust_focal, GLOBAL_STEPS);
    state.update_noise_scale();
    update_depth_model(state);
    state.reject_outliers();
    state.triangulate_missing();
    let cost = state.adjust(&all, adjust_focal, GLOBAL_STEPS);
    state.reject_outliers();
    cost
}

/// Adjusts all frames, or with depth or in a long sequence the keyframes alone, to which
/// [`adjust_remaining_frames`] adds the others at the end; returns the mean cost.
///
/// By colour alone a path bends slowly, which frames between keyframes straighten out; measured
/// depth leaves no such bends.
pub(crate) fn adjust_path(state: &mut SfmState, adjust_focal: bool) -> f64 {
    match adjusts_all(state) {
        true => adjust_globally(state, adjust_focal),
        false => adjust_keyframes(state, adjust_focal),
    }
}

/// Adjusts all frames jointly, or those of a long sequence as [`adjust_path`] does: speeds between
/// frames, on which the readout rests, need their neighbours adjusted, too.
pub(crate) fn adjust_all_frames(state: &mut SfmState, adjust_focal: bool) {
    match is_long(state) {
        true => adjust_keyframes(state, adjust_focal),
        false => adjust_globally(state, adjust_focal),
    };
}

/// Adjusts all frames where [`adjust_path`] did not: jointly, or in turn with the landmarks. The latter
/// in long sequences with depth, whose dense constraints tie frames to keyframes, and in very long ones
/// by colour alone, where bends of the keyframes stay, but a joint adjustment takes too long (not done
/// after 35 minutes for 5 000 frames).
pub(crate) fn adjust_remaining_frames(state: &mut SfmState, adjust_focal: bool) {
    let is_very_long = state.posed_frames().len() > MAX_JOINT_POSES;
    if is_very_long || (state.is_metric() && is_long(state)) {
        adjust_keyframes(state, adjust_focal);
        adjust_in_turn(state);
    } else if !adjusts_all(state) {
        adjust_globally(state, adjust_focal);
    }
}

/// Whether a path has more frames than are adjusted jointly.
fn is_long(state: &SfmState) -> bool {
    state.posed_frames().len() > MAX_JOINTLY_ADJUSTED_FRAMES
}

fn adjusts_all(state: &SfmState) -> bool {
    !state.is_metric() && !is_long(state)
}

/// Adjusts the keyframes jointly, and every frame between them to their landmarks; returns the mean
/// cost.
pub(crate) fn adjust_keyframes(state: &mut SfmState, adjust_focal: bool) -> f64 {
    let cost = state.with_keyframes_alone(|state| adjust_globally(state, adjust_focal));
    register_between(state, &(0..state.poses.len()).collect::<Vec<_>>());
    register_remaining_frames(state);
    cost
}

/// Registers those of some posed frames that are no keyframes anew, from where they are.
pub(crate) fn register_between(state: &mut SfmState, frames: &[usize]) {
    let is_keyframe = |frame: &usize| state.tracks.keyframes.binary_search(frame).is_ok();
    let between: Vec<usize> = frames.iter().copied().filter(|f| !is_keyframe(f)).collect();
    let found: Vec<_> = between.par_iter().map(|frame| refine_pose(state, *frame)).collect();
    for (frame, pose) in between.into_iter().zip(found) {
        state.poses[frame] = pose;
    }
}

/// The pose of a posed frame from its landmarks, from where it is.
pub(crate) fn refine_pose(state: &SfmState, frame: usize) -> Option<Pose<f64>> {
    let matches = state.matches(frame);
    let start = state.poses[frame].filter(|_| !state.progress.is_cancelled())?;
    let found = solve_pnp(&state.camera, start, &matches, state.noise_scale);
    found.filter(|f| has_enough_inliers(f, matches.len())).map(|f| f.world_from_camera)
}

/// Registers frames between keyframes and remaining keyframes, until none succeeds.
pub(crate) fn register_remaining_frames(state: &mut SfmState) {
    loop {
        let is_photograph = |frame: &usize| {
            state.photographs.as_ref().is_some_and(|all| all.features.contains_key(frame))
        };
        let is_left = |f: &usize| state.poses[*f].is_none() && !is_photograph(f);
        let unposed: Vec<usize> = (0..state.poses.len()).filter(is_left).collect();
        let found: Vec<Option<Pose<f64>>> = unposed
            .par_iter()
            .map(|frame| estimate_pose(state, *frame).map(|r| r.world_from_camera))
            .collect();
        if found.iter().all(Option::is_none) {
            break;
        }
        for (frame, pose) in unposed.into_iter().zip(found) {
            state.poses[frame] = pose;
        }
        state.triangulate_missing();
    }
}

/// Registers the keyframe with most landmarks: of those near registered ones, or else of all.
fn register_next_keyframe(state: &mut SfmState) -> Option<usize> {
    if state.photographs.is_some() {
        return register_next_photograph(state);
    }
    let keyframes = &state.tracks.keyframes;
    let is_near = |i: usize| {
        let around = &keyframes
            [i.saturating_sub(NEIGHBOURHOOD)..(i + NEIGHBOURHOOD + 1).min(keyframes.len())];
        around.iter().any(|f| state.poses[*f].is_some())
    };
    let (near, far): (Vec<usize>, Vec<usize>) = (0..keyframes.len())
        .filter(|i| state.poses[keyframes[*i]].is_none())
        .partition(|i| is_near(*i));
    for places in [near, far] {
        let frames: Vec<usize> = places.iter().map(|i| state.tracks.keyframes[*i]).collect();
        if let Some(frame) = register_best_of(state, &frames) {
            return Some(frame);
        }
    }
    None
}

fn register_best_of(state: &mut SfmState, frames: &[usize]) -> Option<usize> {
    let mut candidates: Vec<(usize, usize)> =
        frames.iter().map(|f| (state.matches(*f).len(), *f)).collect();
    candidates.retain(|(matches, _)| *matches >= MIN_INLIERS[0].0);
    candidates.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    for (_, frame) in candidates {
        if let Some(found) = estimate_pose(state, frame) {
            state.poses[frame] = Some(found.world_from_camera);
            return Some(frame);
        }
    }
    None
}

/// The pose of a frame from its landmarks, from several initial poses.
pub(crate) fn estimate_pose(state: &SfmState, frame: usize) -> Option<PnpSolution> {
    if state.progress.is_cancelled() {
        return None;
    }
    let matches = state.matches(frame);
    let best = initial_poses(state, frame)
        .into_iter()
        .filter_map(|start| solve_pnp(&state.camera, start, &matches, state.noise_scale))
        .max_by(|a, b| a.inliers.cmp(&b.inliers))?;
    has_enough_inliers(&best, matches.len()).then_some(best)
}

/// Whether a pose has enough inliers among so many matches.
fn has_enough_inliers(found: &PnpSolution, matches: usize) -> bool {
    MIN_INLIERS.iter().any(|(least, ratio)| {
        found.inliers >= *least && found.inliers as f64 >= ratio * matches as f64
    })
}

/// Initial poses of a frame: at constant velocity between or beyond its neighbours, and equal to
/// theirs.
pub(crate) fn initial_poses(state: &SfmState, frame: usize) -> Vec<Pose<f64>> {
    let time = |f: usize| state.timestamps.get(f).copied().unwrap_or(f as f64);
    let pose = |f: usize| state.poses[f].map(|p| (time(f), p));
    let before: Vec<_> = (0..frame).rev().filter_map(pose).take(2).collect();
    let behind: Vec<_> = (frame..state.poses.len()).filter_map(pose).take(2).collect();
    let mut initial_poses = Vec::new();
    let at = time(frame);
    let mut line = |a: (f64, Pose<f64>), b: (f64, Pose<f64>)| {
        initial_poses.push(a.1.interpolate(b.1, (at - a.0) / (b.0 - a.0)));
    };
    match (before.as_slice(), behind.as_slice()) {
        ([a, ..], [b, ..]) => line(*a, *b),
        ([b, a], []) | ([], [b, a]) => line(*a, *b),
        _ => {}
    }
    initial_poses.extend(before.first().map(|b| b.1));
    initial_poses.extend(behind.first().map(|b| b.1));
    initial_poses
}

/// The registered frames nearest to one in order.
fn nearest_posed(posed: &[usize], frame: usize) -> Vec<usize> {
    let mut near = posed.to_vec();
    near.sort_by_key(|f| f.abs_diff(frame));
    near.truncate(LOCAL_WINDOW.min(posed.len().saturating_sub(1)).max(1));
    near
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{self, camera};
    use crate::track::tracks::Tracks;
    use i2slam_geometry::{Rotation, Vec3};
    use std::sync::Arc;

    /// Constant velocity in time, whether frames are missing or come late.
    #[test]
    fn a_frame_starts_where_constant_velocity_takes_it() {
        let stamps = [0.0, 0.1, 0.2, 0.5, 0.6, 0.7];
        let pose = |time: f64| {
            Pose::new(Rotation::exp(Vec3::new(0.0, 0.4 * time, 0.0)), Vec3::new(time, 0.0, 0.0))
        };
        let mut state = SfmState::new(camera(), Tracks { frames: 6, ..Tracks::default() });
        state.timestamps = Arc::new(stamps.to_vec());
        for frame in [1, 3] {
            state.poses[frame] = Some(pose(stamps[frame]));
        }
        for frame in [2, 4, 5] {
            let [first, ..] = initial_poses(&state, frame)[..] else { panic!("a start") };
            let off = first.local(pose(stamps[frame]));
            // Place and turn are each linear in time.
            assert!(off.rotation.norm() < 1e-9, "{frame}: {off:?}");
            assert!((first.translation.x - stamps[frame]).abs() < 1e-3, "{frame}: {first:?}");
        }
    }

    /// Positions in a strongly blurred picture err by several deviations, those of another scene by any amount.
    #[test]
    fn a_frame_is_posed_by_a_third_of_many_landmarks_but_not_by_chance() {
        const BLURRED: usize = 6;
        let pose = |frame: usize| {
            Pose::new(Rotation::identity(), Vec3::new(0.05 * frame as f64, 0.0, 0.0))
        };
        for (error, is_posed) in [(4.0, true), (60.0, false)] {
            let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
                let (u, v) = camera().project(pose(frame).inverse() * point);
                let error = if frame == BLURRED { error } else { 0.3 };
                Some([u + error * n[0], v + error * n[1]])
            };
            let mut state = fixtures::state((10, 60, 2), [150.0, 110.0], pose, observe);
            let all = state.posed_frames();
            state.adjust(&all, false, 10);
            assert!(!state.agrees_with_landmarks(BLURRED));
            state.poses[BLURRED] = None;
            let found = estimate_pose(&state, BLURRED).map(|found| found.world_from_camera);
            assert_eq!(found.is_some(), is_posed, "{error}");
            let off = found.map_or(0.0, |found| found.local(pose(BLURRED)).translation.norm());
            assert!(off < 0.02, "{off}");
        }
    }
}

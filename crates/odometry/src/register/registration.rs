//! From two poses to all of them.

use crate::multiview::pnp::{Resected, resect};
use crate::progress::Stage;
use crate::sfm_state::Scene;
use i2slam_geometry::Pose;
use rayon::prelude::*;

/// Landmarks that must agree on a frame's pose, and their share of those that it shows.
const MIN_AGREEING: usize = 12;
const MIN_SHARE: f64 = 0.5;
/// Poses that are adjusted after each new one.
const WINDOW: usize = 8;
/// All poses are adjusted whenever there are so many times as many.
const GROWTH: f64 = 1.3;
/// Keyframes this near in order to a posed one are tried first.
const NEAR: usize = 3;
/// Of more frames than this, those between keyframes are adjusted one by one.
const ADJUSTED_TOGETHER: usize = 300;
const LOCAL_STEPS: usize = 6;
const GLOBAL_STEPS: usize = 20;

/// Poses all keyframes that can be reached from those that have a pose, up to `most`.
pub(crate) fn grow(scene: &mut Scene, adjust_focal: bool, most: usize) {
    let mut adjusted_at = scene.posed().len();
    while scene.posed().len() < most && !scene.progress.is_cancelled() {
        let Some(frame) = pose_next(scene) else { break };
        scene.add_landmarks_in(frame);
        let count = scene.posed().len();
        scene.progress.report(Stage::Registration, count, scene.tracks.keyframes.len());
        if count as f64 >= GROWTH * adjusted_at as f64 {
            adjusted_at = count;
            adjust_all(scene, adjust_focal && count > 4);
        } else {
            let near = nearest(&scene.posed(), frame);
            scene.adjust(&near, false, LOCAL_STEPS);
            scene.mark_wrong_sights_in(&near);
        }
    }
}

/// Adjusts everything, drops what is wrong, looks for landmarks again, and adjusts once more.
pub(crate) fn adjust_all(scene: &mut Scene, adjust_focal: bool) -> f64 {
    let all = scene.posed();
    scene.adjust(&all, adjust_focal, GLOBAL_STEPS);
    scene.measure_noise();
    scene.mark_wrong_sights();
    scene.add_landmarks();
    let cost = scene.adjust(&all, adjust_focal, GLOBAL_STEPS);
    scene.mark_wrong_sights();
    cost
}

/// Adjusts all frames; of a long sequence the keyframes, and then every other frame alone. Returns
/// the cost per sight.
pub(crate) fn refine(scene: &mut Scene, adjust_focal: bool) -> f64 {
    let posed = scene.posed();
    if posed.len() <= ADJUSTED_TOGETHER {
        return adjust_all(scene, adjust_focal);
    }
    let mut is_keyframe = vec![false; scene.poses.len()];
    scene.tracks.keyframes.iter().for_each(|f| is_keyframe[*f] = true);
    let between: Vec<usize> = posed.into_iter().filter(|f| !is_keyframe[*f]).collect();
    let before: Vec<Option<Pose<f64>>> = between.iter().map(|f| scene.poses[*f].take()).collect();
    let cost = adjust_all(scene, adjust_focal);
    let again = |(frame, pose): (&usize, &Option<Pose<f64>>)| {
        let matches = scene.matches(*frame);
        let pose = pose.filter(|_| !scene.progress.is_cancelled());
        let found = pose.and_then(|start| resect(&scene.camera, start, &matches, scene.noise));
        found.filter(|f| is_enough(f, matches.len())).map(|f| f.world_from_camera)
    };
    let found: Vec<_> = between.par_iter().zip(&before).map(again).collect();
    for (frame, pose) in between.into_iter().zip(found) {
        scene.poses[frame] = pose;
    }
    pose_rest(scene);
    cost
}

/// Finds poses of the frames between keyframes and, again, of keyframes that were not reached,
/// as long as there are more.
pub(crate) fn pose_rest(scene: &mut Scene) {
    loop {
        let unposed: Vec<usize> =
            (0..scene.poses.len()).filter(|f| scene.poses[*f].is_none()).collect();
        let found: Vec<Option<Pose<f64>>> = unposed
            .par_iter()
            .map(|frame| try_frame(scene, *frame).map(|r| r.world_from_camera))
            .collect();
        if found.iter().all(Option::is_none) {
            break;
        }
        for (frame, pose) in unposed.into_iter().zip(found) {
            scene.poses[frame] = pose;
        }
        scene.add_landmarks();
    }
}

/// Poses the keyframe that shows most landmarks and can be posed: of those near posed ones in
/// order, or else of all.
fn pose_next(scene: &mut Scene) -> Option<usize> {
    let keyframes = &scene.tracks.keyframes;
    let is_near = |i: usize| {
        let around = &keyframes[i.saturating_sub(NEAR)..(i + NEAR + 1).min(keyframes.len())];
        around.iter().any(|f| scene.poses[*f].is_some())
    };
    let (near, far): (Vec<usize>, Vec<usize>) = (0..keyframes.len())
        .filter(|i| scene.poses[keyframes[*i]].is_none())
        .partition(|i| is_near(*i));
    for places in [near, far] {
        let frames: Vec<usize> = places.iter().map(|i| scene.tracks.keyframes[*i]).collect();
        if let Some(frame) = pose_one_of(scene, &frames) {
            return Some(frame);
        }
    }
    None
}

fn pose_one_of(scene: &mut Scene, frames: &[usize]) -> Option<usize> {
    let mut candidates: Vec<(usize, usize)> =
        frames.iter().map(|f| (scene.matches(*f).len(), *f)).collect();
    candidates.retain(|(matches, _)| *matches >= MIN_AGREEING);
    candidates.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(&b.1)));
    for (_, frame) in candidates {
        if let Some(found) = try_frame(scene, frame) {
            scene.poses[frame] = Some(found.world_from_camera);
            return Some(frame);
        }
    }
    None
}

/// The pose of a frame from its landmarks, from several starts.
fn try_frame(scene: &Scene, frame: usize) -> Option<Resected> {
    if scene.progress.is_cancelled() {
        return None;
    }
    let matches = scene.matches(frame);
    let best = starts(scene, frame)
        .into_iter()
        .filter_map(|start| resect(&scene.camera, start, &matches, scene.noise))
        .max_by(|a, b| a.agreeing.cmp(&b.agreeing))?;
    is_enough(&best, matches.len()).then_some(best)
}

/// Whether a pose that so many landmarks were tried for can be trusted.
fn is_enough(found: &Resected, matches: usize) -> bool {
    found.agreeing >= MIN_AGREEING && found.agreeing as f64 >= MIN_SHARE * matches as f64
}

/// Where a frame may be: as its neighbours in time say, and where they are.
fn starts(scene: &Scene, frame: usize) -> Vec<Pose<f64>> {
    let pose = |f: usize| scene.poses[f].map(|p| (f as f64, p));
    let before: Vec<_> = (0..frame).rev().filter_map(pose).take(2).collect();
    let behind: Vec<_> = (frame..scene.poses.len()).filter_map(pose).take(2).collect();
    let mut starts = Vec::new();
    let at = frame as f64;
    let mut line = |a: (f64, Pose<f64>), b: (f64, Pose<f64>)| {
        starts.push(a.1.interpolate(b.1, (at - a.0) / (b.0 - a.0)));
    };
    match (before.as_slice(), behind.as_slice()) {
        ([a, ..], [b, ..]) => line(*a, *b),
        ([b, a], []) | ([], [b, a]) => line(*a, *b),
        _ => {}
    }
    starts.extend(before.first().map(|b| b.1));
    starts.extend(behind.first().map(|b| b.1));
    starts
}

/// The posed frames nearest to one in order.
fn nearest(posed: &[usize], frame: usize) -> Vec<usize> {
    let mut near = posed.to_vec();
    near.sort_by_key(|f| f.abs_diff(frame));
    near.truncate(WINDOW.min(posed.len().saturating_sub(1)).max(1));
    near
}

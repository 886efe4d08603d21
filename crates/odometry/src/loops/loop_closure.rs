//! Places that are seen again after their points were lost.
//!
//! Keyframes that look alike and share no points are compared as in `recognise`. Where two
//! neighbours agree on how the world must be moved, keyframes are moved so (`pose_graph`), and the
//! old points get the new sights, so that bundle adjustment keeps the place together.

use crate::loops::pose_graph::{Edge, optimise};
use crate::multiview::landmark::Landmark;
use crate::progress::Stage;
use crate::register::registration::refine;
use crate::relocalize::geometric_verification::{Recognised, look_again, recognise};
use crate::relocalize::relocalization::most_alike;
use crate::sfm_state::Scene;
use crate::track::thumbnail::Look;

use crate::track::tracks::Observation;
use i2slam_compute::median;
use i2slam_geometry::{Pose, Similarity};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Keyframes nearer than this in order are no return.
const APART: usize = 8;
/// Keyframes that share so many points need no help.
const MAX_SHARED: usize = 15;
/// Keyframes so near in order must agree on a return.
const NEIGHBOURS: usize = 4;
/// How far they may disagree: turn [rad], distance over that of the scene, logarithm of scale.
const DISAGREEMENT: [f64; 3] = [0.06, 0.12, 0.15];
/// Keyframes are joined with so many others at most, of which so many of some landmarks lie in the
/// picture, and which look no farther aside [rad].
const JOINED: usize = 3;
const OVERLAP_SAMPLE: usize = 24;
const MIN_OVERLAP: usize = 12;
const MAX_APART: f64 = 0.7;
/// The most that a path may drift: share of the way, or of the scene's distance if that is more;
/// turn [rad]; logarithm of scale.
const MAX_DRIFT: f64 = 0.25;
const NEAR: f64 = 0.3;
const MAX_TURN: f64 = 0.6;
const MAX_SCALE: f64 = 0.8;
/// Keyframes so near in order keep their places to each other if they share so many points.
const CHAINED: usize = 3;
const MIN_CHAINED: usize = 8;
/// What a return counts, when neighbours in order count 1.
const WEIGHT: f64 = 20.0;

/// A keyframe that shows what an old one does.
struct Return {
    /// Places among the keyframes.
    new: usize,
    old: usize,
    found: Recognised,
    /// Where the new one is in the world of the old one.
    place: Similarity<f64>,
}

/// Looks for places that are seen again, and closes the path there. Returns at how many
/// keyframes.
pub(crate) fn close_loops(scene: &mut Scene, adjust_focal: bool) -> usize {
    scene.progress.report(Stage::LoopClosure, 0, 0);
    let unit = distance(scene);
    let likely = returns(scene).into_iter().filter(|r| is_likely(scene, r, unit)).collect();
    let returns = agreed(scene, likely, unit);
    if returns.is_empty() {
        return 0;
    }
    straighten_out(scene, &returns, unit);
    let count = returns.len();
    returns.into_iter().for_each(|r| scene.add_sights(r.found.sights));
    refine(scene, adjust_focal);
    join_neighbours(scene, adjust_focal);
    count
}

/// Gives keyframes that see one place at different times the points of each other, by the poses
/// that are known.
pub(crate) fn join_neighbours(scene: &mut Scene, adjust_focal: bool) {
    let look_around = |(new, look): (usize, &Look)| {
        if scene.progress.is_cancelled() {
            return Vec::new();
        }
        let mut near: Vec<(usize, &Look)> = (scene.tracks.looks.iter().enumerate())
            .filter(|(old, _)| old.abs_diff(new) > 1)
            .map(|(_, other)| (overlap(scene, look, other), other))
            .filter(|(overlap, other)| {
                *overlap >= MIN_OVERLAP && scene.shared_count(look.frame, other.frame) < MAX_SHARED
            })
            .collect();
        near.sort_by_key(|(overlap, other)| (OVERLAP_SAMPLE - overlap, other.frame));
        near.truncate(JOINED);
        near.iter().filter_map(|(_, old)| look_again(scene, look, old)).flatten().collect()
    };
    let looks = scene.tracks.looks.par_iter().enumerate();
    let sights: Vec<Vec<(usize, Observation)>> = looks.map(look_around).collect();
    if sights.iter().any(|s| !s.is_empty()) {
        sights.into_iter().for_each(|s| scene.add_sights(s));
        refine(scene, adjust_focal);
    }
}

/// How many of some landmarks of another keyframe lie in the picture of this one.
fn overlap(scene: &Scene, look: &Look, other: &Look) -> usize {
    let (Some(pose), Some(there)) = (scene.poses[look.frame], scene.poses[other.frame]) else {
        return 0;
    };
    if pose.local(there).rotation.norm() > MAX_APART {
        return 0;
    }
    let known = |track: &usize| scene.landmarks[*track].as_ref();
    let shown = scene.shown_tracks(other.frame);
    let some = shown.iter().step_by((shown.len() / OVERLAP_SAMPLE).max(1));
    let inside = |l: &&Landmark| {
        let at = l.image_position(&scene.camera, &pose);
        at.is_some_and(|at| scene.camera.contains(at[0], at[1], 0.0))
    };
    some.take(OVERLAP_SAMPLE).filter_map(known).filter(inside).count()
}

/// Median distance of landmarks from where they were first seen.
fn distance(scene: &Scene) -> f64 {
    let near = |l: &Landmark| (l.values[2] > 1e-6).then(|| l.values[2].recip());
    median(&mut scene.landmarks.iter().flatten().filter_map(near).collect::<Vec<_>>())
        .unwrap_or(1.0)
}

/// Keyframes that show what a much earlier one does.
fn returns(scene: &Scene) -> Vec<Return> {
    let search = |(new, look): (usize, &Look)| {
        scene.poses[look.frame].filter(|_| !scene.progress.is_cancelled())?;
        let may = |old: usize, other: &Look| {
            old + APART <= new
                && scene.poses[other.frame].is_some()
                && scene.shared_count(look.frame, other.frame) < MAX_SHARED
        };
        let of = |other: &&Look| {
            let found = recognise(scene, look, other)?;
            let old = scene.tracks.looks.binary_search_by_key(&other.frame, |l| l.frame).ok()?;
            let place = Similarity::from_pose(found.world_from_camera, found.scale?);
            Some(Return { new, old, found, place })
        };
        most_alike(scene, look, may).iter().find_map(of)
    };
    scene.tracks.looks.par_iter().enumerate().filter_map(search).collect()
}

/// Whether a path may drift as far as a return says: whole ways between places that only look
/// alike do not vanish.
fn is_likely(scene: &Scene, r: &Return, unit: f64) -> bool {
    let between = &scene.tracks.looks[r.old..=r.new];
    let places: Vec<Pose<f64>> = between.iter().filter_map(|l| scene.poses[l.frame]).collect();
    let step = |p: &[Pose<f64>]| (p[1].translation - p[0].translation).norm();
    let way: f64 = places.windows(2).map(step).sum();
    let Some(own) = places.last() else { return false };
    let off = (r.place.translation - own.translation).norm();
    let turn = own.local(r.place.pose()).rotation.norm();
    off < (NEAR * unit).max(MAX_DRIFT * way)
        && turn < MAX_TURN
        && r.place.scale.ln().abs() < MAX_SCALE
}

/// Those that a neighbour in order agrees with.
fn agreed(scene: &Scene, returns: Vec<Return>, unit: f64) -> Vec<Return> {
    let pose = |r: &Return| scene.poses[scene.tracks.looks[r.new].frame];
    // Where a return moves the camera of another one.
    let moved = |r: &Return, other: &Return| {
        let (own, there) =
            (Similarity::from_pose(pose(r)?, 1.0), Similarity::from_pose(pose(other)?, 1.0));
        Some(r.place.compose(&own.inverse()).compose(&there))
    };
    let agree = |r: &Return, other: &Return| {
        let Some(moved) = moved(r, other) else { return false };
        let [x, y, z, a, b, c, s] = other.place.inverse().compose(&moved).coordinates();
        let off = [a.hypot(b).hypot(c), x.hypot(y).hypot(z) / unit, s.abs()];
        off.iter().zip(DISAGREEMENT).all(|(off, most)| *off < most)
    };
    let has_company = |r: &Return| {
        let near = |o: &&Return| o.new != r.new && o.new.abs_diff(r.new) <= NEIGHBOURS;
        returns.iter().filter(near).any(|o| agree(r, o))
    };
    let keep: Vec<bool> = returns.iter().map(has_company).collect();
    returns.into_iter().zip(keep).filter_map(|(r, keep)| keep.then_some(r)).collect()
}

/// Moves keyframes, and with them the frames behind each and the landmarks first seen there, so
/// that the path closes.
fn straighten_out(scene: &mut Scene, returns: &[Return], unit: f64) {
    let looks = &scene.tracks.looks;
    let posed: Vec<usize> =
        (0..looks.len()).filter(|k| scene.poses[looks[*k].frame].is_some()).collect();
    let mut place = vec![None; looks.len()];
    posed.iter().enumerate().for_each(|(i, k)| place[*k] = Some(i));
    let frames: Vec<usize> = posed.iter().map(|k| looks[*k].frame).collect();
    let before: Vec<Similarity<f64>> = frames
        .iter()
        .filter_map(|f| scene.poses[*f].map(|pose| Similarity::from_pose(pose, 1.0)))
        .collect();
    let tied = chained(scene, &frames).into_iter().chain(recognised(scene, &frames));
    let mut edges: Vec<Edge> = tied
        .map(|(first, second)| {
            let measured = before[first].inverse().compose(&before[second]);
            Edge { first, second, measured, weight: 1.0 }
        })
        .collect();
    for r in returns {
        let (Some(first), Some(second)) = (place[r.old], place[r.new]) else { continue };
        let measured = before[first].inverse().compose(&r.place);
        edges.push(Edge { first, second, measured, weight: WEIGHT });
    }
    let mut after = before.clone();
    optimise(&mut after, &edges, unit);
    let moves: Vec<Similarity<f64>> =
        after.iter().zip(&before).map(|(after, before)| after.compose(&before.inverse())).collect();
    apply(scene, &frames, &moves);
}

/// Pairs of keyframes, by their places among `frames`, that are near in order and share points.
fn chained(scene: &Scene, frames: &[usize]) -> Vec<(usize, usize)> {
    let before = |second: usize| (second.saturating_sub(CHAINED)..second).map(move |f| (f, second));
    let share = |(first, second): &(usize, usize)| {
        scene.shared_count(frames[*first], frames[*second]) >= MIN_CHAINED
    };
    (0..frames.len()).flat_map(before).filter(share).collect()
}

/// Pairs of keyframes that share points which were not followed from one to the other, but
/// recognised: a place that was found again already stays one place.
fn recognised(scene: &Scene, frames: &[usize]) -> Vec<(usize, usize)> {
    let mut place = vec![None; scene.poses.len()];
    frames.iter().enumerate().for_each(|(i, f)| place[*f] = Some(i));
    let mut counts: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (track, _) in scene.tracks.tracks.iter().zip(&scene.landmarks).filter(|(_, l)| l.is_some())
    {
        let right = track.observations.iter().filter(|o| !o.is_wrong);
        let places: Vec<usize> = right.filter_map(|o| place[o.frame]).collect();
        let parts: Vec<&[usize]> = places.chunk_by(|a, b| b - a <= CHAINED).collect();
        for (i, later) in parts.iter().enumerate() {
            let earlier = parts[..i].iter().copied().flatten();
            let pairs = earlier.flat_map(|first| later.iter().map(|second| (*first, *second)));
            pairs.for_each(|pair| *counts.entry(pair).or_default() += 1);
        }
    }
    counts.into_iter().filter(|(_, count)| *count >= MIN_CHAINED).map(|(pair, _)| pair).collect()
}

/// Moves every frame, and every landmark, as the keyframe at or before it.
fn apply(scene: &mut Scene, keyframes: &[usize], moves: &[Similarity<f64>]) {
    let by = |frame: usize| {
        let place = keyframes.partition_point(|k| *k <= frame).saturating_sub(1);
        moves.get(place)
    };
    for (landmark, track) in scene.landmarks.iter_mut().zip(&scene.tracks.tracks) {
        let posed = track.observations.iter().find(|o| scene.poses[o.frame].is_some());
        let by = posed.and_then(|o| by(o.frame));
        if let (Some(known), Some(by)) = (&mut *landmark, by) {
            *known = known.moved(by);
        }
    }
    for (frame, pose) in scene.poses.iter_mut().enumerate() {
        if let (Some(known), Some(by)) = (&mut *pose, by(frame)) {
            *known = by.apply_to_pose(*known);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::track::tracks::{Track, Tracks};
    use i2slam_geometry::{Camera, Rotation, Vec3};

    /// Keyframes of the first way, which ends where the lens is covered; all are of the second one.
    const CUT: usize = 20;
    const KEYFRAMES: usize = 40;
    /// The old keyframe that the first one after the cut was recognised at.
    const RECOGNISED: usize = 8;

    /// A track of every three keyframes in a row, ten times, none across the cut; ten of
    /// [`RECOGNISED`] are seen again in the first keyframe after it.
    fn two_ways() -> Scene {
        let camera = Camera { width: 320, height: 240, fx: 250.0, fy: 250.0, cx: 160.0, cy: 120.0 };
        let at = |index: usize, k: usize| [20.0 + 30.0 * k as f64, 20.0 + 4.0 * index as f64];
        let sight = |index: usize, k: usize| Observation::new(index, at(index, k), 0.3);
        let mut tracks = Vec::new();
        for begin in (0..KEYFRAMES - 2).filter(|b| b + 2 < CUT || *b >= CUT) {
            for k in 0..10 {
                let mut observations: Vec<_> = (begin..begin + 3).map(|f| sight(f, k)).collect();
                if begin == RECOGNISED {
                    observations.push(sight(CUT, k));
                }
                tracks.push(Track { observations });
            }
        }
        let looks = (0..KEYFRAMES).map(|f| {
            let blank = i2slam_geometry::Image::new(48, 48, 1);
            Look::new(&crate::track::pyramid::Pyramid::new(&blank), f)
        });
        let looks = std::sync::Arc::new(looks.collect());
        let keyframes = (0..KEYFRAMES).collect();
        let mut scene = Scene::new(camera, Tracks { tracks, keyframes, looks, frames: KEYFRAMES });
        let place = |f: usize| {
            let x = if f < CUT { f } else { f - CUT + RECOGNISED };
            Some(Pose::new(Rotation::identity(), Vec3::new(0.1 * x as f64, 0.0, 0.0)))
        };
        scene.poses = (0..KEYFRAMES).map(place).collect();
        let first = |t: &Track| {
            let o = t.observations[0];
            Some(Landmark::on_ray(&camera, place(o.frame)?, o.at, 0.5))
        };
        scene.landmarks = scene.tracks.tracks.iter().map(first).collect();
        scene
    }

    /// The end of the second way is found at the end of the first, 0.4 aside: all keyframes share
    /// the drift, and the one that was recognised stays at its place.
    #[test]
    fn a_place_that_was_recognised_is_not_torn_by_a_closed_loop() {
        let mut scene = two_ways();
        let gap = |scene: &Scene| {
            let at = |f: usize| scene.poses[f].expect("posed").translation;
            (at(CUT) - at(RECOGNISED)).norm()
        };
        let end = Pose::new(Rotation::identity(), Vec3::new(1.9, 0.4, 0.0));
        let found = Recognised { world_from_camera: end, scale: Some(1.0), sights: Vec::new() };
        let place = Similarity::from_pose(end, 1.0);
        let back = Return { new: CUT + 11, old: CUT - 1, found, place };
        straighten_out(&mut scene, &[back], 2.0);
        assert!(gap(&scene) < 0.1, "{}", gap(&scene));
    }
}

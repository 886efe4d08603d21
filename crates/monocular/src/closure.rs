//! Places that are seen again after their points were lost.
//!
//! Keyframes that look alike and share no points are compared as in `recognise`. Where two
//! neighbours agree on how the world must be moved, keyframes are moved so (`pose_graph`), and the
//! old points get the new sights, so that bundle adjustment keeps the place together.

use crate::grow::refine;
use crate::landmark::Landmark;
use crate::look::Look;
use crate::pose_graph::{Edge, optimise};
use crate::recognise::{Recognised, recognise};
use crate::relocalise::most_alike;
use crate::scene::Scene;
use crate::similarity::Similarity;
use i2slam_compute::median;
use rayon::prelude::*;

/// Keyframes nearer than this in order are no return.
const APART: usize = 8;
/// Keyframes that share so many points need no help.
const MOST_SHARED: usize = 15;
/// Keyframes so near in order must agree on a return.
const NEIGHBOURS: usize = 4;
/// How far they may disagree: turn [rad], distance over that of the scene, logarithm of scale.
const DISAGREEMENT: [f64; 3] = [0.06, 0.12, 0.15];
/// Keyframes so near in order keep their places to each other if they share so many points.
const CHAINED: usize = 3;
const LEAST_CHAINED: usize = 8;
/// What a return counts, when neighbours in order count 1.
const WEIGHT: f64 = 20.0;

/// A keyframe that shows what an old one does.
struct Return {
    /// Places among the keyframes.
    new: usize,
    old: usize,
    found: Recognised,
    /// Where the new one is in the world of the old one.
    place: Similarity,
}

/// Looks for places that are seen again, and closes the path there. Returns at how many
/// keyframes.
pub(crate) fn close_loops(scene: &mut Scene, adjust_focal: bool) -> usize {
    let unit = distance(scene);
    let returns = agreed(scene, returns(scene), unit);
    if returns.is_empty() {
        return 0;
    }
    straighten_out(scene, &returns, unit);
    let count = returns.len();
    returns.into_iter().for_each(|r| scene.add_sights(r.found.sights));
    refine(scene, adjust_focal);
    count
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
        let own = scene.poses[look.frame]?;
        let may = |old: usize, other: &Look| {
            old + APART <= new
                && scene.poses[other.frame].is_some()
                && scene.shared_count(look.frame, other.frame) < MOST_SHARED
        };
        let of = |other: &&Look| {
            let found = recognise(scene, look, other)?;
            let old = scene.tracks.looks.binary_search_by_key(&other.frame, |l| l.frame).ok()?;
            let place = Similarity::of(found.world_from_camera, found.scale?);
            Some(Return { new, old, found, place })
        };
        debug_assert!(own.is_finite());
        most_alike(scene, look, may).iter().find_map(of)
    };
    scene.tracks.looks.par_iter().enumerate().filter_map(search).collect()
}

/// Those that a neighbour in order agrees with.
fn agreed(scene: &Scene, returns: Vec<Return>, unit: f64) -> Vec<Return> {
    let pose = |r: &Return| scene.poses[scene.tracks.looks[r.new].frame];
    // Where a return moves the camera of another one.
    let moved = |r: &Return, other: &Return| {
        let (own, there) = (Similarity::of(pose(r)?, 1.0), Similarity::of(pose(other)?, 1.0));
        Some(r.place.after(&own.inverse()).after(&there))
    };
    let agree = |r: &Return, other: &Return| {
        let Some(moved) = moved(r, other) else { return false };
        let [x, y, z, a, b, c, s] = other.place.inverse().after(&moved).chart();
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
    let looks = scene.tracks.looks.clone();
    let posed: Vec<usize> =
        (0..looks.len()).filter(|k| scene.poses[looks[*k].frame].is_some()).collect();
    let mut place = vec![None; looks.len()];
    posed.iter().enumerate().for_each(|(i, k)| place[*k] = Some(i));
    let frames: Vec<usize> = posed.iter().map(|k| looks[*k].frame).collect();
    let before: Vec<Similarity> = frames
        .iter()
        .filter_map(|f| scene.poses[*f].map(|pose| Similarity::of(pose, 1.0)))
        .collect();
    let mut edges = Vec::new();
    for second in 0..frames.len() {
        for first in second.saturating_sub(CHAINED)..second {
            if scene.shared_count(frames[first], frames[second]) >= LEAST_CHAINED {
                let measured = before[first].inverse().after(&before[second]);
                edges.push(Edge { first, second, measured, weight: 1.0 });
            }
        }
    }
    for r in returns {
        let (Some(first), Some(second)) = (place[r.old], place[r.new]) else { continue };
        let measured = before[first].inverse().after(&r.place);
        edges.push(Edge { first, second, measured, weight: WEIGHT });
    }
    let mut after = before.clone();
    optimise(&mut after, &edges, unit);
    let moves: Vec<Similarity> =
        after.iter().zip(&before).map(|(after, before)| after.after(&before.inverse())).collect();
    apply(scene, &frames, &moves);
}

/// Moves every frame, and every landmark, as the keyframe at or before it.
fn apply(scene: &mut Scene, keyframes: &[usize], moves: &[Similarity]) {
    let by = |frame: usize| {
        let place = keyframes.partition_point(|k| *k <= frame).saturating_sub(1);
        moves.get(place)
    };
    for (landmark, track) in scene.landmarks.iter_mut().zip(&scene.tracks.tracks) {
        let posed = track.observations.iter().find(|o| scene.poses[o.frame].is_some());
        if let (Some(known), Some(o)) = (&mut *landmark, posed) {
            if let Some(by) = by(o.frame) {
                *known = known.moved(by);
            }
        }
    }
    for (frame, pose) in scene.poses.iter_mut().enumerate() {
        if let (Some(known), Some(by)) = (&mut *pose, by(frame)) {
            *known = by.after(&Similarity::of(*known, 1.0)).pose();
        }
    }
}

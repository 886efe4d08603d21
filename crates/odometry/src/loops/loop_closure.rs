//! Loop closure.
//!
//! Keyframes with similar thumbnails that share no points are verified geometrically. Where two
//! neighbouring candidates agree on the drift, a pose graph distributes it, and the old tracks get
//! the new observations, so that bundle adjustment keeps the loop closed.

use crate::loops::pose_graph::{GraphLengths, PoseGraphEdge, optimize_pose_graph};
use crate::multiview::landmark::Landmark;
use crate::progress::Stage;
use crate::register::registration::adjust_path;
use crate::relocalize::geometric_verification::{
    Relocalization, match_and_verify, verify_known_pose,
};
use crate::relocalize::relocalization::candidate_keyframes;
use crate::relocalize::view_overlap::{MIN_VISIBLE_LANDMARKS, SAMPLED_LANDMARKS, view_overlap};
use crate::sfm_state::SfmState;
use crate::track::thumbnail::KeyframeImage;
use crate::track::tracks::{Observation, Track};
use i2slam_compute::median;
use i2slam_geometry::{Pose, Similarity};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Distance in keyframes of a loop.
const MIN_LOOP_GAP: usize = 8;
/// Shared points from which on two keyframes are connected already.
const MAX_SHARED_POINTS: usize = 15;
/// Distance in keyframes within which another candidate must agree.
const CONSISTENCY_WINDOW: usize = 4;
/// Largest disagreement: rotation [rad], translation over the scene's distance, logarithm of scale.
const MAX_DISAGREEMENT: [f64; 3] = [0.06, 0.12, 0.15];
/// Keyframes that one is merged with, at most.
const MAX_MERGED_KEYFRAMES: usize = 3;
/// Largest plausible drift: translation as a ratio of the path's length, or of the scene's distance
/// if that is more; rotation [rad]; logarithm of scale.
const MAX_TRANSLATION_DRIFT: f64 = 0.25;
const MIN_TRANSLATION_BOUND: f64 = 0.3;
const MAX_ROTATION_DRIFT: f64 = 0.6;
const MAX_LOG_SCALE_DRIFT: f64 = 0.8;
/// Distance in keyframes of sequential edges, and points that the two must share.
const SEQUENTIAL_EDGE_SPAN: usize = 3;
const MIN_EDGE_POINTS: usize = 8;
/// Weight of a loop's edge, where that of a sequential one is 1.
const LOOP_EDGE_WEIGHT: f64 = 20.0;

/// A keyframe that observes the place of a much older one.
struct LoopCandidate {
    /// Indices among the keyframes.
    new: usize,
    old: usize,
    found: Relocalization,
    /// Pose of the new one in the world of the old one.
    place: Similarity<f64>,
}

/// Finds loops, distributes the drift and adjusts all frames.
pub(crate) fn close_loops(state: &mut SfmState, adjust_focal: bool) {
    state.progress.report(Stage::LoopClosure, 0, 0);
    let candidates = find_loop_candidates(state, 0);
    let joining = distribute_drift_of(state, candidates, &BTreeMap::new());
    if !joining.is_empty() {
        state.add_observations(joining);
        adjust_path(state, adjust_focal);
        merge_overlapping_keyframes(state, adjust_focal);
    }
}

/// Looks for a loop that the last keyframe closes, and distributes the drift; frames move with the
/// keyframe that they follow. Returns the observations that join the places, after which the keyframes
/// are to be adjusted; none if there is no loop.
pub(crate) fn close_last_loop(
    state: &mut SfmState,
    followers: &BTreeMap<usize, Vec<usize>>,
) -> Vec<(usize, Observation)> {
    let Some(image) = state.tracks.keyframe_images.last() else { return Vec::new() };
    let last = state.tracks.keyframe_images.len() - 1;
    if is_joined(state, image) || find_loop_candidates(state, last).is_empty() {
        return Vec::new();
    }
    let candidates = find_loop_candidates(state, last.saturating_sub(CONSISTENCY_WINDOW));
    distribute_drift_of(state, candidates, followers)
}

/// Whether a keyframe shares enough points with much older ones that were out of view in between.
fn is_joined(state: &SfmState, image: &KeyframeImage) -> bool {
    let keyframes_until = |frame: usize| state.tracks.keyframes.partition_point(|k| *k < frame);
    let returns = |track: &&Track| {
        let right = track.observations.iter().filter(|o| !o.is_outlier);
        let places: Vec<usize> = right.map(|o| keyframes_until(o.frame)).collect();
        places.windows(2).any(|pair| pair[1] - pair[0] >= MIN_LOOP_GAP)
    };
    let tracks = state.by_frame[image.frame].iter().map(|i| &state.tracks.tracks[*i]);
    tracks.filter(returns).count() >= MAX_SHARED_POINTS
}

/// Distributes the drift over the path by those candidates that agree; returns their observations.
fn distribute_drift_of(
    state: &mut SfmState,
    mut candidates: Vec<LoopCandidate>,
    followers: &BTreeMap<usize, Vec<usize>>,
) -> Vec<(usize, Observation)> {
    let unit = median_landmark_distance(state);
    candidates.retain(|r| is_plausible_drift(state, r, unit));
    let candidates = consistent_candidates(state, candidates, unit);
    if !candidates.is_empty() {
        distribute_drift(state, &candidates, followers, unit);
    }
    candidates.into_iter().flat_map(|r| r.found.observations).collect()
}

/// Merges the tracks of keyframes that overlap by their poses, and adjusts all frames.
pub(crate) fn merge_overlapping_keyframes(state: &mut SfmState, adjust_focal: bool) {
    let find_overlaps = |(new, image): (usize, &Arc<KeyframeImage>)| {
        if state.progress.is_cancelled() {
            return Vec::new();
        }
        let mut near: Vec<(usize, &Arc<KeyframeImage>)> =
            (state.tracks.keyframe_images.iter().enumerate())
                .filter(|(old, _)| old.abs_diff(new) > 1)
                .map(|(_, other)| (view_overlap(state, image.frame, other.frame).visible, other))
                .filter(|(visible, other)| {
                    *visible >= MIN_VISIBLE_LANDMARKS
                        && state.shared_count(image.frame, other.frame) < MAX_SHARED_POINTS
                })
                .collect();
        near.sort_by_key(|(visible, other)| (SAMPLED_LANDMARKS - visible, other.frame));
        near.truncate(MAX_MERGED_KEYFRAMES);
        near.iter().filter_map(|(_, old)| verify_known_pose(state, image, old)).flatten().collect()
    };
    let keyframe_images = state.tracks.keyframe_images.par_iter().enumerate();
    let observations: Vec<Vec<(usize, Observation)>> = keyframe_images.map(find_overlaps).collect();
    if observations.iter().any(|s| !s.is_empty()) {
        observations.into_iter().for_each(|s| state.add_observations(s));
        adjust_path(state, adjust_focal);
    }
}

/// Median distance of landmarks from their first camera.
fn median_landmark_distance(state: &SfmState) -> f64 {
    let near = |l: &Landmark| (l.inverse_depth() > 1e-6).then(|| l.inverse_depth().recip());
    median(&mut state.landmarks.iter().flatten().filter_map(near).collect::<Vec<_>>())
        .unwrap_or(1.0)
}

/// Keyframes from the one with index `first` on, verified against much older ones.
fn find_loop_candidates(state: &SfmState, first: usize) -> Vec<LoopCandidate> {
    let is_scale_measured = state.is_scale_measured();
    let search = |(new, image): (usize, &Arc<KeyframeImage>)| {
        state.poses[image.frame].filter(|_| !state.progress.is_cancelled())?;
        let may = |old: usize, other: &KeyframeImage| {
            old + MIN_LOOP_GAP <= new
                && state.poses[other.frame].is_some()
                && state.shared_count(image.frame, other.frame) < MAX_SHARED_POINTS
        };
        let of = |(old, other): (usize, &KeyframeImage)| {
            let found = match_and_verify(state, image, other)?;
            let scale = match is_scale_measured {
                // Measured lengths do not drift: a place of another size is another place.
                true if found.scale.is_some_and(|s| s.ln().abs() > MAX_DISAGREEMENT[2]) => None?,
                true => 1.0,
                false => found.scale?,
            };
            let place = Similarity::from_pose(found.world_from_camera, scale);
            Some(LoopCandidate { new, old, found, place })
        };
        candidate_keyframes(state, image, may).into_iter().find_map(of)
    };
    state.tracks.keyframe_images.par_iter().enumerate().skip(first).filter_map(search).collect()
}

/// Whether a path can have drifted as far as a candidate says: rejects places that only look alike.
fn is_plausible_drift(state: &SfmState, r: &LoopCandidate, unit: f64) -> bool {
    let between = &state.tracks.keyframe_images[r.old..=r.new];
    let places: Vec<Pose<f64>> = between.iter().filter_map(|l| state.poses[l.frame]).collect();
    let step = |p: &[Pose<f64>]| (p[1].translation - p[0].translation).norm();
    let path_length: f64 = places.windows(2).map(step).sum();
    let Some(own) = places.last() else { return false };
    let off = (r.place.translation - own.translation).norm();
    let turn = own.local(r.place.pose()).rotation.norm();
    off < (MIN_TRANSLATION_BOUND * unit).max(MAX_TRANSLATION_DRIFT * path_length)
        && turn < MAX_ROTATION_DRIFT
        && r.place.scale.ln().abs() < MAX_LOG_SCALE_DRIFT
}

/// Candidates that a neighbouring one agrees with.
fn consistent_candidates(
    state: &SfmState,
    candidates: Vec<LoopCandidate>,
    unit: f64,
) -> Vec<LoopCandidate> {
    let pose = |r: &LoopCandidate| state.poses[state.tracks.keyframe_images[r.new].frame];
    // The other camera after the correction of this candidate.
    let moved = |r: &LoopCandidate, other: &LoopCandidate| {
        let (own, there) =
            (Similarity::from_pose(pose(r)?, 1.0), Similarity::from_pose(pose(other)?, 1.0));
        Some(r.place.compose(&own.inverse()).compose(&there))
    };
    let agree = |r: &LoopCandidate, other: &LoopCandidate| {
        let Some(moved) = moved(r, other) else { return false };
        let [x, y, z, a, b, c, s] = other.place.inverse().compose(&moved).coordinates();
        let off = [a.hypot(b).hypot(c), x.hypot(y).hypot(z) / unit, s.abs()];
        off.iter().zip(MAX_DISAGREEMENT).all(|(off, most)| *off < most)
    };
    let is_confirmed = |r: &LoopCandidate| {
        let near =
            |o: &&LoopCandidate| o.new != r.new && o.new.abs_diff(r.new) <= CONSISTENCY_WINDOW;
        candidates.iter().filter(near).any(|o| agree(r, o))
    };
    let keep: Vec<bool> = candidates.iter().map(is_confirmed).collect();
    candidates.into_iter().zip(keep).filter_map(|(r, keep)| keep.then_some(r)).collect()
}

/// Distributes the drift over keyframes by a pose graph, and moves frames and landmarks with them.
fn distribute_drift(
    state: &mut SfmState,
    candidates: &[LoopCandidate],
    followers: &BTreeMap<usize, Vec<usize>>,
    unit: f64,
) {
    let keyframe_images = &state.tracks.keyframe_images;
    let posed: Vec<usize> = (0..keyframe_images.len())
        .filter(|k| state.poses[keyframe_images[*k].frame].is_some())
        .collect();
    let mut place = vec![None; keyframe_images.len()];
    posed.iter().enumerate().for_each(|(i, k)| place[*k] = Some(i));
    let frames: Vec<usize> = posed.iter().map(|k| keyframe_images[*k].frame).collect();
    let before: Vec<Similarity<f64>> = frames
        .iter()
        .filter_map(|f| state.poses[*f].map(|pose| Similarity::from_pose(pose, 1.0)))
        .collect();
    let unchanged =
        sequential_edges(state, &frames).into_iter().chain(relocalized_edges(state, &frames));
    let mut edges: Vec<PoseGraphEdge> = unchanged
        .map(|(first, second)| {
            let measured = before[first].inverse().compose(&before[second]);
            PoseGraphEdge { first, second, measured, weight: 1.0 }
        })
        .collect();
    for r in candidates {
        let (Some(first), Some(second)) = (place[r.old], place[r.new]) else { continue };
        let measured = before[first].inverse().compose(&r.place);
        edges.push(PoseGraphEdge { first, second, measured, weight: LOOP_EDGE_WEIGHT });
    }
    let mut after = before.clone();
    let lengths = GraphLengths { unit, is_metric: state.is_scale_measured() };
    optimize_pose_graph(&mut after, &edges, lengths);
    let moves: Vec<Similarity<f64>> =
        after.iter().zip(&before).map(|(after, before)| after.compose(&before.inverse())).collect();
    apply_corrections(state, &frames, &moves, followers);
}

/// Pairs of neighbouring keyframes that share points, as indices into `frames`.
fn sequential_edges(state: &SfmState, frames: &[usize]) -> Vec<(usize, usize)> {
    let before = |second: usize| {
        (second.saturating_sub(SEQUENTIAL_EDGE_SPAN)..second).map(move |f| (f, second))
    };
    let share = |(first, second): &(usize, usize)| {
        state.shared_count(frames[*first], frames[*second]) >= MIN_EDGE_POINTS
    };
    (0..frames.len()).flat_map(before).filter(share).collect()
}

/// Pairs of keyframes that share points by relocalization and must stay together.
fn relocalized_edges(state: &SfmState, frames: &[usize]) -> Vec<(usize, usize)> {
    let mut place = vec![None; state.poses.len()];
    frames.iter().enumerate().for_each(|(i, f)| place[*f] = Some(i));
    let mut counts: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (track, _) in state.tracks.tracks.iter().zip(&state.landmarks).filter(|(_, l)| l.is_some())
    {
        let right = track.observations.iter().filter(|o| !o.is_outlier);
        let places: Vec<usize> = right.filter_map(|o| place[o.frame]).collect();
        let parts: Vec<&[usize]> = places.chunk_by(|a, b| b - a <= SEQUENTIAL_EDGE_SPAN).collect();
        for (i, later) in parts.iter().enumerate() {
            let earlier = parts[..i].iter().copied().flatten();
            let pairs = earlier.flat_map(|first| later.iter().map(|second| (*first, *second)));
            pairs.for_each(|pair| *counts.entry(pair).or_default() += 1);
        }
    }
    counts
        .into_iter()
        .filter(|(_, count)| *count >= MIN_EDGE_POINTS)
        .map(|(pair, _)| pair)
        .collect()
}

/// Moves every frame with the keyframe that it follows, or else with the one at or before it, and every
/// landmark with the first keyframe that observes it, or else with the first frame.
fn apply_corrections(
    state: &mut SfmState,
    keyframes: &[usize],
    moves: &[Similarity<f64>],
    followers: &BTreeMap<usize, Vec<usize>>,
) {
    let before = |frame: usize| keyframes.partition_point(|k| *k <= frame).saturating_sub(1);
    let mut places: Vec<usize> = (0..state.poses.len()).map(before).collect();
    for (place, keyframe) in keyframes.iter().enumerate() {
        followers.get(keyframe).into_iter().flatten().for_each(|frame| places[*frame] = place);
    }
    keyframes.iter().enumerate().for_each(|(place, keyframe)| places[*keyframe] = place);
    let by = |frame: usize| moves.get(places[frame]);
    for (landmark, track) in state.landmarks.iter_mut().zip(&state.tracks.tracks) {
        let mut posed = track.observations.iter().filter(|o| state.poses[o.frame].is_some());
        let first = posed.clone().find(|o| keyframes.binary_search(&o.frame).is_ok());
        let by = first.or(posed.next()).and_then(|o| by(o.frame));
        if let (Some(known), Some(by)) = (&mut *landmark, by) {
            *known = known.transformed(by);
        }
    }
    for (frame, pose) in state.poses.iter_mut().enumerate() {
        if let (Some(known), Some(by)) = (&mut *pose, by(frame)) {
            *known = by.apply_to_pose(*known);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;
    use crate::track::tracks::Tracks;
    use i2slam_geometry::{Rotation, Vec3};

    /// Keyframes of the first path, which ends with a covered lens, and of both paths.
    const CUT: usize = 20;
    const KEYFRAMES: usize = 40;
    /// The old keyframe at which the first one after the cut was relocalized.
    const RECOGNISED: usize = 8;

    /// Ten tracks of every three consecutive keyframes, none across the cut; ten of [`RECOGNISED`]
    /// are observed again in the first keyframe after it.
    fn two_ways() -> SfmState {
        let camera = camera();
        let at = |index: usize, k: usize| [20.0 + 30.0 * k as f64, 20.0 + 4.0 * index as f64];
        let observation = |index: usize, k: usize| Observation::new(index, at(index, k), 0.3);
        let mut tracks = Vec::new();
        for begin in (0..KEYFRAMES - 2).filter(|b| b + 2 < CUT || *b >= CUT) {
            for k in 0..10 {
                let mut observations: Vec<_> =
                    (begin..begin + 3).map(|f| observation(f, k)).collect();
                if begin == RECOGNISED {
                    observations.push(observation(CUT, k));
                }
                tracks.push(Track { observations });
            }
        }
        let keyframe_images = (0..KEYFRAMES).map(|f| {
            let blank = i2slam_geometry::Image::new(48, 48, 1);
            KeyframeImage::new(&crate::track::pyramid::Pyramid::new(&blank), f)
        });
        let keyframe_images = keyframe_images.map(Arc::new).collect();
        let keyframes = (0..KEYFRAMES).collect();
        let mut state =
            SfmState::new(camera, Tracks { tracks, keyframes, keyframe_images, frames: KEYFRAMES });
        let place = |f: usize| {
            let x = if f < CUT { f } else { f - CUT + RECOGNISED };
            Some(Pose::new(Rotation::identity(), Vec3::new(0.1 * x as f64, 0.0, 0.0)))
        };
        state.poses = (0..KEYFRAMES).map(place).collect();
        let first = |t: &Track| {
            let o = t.observations[0];
            Some(Landmark::on_ray(&camera, place(o.frame)?, o.at(), 0.5))
        };
        state.landmarks = state.tracks.tracks.iter().map(first).collect();
        state
    }

    /// The end of the second path is found at the end of the first, 0.4 aside: all keyframes share
    /// the drift, and the relocalized one stays in place.
    #[test]
    fn a_place_that_was_recognised_is_not_torn_by_a_closed_loop() {
        let mut state = two_ways();
        let gap = |state: &SfmState| {
            let at = |f: usize| state.poses[f].expect("posed").translation;
            (at(CUT) - at(RECOGNISED)).norm()
        };
        let end = Pose::new(Rotation::identity(), Vec3::new(1.9, 0.4, 0.0));
        let found =
            Relocalization { world_from_camera: end, scale: Some(1.0), observations: Vec::new() };
        let place = Similarity::from_pose(end, 1.0);
        let back = LoopCandidate { new: CUT + 11, old: CUT - 1, found, place };
        distribute_drift(&mut state, &[back], &BTreeMap::new(), 2.0);
        assert!(gap(&state) < 0.1, "{}", gap(&state));
    }

    /// A frame that follows an old keyframe moves with it, whichever keyframes came in between.
    #[test]
    fn frames_move_with_the_keyframe_that_they_follow() {
        let mut state = two_ways();
        let before = state.poses.clone();
        let keyframes = [0, 10, 20];
        let shift = |x: f64| {
            Similarity::from_pose(Pose::new(Rotation::identity(), Vec3::new(x, 0.0, 0.0)), 1.0)
        };
        let followers = BTreeMap::from([(0, vec![1, 25]), (20, vec![21])]);
        apply_corrections(&mut state, &keyframes, &[1.0, 2.0, 3.0].map(shift), &followers);
        let moved = |frame: usize| {
            let [now, was] = [&state.poses, &before].map(|poses| poses[frame].expect("a pose"));
            (now.translation - was.translation).x
        };
        for (frame, by) in
            [(0, 1.0), (1, 1.0), (10, 2.0), (12, 2.0), (20, 3.0), (21, 3.0), (25, 1.0)]
        {
            assert!((moved(frame) - by).abs() < 1e-9, "frame {frame}: {}", moved(frame));
        }
    }
}

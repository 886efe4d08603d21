//! Photographs whose poses are contradicted by matches that are missing.
//!
//! Surfaces that repeat, such as the sides of a table, place a photograph where another side was seen, by matches
//! that agree. From there it would see everything that its new neighbours see, and of most of that it shows
//! nothing: matches that are due and missing (Zach et al. 2010) tell the two apart.

use crate::multiview::landmark::Landmark;
use crate::sfm_state::SfmState;
use i2slam_compute::median;
use i2slam_geometry::{Camera, Vec3};
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Landmarks of each of two photographs that the other one would show, at least.
const MIN_VISIBLE: usize = 8;
/// Mean angle between the rays to these landmarks, at most, and that at which no match is expected, to which the
/// expected share falls in proportion: measured 0.2 at 15 to 30 degrees, 0.1 at 30 to 45, 0.02 beyond [rad].
const MAX_ANGLE: f64 = 0.7;
const UNMATCHED_ANGLE: f64 = 0.87;
/// Ratio of the distances of a landmark from two photographs beyond which features differ in scale.
const MAX_DISTANCE_RATIO: f64 = 2.0;
/// Share of the expected matches that two photographs of one place have, at least. Measured in parts of maps of
/// four scenes 0.22 and more where they were right, and up to 0.13 where a part lay on another place.
const MIN_MATCHED: f64 = 0.18;

/// Two photographs that see the same landmarks.
struct Overlap {
    /// Places among the photographs with a pose.
    photographs: [usize; 2],
    /// Share of these landmarks that both show, of the one that has more of them.
    matched: f64,
    /// Share that the angle between the views lets expect, up to a factor of the map.
    expected: f64,
}

/// Drops the poses of photographs that the larger part of the map contradicts, and their matches with those of
/// this part from near which they should show the same: these are of other surfaces. Returns how many.
pub(crate) fn drop_contradicted(state: &mut SfmState) -> usize {
    let Some(photographs) = state.photographs.clone() else { return 0 };
    let posed = state.posed_frames();
    let overlaps = overlaps(state, &photographs.compared, &posed);
    if state.progress.is_cancelled() {
        return 0;
    }
    let kept = consistent_part(posed.len(), &agreement(posed.len(), &overlaps));
    let is_between =
        |overlap: &&Overlap| kept[overlap.photographs[0]] != kept[overlap.photographs[1]];
    let between = overlaps.iter().filter(is_between);
    let between: BTreeSet<[usize; 2]> =
        between.map(|overlap| overlap.photographs.map(|place| posed[place])).collect();
    let mut photographs = Arc::unwrap_or_clone(photographs);
    photographs.pairs.retain(|pair| {
        !between.contains(&[pair.first.min(pair.second), pair.first.max(pair.second)])
    });
    let dropped: Vec<usize> =
        posed.iter().zip(&kept).filter(|(_, kept)| !**kept).map(|(frame, _)| *frame).collect();
    dropped.iter().for_each(|frame| state.poses[*frame] = None);
    dropped.iter().for_each(|frame| forget_observations(state, *frame));
    state.photographs = Some(Arc::new(photographs));
    dropped.len()
}

/// Takes the observations in a frame without a pose for outliers of landmarks that others determine, and drops
/// landmarks that rest on it, of whose observations all may be right.
fn forget_observations(state: &mut SfmState, frame: usize) {
    for track in Arc::clone(&state.by_frame)[frame].iter().copied() {
        let is_determined = state.adjusted_inliers(track).nth(1).is_some();
        let observations = &mut state.tracks.tracks[track].observations;
        if is_determined {
            let own = observations.iter_mut().filter(|o| o.frame == frame);
            own.for_each(|o| o.is_outlier = true);
        } else {
            state.landmarks[track] = None;
            observations.iter_mut().for_each(|o| o.is_outlier = false);
        }
    }
}

/// Those of the compared pairs of photographs that see the same landmarks from directions near enough.
fn overlaps(state: &SfmState, compared: &[[usize; 2]], posed: &[usize]) -> Vec<Overlap> {
    let place = |frame: &usize| posed.binary_search(frame).ok();
    let overlap = |[a, b]: &[usize; 2]| {
        let photographs = [place(a)?, place(b)?];
        if state.progress.is_cancelled() {
            return None;
        }
        let there = view_of(state, [*a, *b])?;
        let back = view_of(state, [*b, *a])?;
        let (matched, expected) = if back.0 > there.0 { back } else { there };
        Some(Overlap { photographs, matched, expected })
    };
    compared.par_iter().filter_map(overlap).collect()
}

/// Share of the landmarks of one photograph within the picture of another that this shows, and the expected
/// share up to a factor; `None` for few landmarks or a large angle.
fn view_of(state: &SfmState, [frame, other]: [usize; 2]) -> Option<(f64, f64)> {
    let (own, seen_from) = (state.poses[frame]?, state.poses[other]?);
    let other_from_world = seen_from.inverse();
    let (mut visible, mut shared, mut angles) = (0_usize, 0_usize, 0.0);
    for (track, observation) in state.observations_in(frame) {
        let landmark = state.landmarks[track].as_ref().filter(|_| !observation.is_outlier);
        let Some(point) = landmark.map(Landmark::position) else { continue };
        let rays = [own, seen_from].map(|pose| pose.translation - point);
        // Without the other one: what two photographs alone show says nothing of what the second should show.
        let mut without = state.adjusted_inliers(track).filter(|o| o.frame != other);
        if !is_within(&state.camera, other_from_world * point)
            || !is_of_one_scale(rays)
            || without.nth(1).is_none()
        {
            continue;
        }
        visible += 1;
        let there = state.tracks.tracks[track].observation_in(other);
        shared += usize::from(there.is_some_and(|o| !o.is_outlier));
        angles += angle(rays);
    }
    let mean_angle = angles / visible.max(1) as f64;
    (visible >= MIN_VISIBLE && mean_angle < MAX_ANGLE)
        .then(|| (shared as f64 / visible as f64, 1.0 - mean_angle / UNMATCHED_ANGLE))
}

/// True if a camera sees a point in its frame.
fn is_within(camera: &Camera<f64>, point: Vec3<f64>) -> bool {
    let (u, v) = camera.project(point);
    let (width, height) = (camera.width as f64, camera.height as f64);
    point.z > 0.0 && (0.0..width).contains(&u) && (0.0..height).contains(&v)
}

/// True if features at the ends of two rays are of about one size.
fn is_of_one_scale(rays: [Vec3<f64>; 2]) -> bool {
    let [a, b] = rays.map(Vec3::norm);
    a < MAX_DISTANCE_RATIO * b && b < MAX_DISTANCE_RATIO * a
}

fn angle([a, b]: [Vec3<f64>; 2]) -> f64 {
    (a.dot(b) / (a.norm() * b.norm())).clamp(-1.0, 1.0).acos()
}

/// Excess of the matches of every two photographs over the share that one place asks for; 0 for those that
/// see nothing in common.
fn agreement(count: usize, overlaps: &[Overlap]) -> Vec<Vec<f64>> {
    // Features are found again more often in sharp pictures than in blurred ones.
    let mut best = vec![0.0_f64; count];
    for Overlap { photographs, matched, expected } in overlaps {
        photographs.iter().for_each(|place| best[*place] = best[*place].max(matched / expected));
    }
    best.retain(|best| *best > 0.0);
    let factor = median(&mut best).unwrap_or(0.0);
    let mut agreement = vec![vec![0.0; count]; count];
    for Overlap { photographs: [a, b], matched, expected } in overlaps {
        let above = matched - MIN_MATCHED * factor * expected;
        (agreement[*a][*b], agreement[*b][*a]) = (above, above);
    }
    agreement
}

/// The photographs of the largest part within which matches agree, and of all parts that do not contradict it.
fn consistent_part(count: usize, agreement: &[Vec<f64>]) -> Vec<bool> {
    let mut parts = agreeing_parts(count, agreement);
    parts.sort_by_key(|part| (Reverse(part.len()), part[0]));
    let mut kept = vec![false; count];
    for part in parts {
        let with_kept = |a: &usize| {
            let all = kept.iter().zip(&agreement[*a]);
            all.filter(|(kept, _)| **kept).map(|(_, above)| above).sum::<f64>()
        };
        if part.iter().map(with_kept).sum::<f64>() >= 0.0 {
            part.iter().for_each(|place| kept[*place] = true);
        }
    }
    kept
}

/// Parts of the photographs: the two that agree most are joined as long as any agree.
fn agreeing_parts(count: usize, agreement: &[Vec<f64>]) -> Vec<Vec<usize>> {
    let mut parts: Vec<Vec<usize>> = (0..count).map(|place| vec![place]).collect();
    let mut between = agreement.to_vec();
    loop {
        let pairs = (0..parts.len()).flat_map(|a| (0..a).map(move |b| [b, a]));
        let most = pairs.max_by(|[a, b], [c, d]| between[*a][*b].total_cmp(&between[*c][*d]));
        let Some([a, b]) = most.filter(|[a, b]| between[*a][*b] > 0.0) else { return parts };
        let joined = parts.remove(b);
        parts[a].extend(joined);
        let row = between.remove(b);
        for (own, with) in between.iter_mut().zip(row.iter().enumerate().filter(|(i, _)| *i != b)) {
            own.remove(b);
            own[a] += with.1;
        }
        let column: Vec<f64> = between.iter().map(|row| row[a]).collect();
        between[a] = column;
        between[a][a] = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::collection::{MatchedPhotographs, PhotographPair};
    use crate::fixtures::{camera, state};
    use crate::track::tracks::Observation;
    use i2slam_geometry::{Pose, Rotation};
    use std::collections::BTreeMap;

    /// Six photographs that see all points, and two of another place that lie among them.
    #[test]
    fn photographs_among_others_of_which_they_show_nothing_are_dropped() {
        let pose = |i: usize| Pose::new(Rotation::identity(), Vec3::new(0.05 * i as f64, 0.0, 0.0));
        let is_of_other_place = |frame: usize| frame == 3 || frame == 5;
        let observe = |point: Vec3<f64>, frame: usize, _: &[f64]| {
            let seen = pose(frame).inverse() * point;
            (seen.z > 0.0).then(|| camera().project(seen).into())
        };
        let mut right = state((8, 30, 1), [60.0, 40.0], pose, observe);
        let pair = |(first, second)| {
            let (matches, second_from_first) = (Vec::new(), None);
            PhotographPair { first, second, matches, second_from_first }
        };
        let all_pairs = (0..8).flat_map(|a| (a + 1..8).map(move |b| [a, b]));
        right.photographs = Some(Arc::new(MatchedPhotographs {
            compared: Arc::new(all_pairs.collect()),
            pairs: [(0, 1), (3, 5), (4, 3)].map(pair).into(),
            features: BTreeMap::new(),
            registered_anew: BTreeSet::new(),
        }));
        let mut all_right = right.clone();
        assert_eq!(drop_contradicted(&mut all_right), 0);
        assert_eq!(all_right.poses, right.poses);

        let mut wrong = right;
        for (track, landmark) in wrong.tracks.tracks.iter_mut().zip(&mut wrong.landmarks) {
            let begins = track.observations[0].frame;
            track.observations.retain(|o| is_of_other_place(o.frame) == is_of_other_place(begins));
            if track.observations.len() < 2 {
                *landmark = None;
            }
        }
        let by_frame = |frame: usize| {
            let tracks = wrong.tracks.tracks.iter().enumerate();
            tracks.filter(|(_, t)| t.observation_in(frame).is_some()).map(|(i, _)| i).collect()
        };
        wrong.by_frame = Arc::new((0..8).map(by_frame).collect());
        // Matched by mistake.
        wrong.add_observations(vec![(0, Observation::new(3, [0.0, 0.0], 0.3))]);
        assert_eq!(drop_contradicted(&mut wrong), 2);
        let mistake = wrong.tracks.tracks[0].observation_in(3).expect("an observation");
        assert!(mistake.is_outlier);
        let photographs = wrong.photographs.as_ref().expect("photographs");
        let left: Vec<_> = photographs.pairs.iter().map(|pair| (pair.first, pair.second)).collect();
        assert_eq!(left, [(0, 1), (3, 5)]);
        let posed: Vec<usize> = (0..8).filter(|frame| !is_of_other_place(*frame)).collect();
        assert_eq!(wrong.posed_frames(), posed);
        let of_others =
            |track: usize| is_of_other_place(wrong.tracks.tracks[track].observations[0].frame);
        assert!((0..wrong.landmarks.len()).all(|i| wrong.landmarks[i].is_none() || !of_others(i)));
    }

    #[test]
    fn the_largest_agreeing_part_is_kept_with_all_that_nothing_contradicts() {
        // 0, 1 and 2 agree, 3 and 4 agree and contradict them, 5 sees nothing in common with any.
        let mut agreement = vec![vec![0.0; 6]; 6];
        let pairs =
            [(0, 1, 0.5), (1, 2, 0.4), (0, 2, -0.1), (3, 4, 0.6), (0, 3, 0.1), (1, 4, -0.3)];
        for (a, b, above) in pairs {
            (agreement[a][b], agreement[b][a]) = (above, above);
        }
        assert_eq!(consistent_part(6, &agreement), [true, true, true, false, false, true]);
    }
}

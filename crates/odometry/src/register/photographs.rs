//! Registration of photographs in any order, by matches of their features with those of landmarks.

use crate::features::collection::{
    MatchedPhotographs, POSITION_SIGMA, PhotographFeature, PhotographPair,
};
use crate::multiview::landmark::{Match, reprojection_error};
use crate::multiview::pnp::{pose_of_samples, refine_pnp};
use crate::multiview::two_view::sampson;
use crate::sfm_state::SfmState;
use crate::track::tracks::{Observation, Track};
use i2slam_geometry::{Camera, Pose};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Hypotheses of the pose of a photograph, and registered ones from whose poses it is searched.
const HYPOTHESES: usize = 2000;
const MAX_STARTS: usize = 4;
/// Distance of a match from its epipolar lines, at most [deviations].
const MAX_EPIPOLAR_ERROR: f64 = 1.0;
/// Angle by which a photograph that is registered anew turns, at least [rad].
const MIN_CORRECTION: f64 = 0.05;
/// Residual of a match that agrees with a pose [deviations].
const MAX_ERROR: f64 = 3.0;
/// Matches that must agree with a pose, along a verified relative pose and without one.
const MIN_INLIERS: usize = 8;
const MIN_UNVERIFIED_INLIERS: usize = 20;
/// Natural logarithm of the expected number of as good poses among random matches, at most.
const MAX_LOG_FALSE_ALARMS: f64 = -9.0;
/// Matches that determine a pose.
const SAMPLE_SIZE: usize = 4;
/// Width of the loss of the final pose [deviations].
const LOSS_WIDTH: f64 = 1.5;

/// A photograph localised in the map.
struct Localization {
    frame: usize,
    world_from_camera: Pose<f64>,
    /// Its features that agree, and the tracks whose landmarks they show.
    agreeing: Vec<(usize, usize)>,
}

/// Registers the photograph with most matches that agree on a pose; where none is left, one of the registered
/// ones anew that has more of them elsewhere.
pub(crate) fn register_next_photograph(state: &mut SfmState) -> Option<usize> {
    let mut photographs = state.photographs.take()?;
    let (posed, unposed): (Vec<usize>, Vec<usize>) =
        photographs.features.keys().partition(|frame| state.poses[**frame].is_some());
    let best_of = |frames: &[usize], is_better: &(dyn Fn(&Localization) -> bool + Sync)| {
        let found: Vec<Option<Localization>> =
            frames.par_iter().map(|frame| localize(state, &photographs, *frame)).collect();
        let better = found.into_iter().flatten().filter(|found| is_better(found));
        better.max_by_key(|found| found.agreeing.len())
    };
    let best = best_of(&unposed, &|_| true).or_else(|| {
        let is_new = |frame: &usize| !photographs.registered_anew.contains(frame);
        let once: Vec<usize> = posed.iter().copied().filter(is_new).collect();
        best_of(&once, &|found| is_elsewhere(state, found))
    });
    let frame = best.map(|best| register(state, Arc::make_mut(&mut photographs), &best));
    state.photographs = Some(photographs);
    frame
}

/// Whether a registered photograph agrees with more landmarks that others determine at another pose.
fn is_elsewhere(state: &SfmState, found: &Localization) -> bool {
    let Some(pose) = state.poses[found.frame] else { return false };
    let is_supporting = |(track, o): &(usize, &Observation)| {
        !o.is_outlier && is_determined_without(state, *track, found.frame)
    };
    let support = state.observations_in(found.frame).filter(is_supporting).count();
    let turn = pose.local(found.world_from_camera).rotation.norm();
    found.agreeing.len() > support && turn > MIN_CORRECTION
}

/// Whether a track has a landmark that two photographs other than one determine.
fn is_determined_without(state: &SfmState, track: usize, frame: usize) -> bool {
    let others = state.adjusted_inliers(track).filter(|o| o.frame != frame);
    state.landmarks[track].is_some()
        && others.filter(|o| state.poses[o.frame].is_some()).nth(1).is_some()
}

/// Poses a photograph, and adds its features to the tracks that they show, and new tracks of matches that
/// agree with its pose.
fn register(
    state: &mut SfmState,
    photographs: &mut MatchedPhotographs,
    found: &Localization,
) -> usize {
    let frame = found.frame;
    if state.poses[frame].is_some() {
        photographs.registered_anew.insert(frame);
    }
    state.poses[frame] = Some(found.world_from_camera);
    let MatchedPhotographs { pairs, features, .. } = photographs;
    for &(own, track) in &found.agreeing {
        if let Some(feature) = features.get_mut(&frame).and_then(|all| all.get_mut(own)) {
            feature.track = Some(track);
            state.add_observations(vec![(track, feature.observation)]);
        }
    }
    for (pair, other) in pairs_of(pairs, frame) {
        if state.poses[other].is_none() {
            continue;
        }
        for (own, theirs) in matches_of(pair, frame) {
            let (here, there) = (features[&frame][own], features[&other][theirs]);
            if here.track.is_some() || there.track.is_some() || !agrees(state, &here, &there) {
                continue;
            }
            let mut observations = vec![here.observation, there.observation];
            observations.sort_by_key(|o| o.frame);
            let track = Some(state.landmarks.len());
            state.add_track(Track { observations });
            for (frame, feature) in [(frame, own), (other, theirs)] {
                let feature = features.get_mut(&frame).and_then(|all| all.get_mut(feature));
                feature.into_iter().for_each(|feature| feature.track = track);
            }
        }
    }
    frame
}

/// Whether features of two posed photographs may show one point.
fn agrees(state: &SfmState, first: &PhotographFeature, second: &PhotographFeature) -> bool {
    let [a, b] = [first, second].map(|feature| feature.observation);
    let (Some(from), Some(to)) = (state.poses[a.frame], state.poses[b.frame]) else { return false };
    let ray = |o: &Observation| state.camera.unproject(o.at()[0], o.at()[1], 1.0);
    let second_from_first = to.inverse() * from;
    let off = sampson(&second_from_first, &(ray(&a), ray(&b))).abs() * state.camera.fx;
    off < MAX_EPIPOLAR_ERROR * a.sigma()
}

/// The pose of a photograph by its matches with landmarks.
fn localize(
    state: &SfmState,
    photographs: &MatchedPhotographs,
    frame: usize,
) -> Option<Localization> {
    let mut shared: BTreeMap<usize, usize> = BTreeMap::new();
    let mut candidates: BTreeSet<(usize, usize)> = BTreeSet::new();
    for (pair, other) in
        pairs_of(&photographs.pairs, frame).filter(|(_, o)| state.poses[*o].is_some())
    {
        for (own, theirs) in matches_of(pair, frame) {
            let track = photographs.features[&other][theirs].track;
            let Some(track) = track.filter(|t| is_determined_without(state, *t, frame)) else {
                continue;
            };
            *shared.entry(other).or_default() += 1;
            candidates.insert((track, own));
        }
    }
    let features = &photographs.features[&frame];
    let candidates: Vec<(usize, usize)> = candidates.into_iter().collect();
    let matches: Vec<Match<'_>> = candidates
        .iter()
        .filter_map(|(track, own)| {
            Some((state.landmarks[*track].as_ref()?, &features[*own].observation))
        })
        .collect();
    let camera = &state.camera;
    let by_samples = pose_of_samples(camera, &nearest_poses(state, &shared), &matches, HYPOTHESES);
    // Patterns that repeat agree, too, if no relative pose speaks against it.
    let by_samples = by_samples.filter(|(_, agreeing)| {
        agreeing.len() >= MIN_UNVERIFIED_INLIERS
            && is_no_chance(camera, SAMPLE_SIZE, [matches.len(), agreeing.len()])
    });
    let by_pairs = poses_by_pairs(state, photographs, frame, &matches);
    let best = by_pairs.chain(by_samples).max_by_key(|(_, agreeing)| agreeing.len());
    let (pose, agreeing) = best?;
    let world_from_camera = refine_pnp(camera, pose, &agreeing, LOSS_WIDTH);
    let is_agreeing =
        |m: &Match<'_>| agreeing.iter().any(|a| std::ptr::eq(a.0, m.0) && std::ptr::eq(a.1, m.1));
    let agreeing = candidates.iter().zip(&matches).filter(|(_, m)| is_agreeing(m));
    let agreeing = agreeing.map(|((track, own), _)| (*own, *track)).collect();
    Some(Localization { frame, world_from_camera, agreeing })
}

/// Pairs with a photograph, and the other one of each.
fn pairs_of(
    pairs: &[PhotographPair],
    frame: usize,
) -> impl Iterator<Item = (&PhotographPair, usize)> {
    pairs.iter().filter_map(move |pair| match (pair.first, pair.second) {
        (first, second) if first == frame => Some((pair, second)),
        (first, second) if second == frame => Some((pair, first)),
        _ => None,
    })
}

/// Features of a photograph and those of the other one that they match.
fn matches_of(pair: &PhotographPair, frame: usize) -> impl Iterator<Item = (usize, usize)> {
    let is_first = pair.first == frame;
    pair.matches.iter().map(move |&(a, b)| if is_first { (a, b) } else { (b, a) })
}

/// Poses of the registered photographs that share most matches with one.
fn nearest_poses(state: &SfmState, shared: &BTreeMap<usize, usize>) -> Vec<Pose<f64>> {
    let mut near: Vec<(usize, usize)> = shared.iter().map(|(other, n)| (*n, *other)).collect();
    near.sort_by(|a, b| b.cmp(a));
    near.iter().take(MAX_STARTS).filter_map(|(_, other)| state.poses[*other]).collect()
}

/// Poses of a photograph by its relative poses to registered ones, as far away as most landmarks ask, each
/// with the matches that agree, where so many are no chance.
fn poses_by_pairs<'a>(
    state: &SfmState,
    photographs: &MatchedPhotographs,
    frame: usize,
    matches: &[Match<'a>],
) -> impl Iterator<Item = (Pose<f64>, Vec<Match<'a>>)> {
    let camera = &state.camera;
    let of_pair = move |(pair, other): (&PhotographPair, usize)| {
        let relative = pair.second_from_first?;
        let relative = if pair.second == frame { relative } else { relative.inverse() };
        let other = state.poses[other]?;
        let pose_at = |length: f64| {
            other * Pose::new(relative.rotation, relative.translation * length).inverse()
        };
        let lengths = matches.iter().map(|m| baseline_length(camera, relative, other.inverse(), m));
        let tried = lengths.filter(|length| *length > 0.0).map(|length| {
            let pose = pose_at(length);
            (agreeing(camera, &pose, matches).len(), pose)
        });
        let (_, pose) = tried.max_by_key(|(count, _)| *count)?;
        let pose = refine_pnp(camera, pose, &agreeing(camera, &pose, matches), LOSS_WIDTH);
        let agreeing = agreeing(camera, &pose, matches);
        is_no_chance(camera, 1, [matches.len(), agreeing.len()]).then_some((pose, agreeing))
    };
    pairs_of(&photographs.pairs, frame).filter_map(of_pair).collect::<Vec<_>>().into_iter()
}

/// Matches that agree with a pose.
fn agreeing<'a>(camera: &Camera<f64>, pose: &Pose<f64>, all: &[Match<'a>]) -> Vec<Match<'a>> {
    all.iter().filter(|m| reprojection_error(camera, pose, m) < MAX_ERROR).copied().collect()
}

/// Length of the baseline between two pictures, whose direction `camera_from_other` gives, that a landmark
/// asks for.
fn baseline_length(
    camera: &Camera<f64>,
    camera_from_other: Pose<f64>,
    other_from_world: Pose<f64>,
    (landmark, o): &Match<'_>,
) -> f64 {
    // The ray r through the observation meets R x + s t.
    let ray = camera.unproject(o.at()[0], o.at()[1], 1.0);
    let point = other_from_world * landmark.position();
    let along = ray.cross(camera_from_other.rotation.rotate(point));
    let moved = ray.cross(camera_from_other.translation);
    -moved.dot(along) / moved.norm_squared().max(1e-12)
}

/// Whether so many of the matches agree with a pose that `sample` of them determine that it is no chance
/// (Moisan, Moulon and Monasse 2012): a random one agrees in a small part of the picture.
fn is_no_chance(camera: &Camera<f64>, sample: usize, [matches, agreeing]: [usize; 2]) -> bool {
    if agreeing < MIN_INLIERS {
        return false;
    }
    let radius = MAX_ERROR * POSITION_SIGMA;
    let p = std::f64::consts::PI * radius * radius / (camera.width * camera.height) as f64;
    let log_choose = |n: usize, k: usize| -> f64 {
        (0..k).map(|i| ((n - i) as f64).ln() - ((i + 1) as f64).ln()).sum()
    };
    let log = ((matches - sample) as f64).ln()
        + log_choose(matches, agreeing)
        + log_choose(agreeing, sample)
        + (agreeing - sample) as f64 * p.ln();
    log < MAX_LOG_FALSE_ALARMS
}

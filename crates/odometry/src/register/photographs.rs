//! Registration of photographs in any order, by matches of their features with those of landmarks.

use crate::depth::readings::read_depth;
use crate::features::collection::{
    MatchedPhotographs, PhotoCollection, PhotographFeature, PhotographPair,
};
use crate::features::{max_epipolar_distance, position_sigma};
use crate::multiview::a_contrario::is_no_chance;
use crate::multiview::landmark::{Landmark, Match, reprojection_error};
use crate::multiview::lens_distortion::undistort;
use crate::multiview::pnp::{pose_of_samples, refine_pnp};
use crate::multiview::two_view::sampson;
use crate::sfm_state::SfmState;
use crate::track::tracks::{Observation, Track};
use i2slam_geometry::{Camera, Pose};
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Hypotheses of the pose of a photograph, and registered ones from whose poses it is searched.
const HYPOTHESES: usize = 2000;
const MAX_STARTS: usize = 4;
/// Verified relative poses along which a photograph is placed, and distances that are tried along each.
const MAX_PAIRS: usize = 8;
const MAX_LENGTHS: usize = 64;
/// Photographs that are localised at once: a number that does not depend on the processors, as results must not.
const LOCALIZED_AT_ONCE: usize = 4;
/// Angle by which a photograph that is registered anew turns, at least [rad].
const MIN_CORRECTION: f64 = 0.05;
/// Residual of a match that agrees with a pose [deviations].
const MAX_ERROR: f64 = 3.0;
/// Features that must agree with a pose, along a verified relative pose and without one: patterns that
/// repeat agree, too, if nothing speaks against it.
const MIN_INLIERS: usize = 8;
const MIN_UNVERIFIED_INLIERS: usize = 20;
/// Matches that determine a pose, and those that determine it along a relative pose.
const SAMPLE_SIZE: usize = 4;
const SAMPLE_SIZE_OF_LENGTH: usize = 1;
/// Adjustments of a pose to what agrees with it.
const MAX_REFINEMENTS: usize = 6;
/// Width of the loss of the final pose [deviations].
const LOSS_WIDTH: f64 = 1.5;

/// A feature of a photograph that may show a landmark.
#[derive(Clone, Copy)]
struct Candidate<'a> {
    /// Indices of feature and track.
    own: usize,
    track: usize,
    landmark: &'a Landmark,
    observation: &'a Observation,
}

/// Landmarks that a photograph shows according to its matches with registered ones.
struct MatchedLandmarks {
    frame: usize,
    /// Its features that match a feature of a landmark, and the tracks of these landmarks, each determined by
    /// two other photographs.
    shown: Vec<(usize, usize)>,
    /// Number of different features among them.
    features: usize,
    /// Registered photographs by the number of such matches with them, most first.
    by_shared: Vec<usize>,
}

/// A photograph localised in the map.
struct Localization {
    frame: usize,
    world_from_camera: Pose<f64>,
    /// Its features that agree, and the tracks whose landmarks they show.
    agreeing: Vec<(usize, usize)>,
}

/// The state with matches of all photographs, near the epipolar lines of approximate poses if there are any.
pub(crate) fn with_matches(
    mut state: SfmState,
    photographs: &PhotoCollection,
    approximate: &[Option<Pose<f64>>],
) -> SfmState {
    let (first, progress) = (state.landmarks.len(), state.progress.clone());
    let (matched, tracks) = photographs.match_all(&state.camera, approximate, first, &progress);
    tracks.into_iter().for_each(|track| state.add_track(track));
    read_depth(&mut state);
    SfmState { photographs: Some(Arc::new(matched)), ..state }
}

/// Registers the photograph with most features that agree on a pose; where none is left, one of the
/// registered ones anew that has more of them elsewhere.
pub(crate) fn register_next_photograph(state: &mut SfmState) -> Option<usize> {
    let mut photographs = state.photographs.take()?;
    let (posed, unposed): (Vec<usize>, Vec<usize>) =
        photographs.features.keys().partition(|frame| state.poses[**frame].is_some());
    let best = best_localization(state, &photographs, &unposed, |_| MIN_INLIERS, |_| true);
    let best = best.or_else(|| {
        let is_new = |frame: &usize| !photographs.registered_anew.contains(frame);
        let once: Vec<usize> = posed.iter().copied().filter(is_new).collect();
        let least = |frame: usize| support(state, frame) + 1;
        best_localization(state, &photographs, &once, least, |found| is_turned(state, found))
    });
    let frame = best.map(|best| register(state, Arc::make_mut(&mut photographs), &best));
    state.photographs = Some(photographs);
    frame
}

/// Of some photographs the one with most features that agree on an acceptable pose, `least` of each at least.
///
/// No more features can agree than match landmarks, so that photographs are localised in the order of these
/// numbers, and only as long as one of the others may have as many that agree.
fn best_localization(
    state: &SfmState,
    photographs: &MatchedPhotographs,
    frames: &[usize],
    least: impl Fn(usize) -> usize + Sync,
    is_acceptable: impl Fn(&Localization) -> bool,
) -> Option<Localization> {
    let landmarks = |frame: &usize| {
        let matched = MatchedLandmarks::new(state, photographs, *frame);
        let least = least(*frame);
        (matched.features >= least).then_some((matched, least))
    };
    let mut matched: Vec<(MatchedLandmarks, usize)> =
        frames.par_iter().filter_map(landmarks).collect();
    matched.sort_by_key(|(m, _)| (Reverse(m.features), m.frame));
    let mut best: Option<Localization> = None;
    for some in matched.chunks(LOCALIZED_AT_ONCE) {
        if best.as_ref().is_some_and(|best| some[0].0.features < best.agreeing.len()) {
            break;
        }
        let localized = |(matched, least): &(MatchedLandmarks, usize)| {
            localize(state, photographs, matched).filter(|found| found.agreeing.len() >= *least)
        };
        let found: Vec<Option<Localization>> = some.par_iter().map(localized).collect();
        let acceptable = found.into_iter().flatten().filter(&is_acceptable);
        best = best
            .into_iter()
            .chain(acceptable)
            .max_by_key(|found| (found.agreeing.len(), Reverse(found.frame)));
    }
    best
}

/// Number of landmarks determined by others that a registered photograph agrees with.
fn support(state: &SfmState, frame: usize) -> usize {
    let is_supporting = |(track, o): &(usize, &Observation)| {
        !o.is_outlier && is_determined_without(state, *track, frame)
    };
    state.observations_in(frame).filter(is_supporting).count()
}

/// True if a registered photograph is localised with another rotation than it has.
fn is_turned(state: &SfmState, found: &Localization) -> bool {
    let turn = |pose: Pose<f64>| pose.local(found.world_from_camera).rotation.norm();
    state.poses[found.frame].is_some_and(|pose| turn(pose) > MIN_CORRECTION)
}

/// True if a track has a landmark that two photographs other than one determine.
fn is_determined_without(state: &SfmState, track: usize, frame: usize) -> bool {
    let others = state.adjusted_inliers(track).filter(|o| o.frame != frame);
    let mut posed = others.filter(|o| state.poses[o.frame].is_some());
    state.landmarks[track].is_some() && posed.nth(1).is_some()
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
        forget_observations(state, found);
    }
    state.poses[frame] = Some(found.world_from_camera);
    let MatchedPhotographs { pairs, features, .. } = photographs;
    for &(own, track) in &found.agreeing {
        let is_free = state.tracks.tracks[track].observation_in(frame).is_none();
        let feature = features.get_mut(&frame).and_then(|all| all.get_mut(own));
        if let Some(feature) = feature.filter(|_| is_free) {
            feature.track = Some(track);
            let observation = observation(state, frame, feature);
            state.add_observations(vec![(track, observation)]);
        }
    }
    for (pair, other) in pairs_of(pairs, frame) {
        for (own, theirs) in matches_of(pair, frame) {
            let (here, there) = (features[&frame][own], features[&other][theirs]);
            let is_new = here.track.is_none() && there.track.is_none();
            let pair = [observation(state, frame, &here), observation(state, other, &there)];
            if !is_new || !agrees(state, &pair) {
                continue;
            }
            let mut observations = pair.to_vec();
            observations.sort_by_key(|o| o.frame);
            let track = Some(state.landmarks.len());
            state.add_track(Track { observations });
            for (frame, feature) in [(frame, own), (other, theirs)] {
                let feature = features.get_mut(&frame).and_then(|all| all.get_mut(feature));
                feature.into_iter().for_each(|feature| feature.track = track);
            }
        }
    }
    read_depth(state);
    frame
}

/// Takes observations at a pose that was wrong for outliers, and drops landmarks that rest on them.
fn forget_observations(state: &mut SfmState, found: &Localization) {
    let kept: BTreeSet<usize> = found.agreeing.iter().map(|(_, track)| *track).collect();
    for track in Arc::clone(&state.by_frame)[found.frame].iter().filter(|t| !kept.contains(t)) {
        let observation = state.tracks.tracks[*track].observation_in_mut(found.frame);
        observation.into_iter().for_each(|o| o.is_outlier = true);
        if !is_determined_without(state, *track, found.frame) {
            state.landmarks[*track] = None;
        }
    }
}

/// The observation that a feature is, without lens distortion.
fn observation(state: &SfmState, frame: usize, feature: &PhotographFeature) -> Observation {
    let raw = Observation::new(frame, feature.at, position_sigma(&state.camera));
    raw.moved_to(undistort(&state.camera, state.distortion, feature.at))
}

/// True if observations of two posed photographs may be of one point.
fn agrees(state: &SfmState, [a, b]: &[Observation; 2]) -> bool {
    let (Some(from), Some(to)) = (state.poses[a.frame], state.poses[b.frame]) else { return false };
    let ray = |o: &Observation| state.camera.unproject(o.at()[0], o.at()[1], 1.0);
    let off = sampson(&(to.inverse() * from), &(ray(a), ray(b))).abs() * state.camera.fx;
    off < max_epipolar_distance(&state.camera)
}

/// The pose of a photograph by its matches with landmarks.
fn localize(
    state: &SfmState,
    photographs: &MatchedPhotographs,
    matched: &MatchedLandmarks,
) -> Option<Localization> {
    if state.progress.is_cancelled() {
        return None;
    }
    let frame = matched.frame;
    let of = |feature| observation(state, frame, feature);
    let observations: Vec<Observation> = photographs.features[&frame].iter().map(of).collect();
    let candidate = |&(own, track): &(usize, usize)| {
        let landmark = state.landmarks[track].as_ref()?;
        Some(Candidate { own, track, landmark, observation: &observations[own] })
    };
    let candidates: Vec<Candidate<'_>> = matched.shown.iter().filter_map(candidate).collect();
    let by_samples = pose_by_samples(state, &matched.by_shared, &candidates);
    let verified =
        pairs_of(&photographs.pairs, frame).filter(|(p, _)| p.second_from_first.is_some());
    let rank = |(_, other): &(_, usize)| matched.by_shared.iter().position(|o| o == other);
    let mut pairs: Vec<(&PhotographPair, usize)> =
        verified.filter(|pair| rank(pair).is_some()).collect();
    pairs.sort_by_key(rank);
    let by_pairs = pairs
        .into_iter()
        .take(MAX_PAIRS)
        .filter_map(|pair| pose_by_pair(state, frame, pair, &candidates));
    let (world_from_camera, agreeing) =
        by_pairs.chain(by_samples).max_by_key(|(_, agreeing)| agreeing.len())?;
    let agreeing = agreeing.iter().map(|c| (c.own, c.track)).collect();
    Some(Localization { frame, world_from_camera, agreeing })
}

impl MatchedLandmarks {
    fn new(state: &SfmState, photographs: &MatchedPhotographs, frame: usize) -> Self {
        let (mut shown, mut shared) = (BTreeSet::new(), BTreeMap::<usize, usize>::new());
        for (pair, other) in pairs_of(&photographs.pairs, frame) {
            if state.poses[other].is_none() {
                continue;
            }
            for (own, theirs) in matches_of(pair, frame) {
                let track = photographs.features[&other][theirs].track;
                if let Some(track) = track.filter(|t| is_determined_without(state, *t, frame)) {
                    *shared.entry(other).or_default() += 1;
                    shown.insert((own, track));
                }
            }
        }
        let shown: Vec<(usize, usize)> = shown.into_iter().collect();
        let mut by_shared: Vec<usize> = shared.keys().copied().collect();
        by_shared.sort_by_key(|other| Reverse((shared[other], *other)));
        let features = shown.chunk_by(|a, b| a.0 == b.0).count();
        Self { frame, shown, features, by_shared }
    }
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

/// The pose that random samples of the candidates give, from those of the registered photographs that share
/// most of them, and the candidates that agree.
fn pose_by_samples<'a>(
    state: &SfmState,
    by_shared: &[usize],
    candidates: &[Candidate<'a>],
) -> Option<(Pose<f64>, Vec<Candidate<'a>>)> {
    let starts: Vec<Pose<f64>> =
        by_shared.iter().take(MAX_STARTS).filter_map(|other| state.poses[*other]).collect();
    let (pose, _) = pose_of_samples(&state.camera, &starts, &matches(candidates), HYPOTHESES)?;
    let (pose, agreeing) = refined(&state.camera, pose, candidates);
    let chances = vec![chance_of_place(&state.camera); agreeing.len()];
    let is_enough = agreeing.len() >= MIN_UNVERIFIED_INLIERS;
    (is_enough && is_no_chance(candidates.len(), SAMPLE_SIZE, &chances)).then_some((pose, agreeing))
}

/// The pose of a photograph by its relative pose to a registered one, as far away as most candidates ask,
/// and those that agree.
fn pose_by_pair<'a>(
    state: &SfmState,
    frame: usize,
    (pair, other): (&PhotographPair, usize),
    candidates: &[Candidate<'a>],
) -> Option<(Pose<f64>, Vec<Candidate<'a>>)> {
    let camera = &state.camera;
    let relative = pair.second_from_first?;
    let relative = if pair.second == frame { relative } else { relative.inverse() };
    let world_from_other = state.poses[other]?;
    let at_length = |c: &Candidate<'_>| {
        let length = baseline_length(camera, relative, world_from_other.inverse(), c);
        let moved = Pose::new(relative.rotation, relative.translation * length);
        (length > 0.0).then(|| world_from_other * moved.inverse())
    };
    let count = candidates.len().min(MAX_LENGTHS);
    let evenly = (0..count).map(|i| &candidates[i * candidates.len() / count]);
    let tried = evenly.filter_map(at_length);
    let pose = tried.max_by_key(|pose| agreeing(camera, pose, candidates).len())?;
    let (pose, agreeing) = refined(camera, pose, candidates);
    // What the other one shows lies on its epipolar line already.
    let chance =
        |c: &Candidate<'_>| match state.tracks.tracks[c.track].observation_in(other).is_some() {
            true => chance_on_line(camera),
            false => chance_of_place(camera),
        };
    let chances: Vec<f64> = agreeing.iter().map(chance).collect();
    let is_known = agreeing.len() >= MIN_INLIERS
        && is_no_chance(candidates.len(), SAMPLE_SIZE_OF_LENGTH, &chances);
    is_known.then_some((pose, agreeing))
}

fn matches<'a>(candidates: &[Candidate<'a>]) -> Vec<Match<'a>> {
    candidates.iter().map(|c| (c.landmark, c.observation)).collect()
}

/// A pose adjusted to the candidates that agree as long as more do then, and those that agree.
fn refined<'a>(
    camera: &Camera<f64>,
    mut pose: Pose<f64>,
    candidates: &[Candidate<'a>],
) -> (Pose<f64>, Vec<Candidate<'a>>) {
    let mut most = agreeing(camera, &pose, candidates);
    for _ in 0..MAX_REFINEMENTS {
        let adjusted = refine_pnp(camera, pose, &matches(&most), LOSS_WIDTH);
        let now = agreeing(camera, &adjusted, candidates);
        if now.len() < most.len() {
            break;
        }
        let is_stable = now.len() == most.len();
        (pose, most) = (adjusted, now);
        if is_stable {
            break;
        }
    }
    (pose, most)
}

/// Candidates that agree with a pose, one of each feature.
fn agreeing<'a>(
    camera: &Camera<f64>,
    pose: &Pose<f64>,
    candidates: &[Candidate<'a>],
) -> Vec<Candidate<'a>> {
    let error = |c: &Candidate<'_>| reprojection_error(camera, pose, &(c.landmark, c.observation));
    // Candidates are in the order of their features.
    let of_feature = candidates.chunk_by(|a, b| a.own == b.own).filter_map(|all| {
        let nearest = all.iter().min_by(|a, b| error(a).total_cmp(&error(b)))?;
        (error(nearest) < MAX_ERROR).then_some(*nearest)
    });
    of_feature.collect()
}

/// Length of the baseline between two pictures, whose direction `camera_from_other` gives, that a candidate
/// asks for.
fn baseline_length(
    camera: &Camera<f64>,
    camera_from_other: Pose<f64>,
    other_from_world: Pose<f64>,
    candidate: &Candidate<'_>,
) -> f64 {
    // The ray r through the observation meets R x + s t.
    let at = candidate.observation.at();
    let ray = camera.unproject(at[0], at[1], 1.0);
    let point = other_from_world * candidate.landmark.position();
    let along = ray.cross(camera_from_other.rotation.rotate(point));
    let moved = ray.cross(camera_from_other.translation);
    -moved.dot(along) / moved.norm_squared().max(1e-12)
}

/// Share of the picture within which a candidate agrees.
fn chance_of_place(camera: &Camera<f64>) -> f64 {
    let radius = MAX_ERROR * position_sigma(camera);
    std::f64::consts::PI * radius * radius / (camera.width * camera.height) as f64
}

/// Share of a line across the picture within which a candidate agrees.
fn chance_on_line(camera: &Camera<f64>) -> f64 {
    2.0 * MAX_ERROR * position_sigma(camera) / (camera.width as f64).hypot(camera.height as f64)
}

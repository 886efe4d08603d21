//! Geometric verification of the matches of two pictures: the relative pose that most agree on, and
//! whether so many would by chance.

use super::aliked::{Features, feature_pixel};
use super::matching::{FeatureMatch, Matches, match_features};
use crate::multiview::a_contrario::is_no_chance;
use crate::multiview::robust_loss::cauchy;
use crate::multiview::two_view::{
    RayPair, orbit_poses, ray_pairs, refine_relative_pose, resolve_cheirality, sampson,
};
use i2slam_compute::Random;
use i2slam_geometry::{Camera, Pose};
use std::collections::BTreeSet;

/// Deviation of the position of a feature in motion-blurred pictures [px of the larger picture that it is
/// found in].
const POSITION_SIGMA: f64 = 2.0;
/// Hypotheses of RANSAC, and matches of each.
const HYPOTHESES: usize = 2000;
const SAMPLE_SIZE: usize = 5;
/// Steps from one start, and of the final pose.
const SAMPLE_STEPS: usize = 8;
const FINAL_STEPS: usize = 15;
/// Distance of a match that agrees from its epipolar lines, at most [px of the larger picture that it is
/// found in].
const MAX_EPIPOLAR_DISTANCE: f64 = 2.0;
/// Distance within which matches of both sizes of the pictures are one, likewise.
const MIN_SEPARATION: f64 = 4.0;
/// Places at which matches must agree.
const MIN_INLIERS: usize = 12;

/// Deviation of the position of a feature in the pictures of a camera [px].
pub(crate) fn position_sigma(camera: &Camera<f64>) -> f64 {
    POSITION_SIGMA * feature_pixel(camera.width, camera.height)
}

/// Distance of a match that agrees from its epipolar lines in the pictures of a camera, at most [px].
pub(crate) fn max_epipolar_distance(camera: &Camera<f64>) -> f64 {
    MAX_EPIPOLAR_DISTANCE * feature_pixel(camera.width, camera.height)
}

/// The relative pose of two pictures that show the same scene, and the matches that agree on it.
#[derive(Clone, Debug)]
pub(super) struct VerifiedPair {
    /// Rotation and direction of the translation.
    pub(super) second_from_first: Pose<f64>,
    pub(super) matches: Vec<FeatureMatch>,
}

/// Matches of two pictures.
#[derive(Clone, Debug)]
pub(super) struct MatchedPair {
    /// All of them.
    pub(super) distinct: Vec<FeatureMatch>,
    /// Those that agree on a relative pose, unless that may be chance.
    pub(super) verified: Option<VerifiedPair>,
}

/// Matches the features of two pictures, and verifies them by a relative pose, which is searched from an
/// `approximate` one where there is one.
pub(super) fn match_pair(
    camera: &Camera<f64>,
    features: [&Features; 2],
    approximate: Option<Pose<f64>>,
) -> MatchedPair {
    let matches = match_features(features[0], features[1]);
    let verified = verify(camera, features, &matches, approximate);
    MatchedPair { distinct: matches.distinct, verified }
}

impl MatchedPair {
    /// Distances of the verified matches from the epipolar lines of another relative pose [px].
    pub(super) fn distances_from(
        &self,
        camera: &Camera<f64>,
        features: [&Features; 2],
        second_from_first: &Pose<f64>,
    ) -> Vec<f64> {
        let Some(verified) = &self.verified else { return Vec::new() };
        let pairs = rays(camera, features, &verified.matches);
        pairs.iter().map(|rays| error(camera, second_from_first, rays)).collect()
    }

    /// Leaves out matches that lie farther than so many pixels from the epipolar lines of another relative
    /// pose; too few that are left verify nothing.
    pub(super) fn keep_near(
        &mut self,
        camera: &Camera<f64>,
        features: [&Features; 2],
        (second_from_first, max_distance): (&Pose<f64>, f64),
    ) {
        let keep = |matches: &mut Vec<FeatureMatch>| {
            let pairs = rays(camera, features, matches);
            let near = |(m, rays): (&FeatureMatch, &RayPair)| {
                (error(camera, second_from_first, rays) < max_distance).then_some(*m)
            };
            *matches = matches.iter().zip(&pairs).filter_map(near).collect();
        };
        keep(&mut self.distinct);
        let verified = self.verified.take().map(|mut verified| {
            keep(&mut verified.matches);
            verified
        });
        self.verified =
            verified.filter(|pair| distinct_places(features, &pair.matches) >= MIN_INLIERS);
    }
}

fn verify(
    camera: &Camera<f64>,
    features: [&Features; 2],
    Matches { distinct: matches, second_best }: &Matches,
    approximate: Option<Pose<f64>>,
) -> Option<VerifiedPair> {
    let pose = relative_pose(camera, features, matches, approximate)?;
    let pairs = rays(camera, features, matches);
    let agreeing = |(_, rays): &(&FeatureMatch, &RayPair)| {
        error(camera, &pose, rays) < max_epipolar_distance(camera)
    };
    let inliers: Vec<FeatureMatch> =
        matches.iter().zip(&pairs).filter(agreeing).map(|(m, _)| *m).collect();
    let chance = chance_of_agreement(camera, &pose, features, second_best);
    let [all, agreeing] = [matches, &inliers].map(|m| distinct_places(features, m));
    if agreeing < MIN_INLIERS || !is_no_chance(all, SAMPLE_SIZE, &vec![chance; agreeing]) {
        return None;
    }
    let second_from_first = refined_pose(camera, features, pose, &inliers)?;
    Some(VerifiedPair { second_from_first, matches: inliers })
}

/// The relative pose of least truncated cost, searched from an approximate one where there is one.
fn relative_pose(
    camera: &Camera<f64>,
    features: [&Features; 2],
    matches: &[FeatureMatch],
    approximate: Option<Pose<f64>>,
) -> Option<Pose<f64>> {
    if matches.len() < MIN_INLIERS {
        return None;
    }
    let pairs = rays(camera, features, matches);
    let mut orbit = orbit_poses(&pairs);
    let approximate = approximate.and_then(with_unit_baseline);
    let mut start = |random: &mut Random| approximate.unwrap_or_else(|| orbit(random));
    let mut random = Random::new(matches.len() as u64);
    let mut best: Option<(f64, Pose<f64>)> = None;
    for hypothesis in 0..HYPOTHESES {
        // The most distinctive matches first, all of them in the end (PROSAC; Chum and Matas 2005).
        let among = matches.len() * (hypothesis + HYPOTHESES / 10) / HYPOTHESES;
        let among = among.clamp(MIN_INLIERS, matches.len());
        let chosen = random.distinct_below(among, SAMPLE_SIZE);
        let sample: Vec<RayPair> = chosen.iter().map(|i| pairs[*i]).collect();
        let Some(found) = refine_relative_pose(&sample, start(&mut random), SAMPLE_STEPS, |_| 1.0)
        else {
            continue;
        };
        let off =
            |rays: &RayPair| error(camera, &found, rays).min(max_epipolar_distance(camera)).powi(2);
        let cost: f64 = pairs.iter().map(off).sum();
        if best.is_none_or(|(least, _)| cost < least) {
            best = Some((cost, found));
        }
    }
    let pose = best?.1;
    let is_near = |(_, rays): &(&FeatureMatch, &RayPair)| {
        error(camera, &pose, rays) < max_epipolar_distance(camera)
    };
    let near: Vec<FeatureMatch> =
        matches.iter().zip(&pairs).filter(is_near).map(|(m, _)| *m).collect();
    refined_pose(camera, features, pose, &near)
}

/// The pose with a translation of length 1, unless it is none.
fn with_unit_baseline(pose: Pose<f64>) -> Option<Pose<f64>> {
    let length = Some(pose.translation.norm()).filter(|length| *length > 0.0)?;
    Some(Pose { translation: pose.translation * length.recip(), ..pose })
}

/// The pose of least robust cost over verified matches, from `start` on.
fn refined_pose(
    camera: &Camera<f64>,
    features: [&Features; 2],
    start: Pose<f64>,
    matches: &[FeatureMatch],
) -> Option<Pose<f64>> {
    let pairs = rays(camera, features, matches);
    let weight = |r: f64| cauchy(r * camera.fx, position_sigma(camera)).0;
    let refined = refine_relative_pose(&pairs, start, FINAL_STEPS, weight)?;
    Some(resolve_cheirality(camera.fx, &pairs, refined).second_from_first)
}

fn rays(camera: &Camera<f64>, [first, second]: [&Features; 2], m: &[FeatureMatch]) -> Vec<RayPair> {
    let positions: Vec<([f64; 2], [f64; 2])> =
        m.iter().map(|m| (first.positions[m.first], second.positions[m.second])).collect();
    ray_pairs(camera, &positions)
}

/// Epipolar distance [px]: that of Sampson, which divides by the gradient in both pictures.
fn error(camera: &Camera<f64>, pose: &Pose<f64>, rays: &RayPair) -> f64 {
    sampson(pose, rays).abs() * camera.fx
}

/// Number of places in both pictures that matches show: a point may match in both sizes.
fn distinct_places([first, second]: [&Features; 2], matches: &[FeatureMatch]) -> usize {
    let cell = |at: [f64; 2]| at.map(|v| (v / (first.pixel * MIN_SEPARATION)) as usize);
    let place =
        |m: &FeatureMatch| (cell(first.positions[m.first]), cell(second.positions[m.second]));
    matches.iter().map(place).collect::<BTreeSet<_>>().len()
}

/// Share of features that agree with a relative pose though they match something else: what looks alike
/// agrees more often than random features, as it tends to lie at the same height.
fn chance_of_agreement(
    camera: &Camera<f64>,
    pose: &Pose<f64>,
    [first, second]: [&Features; 2],
    second_best: &[(usize, usize)],
) -> f64 {
    let positions: Vec<([f64; 2], [f64; 2])> =
        second_best.iter().map(|(a, b)| (first.positions[*a], second.positions[*b])).collect();
    let pairs = ray_pairs(camera, &positions);
    let agreeing = pairs
        .iter()
        .filter(|rays| error(camera, pose, rays) < max_epipolar_distance(camera))
        .count();
    (agreeing + 1) as f64 / (pairs.len() + 1) as f64
}

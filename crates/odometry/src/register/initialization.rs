//! The first two poses.

use crate::error::OdometryError;
use crate::multiview::triangulation::parallax;
use crate::multiview::two_view::{TwoView, essential, rays, rotation_only};
use crate::sfm_state::Scene;
use i2slam_compute::median;
use i2slam_geometry::{Pose, Rotation};
use rayon::prelude::*;
use std::ops::Range;

/// Keyframes between the two of a pair, at most.
const MAX_KEYFRAME_GAP: usize = 12;
/// Pairs that are tried.
const TRIED: usize = 12;
/// Points that a pair must share.
const MIN_SHARED: usize = 40;
/// Share of a pair's points that must fit.
const MIN_SHARE: f64 = 0.6;
/// What a rotation must leave unexplained for a camera to have moved, over the focal length: a
/// pixel at 250.
const MIN_PARALLAX: f64 = 0.004;
/// More than this makes a pair no better, over the focal length.
const ENOUGH_PARALLAX: f64 = 0.06;
/// Median motion below which a camera stands still, over the picture's width.
const STILL: f64 = 0.005;
/// Landmarks with an angle of at least so much [rad] that a pair must give.
const MIN_LANDMARKS: usize = 20;
const MIN_ANGLE: f64 = 0.01;

/// A pair of keyframes and what a rotation leaves unexplained between them.
#[derive(Clone, Copy, Debug)]
struct Pair {
    first: usize,
    second: usize,
    shared: usize,
    rotation: Rotation<f64>,
    /// [px]
    left: f64,
    /// Median motion [px].
    motion: f64,
}

/// Poses two keyframes of a scene without poses, and triangulates what they share.
pub(crate) fn start(scene: &mut Scene) -> Result<(), OdometryError> {
    start_within(scene, 0..scene.tracks.keyframes.len())
}

/// The same with two of some keyframes.
pub(crate) fn start_within(scene: &mut Scene, places: Range<usize>) -> Result<(), OdometryError> {
    let pairs = pairs(scene, places);
    let enough = ENOUGH_PARALLAX * scene.camera.fx;
    let worth = |p: &Pair| p.left.min(enough) * (p.shared as f64).sqrt();
    let moved: Vec<Pair> = {
        let least = MIN_PARALLAX * scene.camera.fx;
        let mut moved: Vec<Pair> = pairs.iter().filter(|p| p.left > least).copied().collect();
        moved.sort_by(|a, b| worth(b).total_cmp(&worth(a)));
        moved.truncate(TRIED);
        moved
    };
    if moved.is_empty() {
        return Err(why_none(scene, &pairs));
    }
    let tried: Vec<Option<TwoView>> = moved
        .par_iter()
        .map(|p| match scene.progress.is_cancelled() {
            true => None,
            false => essential(scene.camera.fx, &shared_rays(scene, p), p.rotation),
        })
        .collect();
    let mut candidates: Vec<(&Pair, TwoView)> = moved
        .iter()
        .zip(tried)
        .filter_map(|(p, t)| Some((p, t.filter(|t| t.share >= MIN_SHARE)?)))
        .collect();
    let score = |(p, t): &(&Pair, TwoView)| t.share * t.share * worth(p);
    candidates.sort_by(|a, b| score(b).total_cmp(&score(a)));
    for (pair, view) in candidates {
        if scene.progress.is_cancelled() {
            break;
        }
        if pose_pair(scene, pair, view) >= MIN_LANDMARKS {
            return Ok(());
        }
        scene.forget();
    }
    Err(OdometryError::NoConsistentMotion)
}

/// All pairs of some keyframes that share enough points.
fn pairs(scene: &Scene, places: Range<usize>) -> Vec<Pair> {
    let keyframes = &scene.tracks.keyframes[places];
    let indices: Vec<(usize, usize)> = (0..keyframes.len())
        .flat_map(|i| (i + 1..(i + 1 + MAX_KEYFRAME_GAP).min(keyframes.len())).map(move |j| (i, j)))
        .collect();
    indices
        .par_iter()
        .filter_map(|&(i, j)| {
            let (first, second) = (keyframes[i], keyframes[j]);
            let shared = scene.shared(first, second);
            if shared.len() < MIN_SHARED || scene.progress.is_cancelled() {
                return None;
            }
            let (rotation, left) = rotation_only(scene.camera.fx, &rays(&scene.camera, &shared))?;
            let length = |(a, b): &([f64; 2], [f64; 2])| (a[0] - b[0]).hypot(a[1] - b[1]);
            let motion = median(&mut shared.iter().map(length).collect::<Vec<_>>())?;
            Some(Pair { first, second, shared: shared.len(), rotation, left, motion })
        })
        .collect()
}

fn shared_rays(scene: &Scene, pair: &Pair) -> Vec<crate::multiview::two_view::RayPair> {
    rays(&scene.camera, &scene.shared(pair.first, pair.second))
}

/// Poses a pair, adjusts both views; returns how many landmarks have a good angle.
fn pose_pair(scene: &mut Scene, pair: &Pair, view: TwoView) -> usize {
    scene.poses[pair.first] = Some(Pose::identity());
    scene.poses[pair.second] = Some(view.second_from_first.inverse());
    scene.add_landmarks();
    scene.adjust(&[pair.second], false, 20);
    scene.measure_noise();
    scene.mark_wrong_sights();
    let wide = scene.landmarks.iter().flatten().filter(|landmark| {
        landmark.values[2] > 0.0
            && parallax(landmark, scene.poses.iter().flatten().copied()) > MIN_ANGLE
    });
    wide.count()
}

/// Why no pair shows a motion.
fn why_none(scene: &Scene, pairs: &[Pair]) -> OdometryError {
    let most = |f: fn(&Pair) -> f64| pairs.iter().map(f).fold(0.0, f64::max);
    if pairs.is_empty() {
        return OdometryError::TooFewPoints;
    }
    let motion = most(|p| p.motion);
    if motion < STILL * scene.camera.width as f64 {
        return OdometryError::StillCamera { motion };
    }
    OdometryError::RotationOnly { left: most(|p| p.left) }
}

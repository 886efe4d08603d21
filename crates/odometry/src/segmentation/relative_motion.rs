//! Points of two pictures that do not move with most of the picture.
//!
//! Where points have measured depth in one of the pictures, the motion is a rigid one, and errors are
//! those of reprojection; elsewhere it is an essential matrix, and errors are distances from
//! epipolar lines, in which a motion along those lines does not show.

use crate::multiview::landmark::{
    Landmark, MAP_SIGMA, MAX_INLIER_ERROR, Match, registration_error,
};
use crate::multiview::pnp::{refine_pnp, solve_pnp_minimal};
use crate::multiview::robust_loss::cauchy;
use crate::multiview::two_view::{
    RayPair, fit_rotation, random_direction, ray_pairs, refine_relative_pose, sampson,
};
use crate::segmentation::least_median::AreaWeights;
use crate::track::tracks::Observation;
use i2slam_geometry::{Camera, Pose};

/// Hypotheses, and points of each: with two thirds of the points in the picture's motion, one in
/// five samples of four holds no other, one in eight of five.
const RIGID_HYPOTHESES: (usize, usize) = (60, 4);
const EPIPOLAR_HYPOTHESES: (usize, usize) = (100, 5);
/// Points that two pictures must share.
const MIN_SHARED: usize = 24;
/// Share of the area of shared points in which some must have depth, for a rigid motion: an object
/// over a fifth of the picture stays well below half of it.
const MIN_MEASURED_AREA: f64 = 0.75;
/// Least deviation of errors, as a ratio of the claimed one: points that slide along an
/// edge err by more, and together. Distances from epipolar lines show a part of the motion alone.
const MIN_RIGID_DEVIATION: f64 = 2.0;
const MIN_EPIPOLAR_DEVIATION: f64 = 0.7;
/// Width of the loss that refines a motion [deviations of the errors].
const REFINEMENT_WIDTH: f64 = 2.0;
/// Increase of the median error up to which a refined motion is preferred.
const MAX_MEDIAN_INCREASE: f64 = 1.05;

/// A point's observations in both pictures.
pub(crate) type SharedPoint<'a> = (&'a Observation, &'a Observation);

/// For each shared point whether it deviates from the motion of most of the picture, `None` where
/// that is not known; empty for too few points.
pub(crate) fn deviating_points(
    camera: &Camera<f64>,
    shared: &[SharedPoint<'_>],
) -> Vec<Option<bool>> {
    let swapped: Vec<SharedPoint<'_>> = shared.iter().map(|(a, b)| (*b, *a)).collect();
    let measured = |points: &[SharedPoint<'_>]| -> Vec<usize> {
        (0..points.len()).filter(|i| points[*i].0.depth().is_some()).collect()
    };
    let (forward, backward) = (measured(shared), measured(&swapped));
    let (points, places) =
        if backward.len() > forward.len() { (&swapped[..], backward) } else { (shared, forward) };
    let area = |places: &mut dyn Iterator<Item = usize>| {
        AreaWeights::new(camera, &places.map(|i| shared[i].1.at()).collect::<Vec<_>>()).area()
            as f64
    };
    let all = area(&mut (0..shared.len()));
    let is_rigid =
        places.len() >= MIN_SHARED && area(&mut places.iter().copied()) >= MIN_MEASURED_AREA * all;
    let (places, errors) = if is_rigid {
        let some: Vec<SharedPoint<'_>> = places.iter().map(|i| points[*i]).collect();
        (places, rigid_errors(camera, &some))
    } else {
        ((0..shared.len()).collect(), epipolar_errors(camera, shared))
    };
    let Some((errors, deviation)) = errors else { return Vec::new() };
    let mut out = vec![None; shared.len()];
    for (place, error) in places.into_iter().zip(errors) {
        out[place] = Some(error > MAX_INLIER_ERROR * deviation);
    }
    out
}

/// Errors of points under a motion [deviations, with [`MAP_SIGMA`]], and their deviation by the median.
type Errors = (Vec<f64>, f64);

/// Reprojection errors under the rigid motion of most of the picture, of points with depth in the
/// first picture.
fn rigid_errors(camera: &Camera<f64>, shared: &[SharedPoint<'_>]) -> Option<Errors> {
    let landmark = |(first, _): &SharedPoint<'_>| {
        Some(Landmark::on_ray(camera, Pose::identity(), first.at(), first.depth()?.inverse))
    };
    let landmarks: Vec<Landmark> = shared.iter().map(landmark).collect::<Option<_>>()?;
    let matches: Vec<Match<'_>> =
        landmarks.iter().zip(shared).map(|(landmark, (_, second))| (landmark, *second)).collect();
    let errors = |pose: &Pose<f64>| -> Vec<f64> {
        matches.iter().map(|m| registration_error(camera, pose, m, 1.0)).collect()
    };
    let fit = |sample: &[usize]| {
        let some: Vec<Match<'_>> = sample.iter().map(|i| matches[*i]).collect();
        Some(solve_pnp_minimal(camera, Pose::identity(), &some)).filter(|pose| pose.is_finite())
    };
    let refine = |pose: Pose<f64>, width: f64| Some(refine_pnp(camera, pose, &matches, width));
    // The median length of a two-dimensional normal error.
    let usual = (2.0 * std::f64::consts::LN_2).sqrt();
    let positions: Vec<[f64; 2]> = shared.iter().map(|(_, second)| second.at()).collect();
    let weights = AreaWeights::new(camera, &positions);
    let best = weights.least_median(RIGID_HYPOTHESES, |sample, _| fit(sample), errors)?;
    Some(refined_errors(&weights, best, (usual, MIN_RIGID_DEVIATION), errors, refine))
}

/// Epipolar distances under the motion of most of the picture.
fn epipolar_errors(camera: &Camera<f64>, shared: &[SharedPoint<'_>]) -> Option<Errors> {
    if shared.len() < MIN_SHARED {
        return None;
    }
    let positions: Vec<_> =
        shared.iter().map(|(first, second)| (first.at(), second.at())).collect();
    let rays = ray_pairs(camera, &positions);
    let (rotation, _) = fit_rotation(camera.fx, &rays)?;
    let sigmas: Vec<f64> =
        shared.iter().map(|(a, b)| a.sigma().max(b.sigma()).hypot(MAP_SIGMA)).collect();
    let errors = |pose: &Pose<f64>| -> Vec<f64> {
        let error = |(pair, sigma): (&RayPair, &f64)| sampson(pose, pair).abs() * camera.fx / sigma;
        rays.iter().zip(&sigmas).map(error).collect()
    };
    let mean_sigma = sigmas.iter().sum::<f64>() / sigmas.len() as f64;
    let refine = |pose: Pose<f64>, width: f64| {
        let weight = |r: f64| cauchy(r.abs() * camera.fx / mean_sigma, width).0;
        refine_relative_pose(&rays, pose, 8, weight)
    };
    let second: Vec<[f64; 2]> = positions.iter().map(|(_, second)| *second).collect();
    let weights = AreaWeights::new(camera, &second);
    let fit = |sample: &[usize], random: &mut _| {
        let some: Vec<RayPair> = sample.iter().map(|i| rays[*i]).collect();
        refine_relative_pose(&some, Pose::new(rotation, random_direction(random)), 12, |_| 1.0)
    };
    let best = weights.least_median(EPIPOLAR_HYPOTHESES, fit, errors)?;
    // The median absolute value of a normal error.
    Some(refined_errors(&weights, best, (0.6745, MIN_EPIPOLAR_DEVIATION), errors, refine))
}

/// Errors under a motion refined on all points that it fits, where that keeps the median low.
fn refined_errors(
    weights: &AreaWeights,
    (motion, median): (Pose<f64>, f64),
    (usual, least): (f64, f64),
    errors: impl Fn(&Pose<f64>) -> Vec<f64>,
    refine: impl Fn(Pose<f64>, f64) -> Option<Pose<f64>>,
) -> Errors {
    let deviation = |median: f64| (median / usual).max(least);
    let before = errors(&motion);
    let Some(refined) = refine(motion, REFINEMENT_WIDTH * deviation(median)) else {
        return (before, deviation(median));
    };
    let after = errors(&refined);
    let now = weights.median(&after);
    match now <= MAX_MEDIAN_INCREASE * median {
        true => (after, deviation(now)),
        false => (before, deviation(median)),
    }
}

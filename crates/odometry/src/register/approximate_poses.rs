//! Registration of photographs whose poses are known approximately.
//!
//! Matches are verified near the given poses, landmarks triangulated, and all poses adjusted. How far most
//! poses move tells how exact the given ones are; with that deviation relative poses of neighbours count as
//! measurements, so that a photograph with few or wrong matches stays near its given place.

use crate::bundle::RelativePoseFactor;
use crate::features::POSITION_SIGMA;
use crate::features::collection::PhotoCollection;
use crate::multiview::landmark::Landmark;
use crate::progress::Stage;
use crate::register::photographs::with_matches;
use crate::register::registration::{adjust_globally, register_keyframes};
use crate::sfm_state::{MAX_NOISE_SCALE, SfmState};
use crate::track::tracks::Track;
use i2slam_compute::{median, solve_positive_definite};
use i2slam_geometry::{Mat3, Pose};
use std::sync::Arc;

/// Nearest photographs, and others, to which relative poses of each count.
const NEIGHBOURS: usize = 4;
const LINKS: usize = 2 * NEIGHBOURS;
/// Landmarks that photographs must share whose relative pose tells how exact the given ones are.
const MIN_SHARED: usize = 20;
/// Deviation of orientations at which the given poses are exact [rad].
const MIN_DEVIATION: f64 = 1e-5;
/// Rounds in which poses and their deviations are found in turn, and change of these at which they end.
const MAX_ROUNDS: usize = 12;
const SETTLED_CHANGE: f64 = 0.02;
/// Standard deviations over the median length of normally distributed coordinates.
const DEVIATION_OVER_MEDIAN: f64 = 1.4826;

/// Registers photographs from given poses, `world_from_camera` of every frame.
pub(crate) fn register_near(
    tracks: &SfmState,
    photographs: &PhotoCollection,
    given: &[Option<Pose<f64>>],
) -> SfmState {
    let mut state = with_matches(tracks.clone(), photographs, given);
    adjust_given_poses(&mut state, given);
    state
}

/// Poses all frames as given, adjusts them, and registers those without a given pose.
fn adjust_given_poses(state: &mut SfmState, given: &[Option<Pose<f64>>]) {
    state.poses = given.to_vec();
    state.progress.report(Stage::BundleAdjustment, 0, 0);
    triangulate_at_given_poses(state);
    let mut deviations = Some(first_deviations(state, given));
    for _ in 0..MAX_ROUNDS {
        // Given poses that agree with what pictures show come out as exact, and stay.
        let Some(known) = deviations else { break };
        state.relative_poses = Arc::new(relative_poses(given, known));
        adjust_globally(state, false);
        place_unsupported(state, given);
        if state.poses.contains(&None) {
            register_keyframes(state, false, usize::MAX);
        }
        deviations = found_deviations(state);
        let is_settled =
            |found: &[f64; 2]| (0..2).all(|i| (found[i] / known[i]).ln().abs() < SETTLED_CHANGE);
        if state.progress.is_cancelled() || deviations.as_ref().is_some_and(is_settled) {
            break;
        }
    }
}

/// Triangulates landmarks with as much tolerance as matches miss each other at the given poses.
pub(crate) fn triangulate_at_given_poses(state: &mut SfmState) {
    state.noise_scale = MAX_NOISE_SCALE;
    state.triangulate_missing();
    state.update_noise_scale();
    state.landmarks.fill(None);
    state.triangulate_missing();
}

/// Places photographs without a landmark by their given poses, relative to the nearest one with some.
fn place_unsupported(state: &mut SfmState, given: &[Option<Pose<f64>>]) {
    let is_shared = state.shared_landmarks();
    let is_supported = |frame: usize| {
        state.observations_in(frame).any(|(track, o)| is_shared[track] && !o.is_outlier)
    };
    let (supported, others): (Vec<usize>, Vec<usize>) =
        (0..given.len()).filter(|f| given[*f].is_some()).partition(|f| is_supported(*f));
    for frame in others {
        let near = nearest(given, frame, &supported).first().copied();
        let pose =
            near.and_then(|near| Some(state.poses[near]? * given[near]?.inverse() * given[frame]?));
        state.poses[frame] = pose.or(given[frame]);
    }
}

/// Of some frames those nearest to one, by their given places.
fn nearest(given: &[Option<Pose<f64>>], frame: usize, among: &[usize]) -> Vec<usize> {
    let distance = |other: &usize| match (given[frame], given[*other]) {
        (Some(a), Some(b)) => (a.translation - b.translation).norm(),
        _ => f64::INFINITY,
    };
    let mut near: Vec<usize> = among.iter().copied().filter(|other| *other != frame).collect();
    near.sort_by(|a, b| distance(a).total_cmp(&distance(b)));
    near
}

/// Standard deviations of given positions and orientations [rad], a coordinate, so large that they explain the
/// residuals of landmarks.
fn first_deviations(state: &SfmState, given: &[Option<Pose<f64>>]) -> [f64; 2] {
    let angle = state.noise_scale * POSITION_SIGMA / state.camera.fx;
    let depth = |(track, landmark): (&Track, &Option<Landmark>)| {
        let at = given[track.observations.first()?.frame]?;
        Some((landmark.as_ref()?.position() - at.translation).norm())
    };
    let depths = state.tracks.tracks.iter().zip(&state.landmarks).filter_map(depth);
    [angle * median(&mut depths.collect::<Vec<_>>()).unwrap_or(1.0), angle]
}

/// Standard deviations of given positions and orientations [rad], a coordinate, by distances and rotations
/// between photographs that show landmarks together; the adjusted ones count as exact. `None` where the given
/// ones are.
fn found_deviations(state: &SfmState) -> Option<[f64; 2]> {
    let (mut lengths, mut angles) = (Vec::new(), Vec::new());
    for &RelativePoseFactor { first, second, first_from_second: given, .. } in
        state.relative_poses.iter().filter(|f| state.shared_count(f.first, f.second) >= MIN_SHARED)
    {
        let (Some(a), Some(b)) = (state.poses[first], state.poses[second]) else { continue };
        let found = a.inverse() * b;
        lengths.push((found.translation.norm() - given.translation.norm()).abs());
        angles.extend(given.local(found).rotation.to_array().map(f64::abs));
    }
    let deviation = |all: &mut Vec<f64>| {
        let of_both = DEVIATION_OVER_MEDIAN * median(all)?;
        Some(of_both / 2_f64.sqrt())
    };
    let found = [deviation(&mut lengths)?, deviation(&mut angles)?];
    (found[0] > 0.0 && found[1] > MIN_DEVIATION).then_some(found)
}

/// The given poses relative to those of the nearest photographs, and of others from near to far, so that
/// errors do not add up from one to the next.
fn relative_poses(given: &[Option<Pose<f64>>], deviations: [f64; 2]) -> Vec<RelativePoseFactor> {
    let known: Vec<usize> = (0..given.len()).filter(|f| given[*f].is_some()).collect();
    let mut out = Vec::new();
    for &first in &known {
        let near = nearest(given, first, &known);
        let (nearest, others) = near.split_at(NEIGHBOURS.min(near.len()));
        let far = (1..=NEIGHBOURS)
            .filter_map(|i| others.get((i * others.len() / NEIGHBOURS).checked_sub(1)?));
        for &second in nearest.iter().chain(far) {
            let (Some(a), Some(b)) = (given[first], given[second]) else { continue };
            let first_from_second = a.inverse() * b;
            if let Some(information) = information_of_relative(first_from_second, deviations) {
                out.push(RelativePoseFactor { first, second, first_from_second, information });
            }
        }
    }
    out
}

/// Information of a relative pose of two with so many deviations, `Σ + J Σ Jᵀ` inverted: moving the first by
/// `(ρ, φ)` moves it by `R⁻¹ (t × φ - ρ)`, and turns it by `-R⁻¹ φ`. Each pose is in several of them, which
/// count once together.
fn information_of_relative(
    relative: Pose<f64>,
    [position, rotation]: [f64; 2],
) -> Option<[[f64; 6]; 6]> {
    let back = relative.rotation.matrix().transpose();
    let spin = back * Mat3::skew(relative.translation);
    let [position, rotation] = [position, rotation].map(|d| d * d * LINKS as f64);
    let mut covariance = [[0.0; 6]; 6];
    for row in 0..3 {
        covariance[row][row] = 2.0 * position;
        covariance[3 + row][3 + row] = 2.0 * rotation;
        for column in 0..3 {
            let dot = |a: &Mat3<f64>, b: &Mat3<f64>| {
                (0..3).map(|k| a.rows[row][k] * b.rows[column][k]).sum::<f64>()
            };
            covariance[row][column] += rotation * dot(&spin, &spin);
            covariance[row][3 + column] -= rotation * dot(&spin, &back);
            covariance[3 + row][column] -= rotation * dot(&back, &spin);
        }
    }
    let columns = (0..6).map(|column| {
        let (mut factor, mut unit) = (covariance.concat(), [0.0; 6]);
        unit[column] = 1.0;
        solve_positive_definite(&mut factor, &mut unit).then_some(unit)
    });
    columns.collect::<Option<Vec<_>>>()?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;
    use i2slam_check::noise;
    use i2slam_geometry::{Rotation, Tangent, Vec3};

    const FRAMES: usize = 24;

    /// A camera that moves along a wall, and turns to and fro.
    fn truth(frame: usize) -> Pose<f64> {
        let t = frame as f64;
        let turn = Rotation::exp(Vec3::new(0.05 * (0.9 * t).sin(), 0.1 * (0.5 * t).cos(), 0.0));
        Pose::new(turn, Vec3::new(0.2 * t, 0.1 * (0.7 * t).sin(), 0.05 * (0.4 * t).cos()))
    }

    /// True poses with errors of so much, standard deviations in position and orientation.
    fn disturbed([position, rotation]: [f64; 2]) -> Vec<Option<Pose<f64>>> {
        let pose = |frame: usize| {
            // Uniform numbers between -1 and 1 have a deviation of 3^(-1/2).
            let n = noise(500 + frame as u64, 6).into_iter().map(|n| 3_f64.sqrt() * n);
            let by: Vec<f64> =
                n.enumerate().map(|(i, n)| [position, rotation][i / 3] * n).collect();
            let off = Tangent {
                translation: Vec3::new(by[0], by[1], by[2]),
                rotation: Vec3::new(by[3], by[4], by[5]),
            };
            Some(truth(frame).retract(off))
        };
        (0..FRAMES).map(pose).collect()
    }

    /// Features off by up to `pixels`, without those of some frames.
    fn state(pixels: f64, is_shown: impl Fn(usize) -> bool) -> SfmState {
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = fixtures::camera().project(truth(frame).inverse() * point);
            let is_within = (0.0..320.0).contains(&u) && (0.0..240.0).contains(&v);
            (is_within && is_shown(frame)).then(|| [u + pixels * n[0], v + pixels * n[1]])
        };
        let mut state = fixtures::state((FRAMES, 30, 1), [150.0, 110.0], truth, observe);
        for o in state.tracks.tracks.iter_mut().flat_map(|track| &mut track.observations) {
            *o = crate::track::tracks::Observation::new(o.frame, o.at(), POSITION_SIGMA);
        }
        state.landmarks.fill(None);
        state
    }

    /// Root mean square error of the positions, the path moved to the truth.
    fn error(state: &SfmState) -> f64 {
        let pairs: Vec<(Pose<f64>, Pose<f64>)> =
            (0..FRAMES).map(|f| (state.poses[f].expect("posed"), truth(f))).collect();
        let by = crate::online::path_alignment::align_path(&pairs).expect("a path");
        let square = |(found, truth): &(Pose<f64>, Pose<f64>)| {
            (by.apply(found.translation) - truth.translation).norm_squared()
        };
        (pairs.iter().map(square).sum::<f64>() / FRAMES as f64).sqrt()
    }

    /// Errors of a few and of many pixels become those that features leave, and are estimated.
    #[test]
    fn given_poses_are_adjusted_to_what_pictures_show() {
        for errors in [[0.03, 0.012], [0.08, 0.03]] {
            let mut state = state(1.5, |_| true);
            adjust_given_poses(&mut state, &disturbed(errors));
            let share = error(&state) / (3_f64.sqrt() * errors[0]);
            assert!(share < 0.2, "{errors:?}: {share}");
            let found = found_deviations(&state).expect("not exact");
            let ratios = [found[0] / errors[0], found[1] / errors[1]];
            assert!(ratios.iter().all(|r| (0.6..1.4).contains(r)), "{errors:?}: {found:?}");
        }
    }

    /// Poses that features cannot improve stay about as exact as they are.
    #[test]
    fn poses_more_exact_than_features_stay() {
        for (deviations, worst) in [([0.0, 0.0], 5e-4), ([0.004, 0.002], 0.008)] {
            let mut state = state(3.0, |_| true);
            adjust_given_poses(&mut state, &disturbed(deviations));
            assert!(error(&state) < worst, "{deviations:?}: {}", error(&state));
        }
    }

    /// What no other picture shows stays in its place among the others.
    #[test]
    fn photographs_without_matches_keep_their_place() {
        let mut state = state(0.5, |frame| frame != 7);
        let mut given = disturbed([0.03, 0.01]);
        given[7] = Some(truth(7));
        adjust_given_poses(&mut state, &given);
        let off = |frame: usize| {
            let near = [frame - 1, frame];
            let [a, b] = near.map(|f| state.poses[f].expect("posed"));
            let due = truth(near[0]).inverse() * truth(near[1]);
            (a.inverse() * b).local(due).translation.norm()
        };
        assert!(
            off(5) < 0.01 && off(12) < 0.01 && off(7) < 0.1,
            "{} {} {}",
            off(5),
            off(12),
            off(7)
        );
    }

    /// Covariance of a relative pose by many disturbed pairs.
    #[test]
    fn relative_poses_are_as_exact_as_both_poses_make_them() {
        let deviations = [0.02, 0.01];
        let (first, second) = (truth(3), truth(9));
        let exact = first.inverse() * second;
        let information = information_of_relative(exact, deviations).expect("positive");
        let draws = 4000;
        let (mut sum, numbers) = (0.0, noise(8, 12 * draws));
        for n in numbers.chunks_exact(12) {
            let off = |n: &[f64]| {
                let of = |i: usize| deviations[i / 3] * 3_f64.sqrt() * n[i];
                Tangent::from_array(std::array::from_fn(of))
            };
            let found = first.retract(off(&n[..6])).inverse() * second.retract(off(&n[6..]));
            let e = exact.local(found).to_array();
            let row = |i: usize| (0..6).map(|j| information[i][j] * e[j]).sum::<f64>();
            sum += (0..6).map(|i| e[i] * row(i)).sum::<f64>() / draws as f64;
        }
        // Six degrees of freedom, which count once in all links of a pose.
        let due = 6.0 / LINKS as f64;
        assert!((sum / due - 1.0).abs() < 0.05, "{sum} {due}");
    }
}

//! Registration of photographs whose poses are known approximately.
//!
//! Matches are verified near the given poses, landmarks triangulated, and all poses adjusted. How far most
//! poses move tells how exact the given ones are; with that deviation relative poses of neighbours count as
//! measurements, so that a photograph with few or wrong matches stays near its given place.

use crate::bundle::RelativePoseFactor;
use crate::features::collection::PhotoCollection;
use crate::features::position_sigma;
use crate::multiview::landmark::Landmark;
use crate::progress::Stage;
use crate::register::photographs::with_matches;
use crate::register::registration::{adjust_globally, register_keyframes};
use crate::sfm_state::{MAX_NOISE_SCALE, SfmState};
use crate::track::tracks::Track;
use i2slam_compute::{SIGMA_PER_MEDIAN, median, solve_positive_definite};
use i2slam_geometry::{Mat3, Pose, Vec3};
use std::sync::Arc;

/// Nearest photographs, and others at most, to which relative poses of each count.
const NEIGHBOURS: usize = 4;
/// Landmarks that photographs must share whose relative pose tells how exact the given ones are.
const MIN_SHARED: usize = 20;
/// Pairs of photographs that tell how exact the given poses are, at least.
const MIN_PAIRS: usize = 3;
/// Deviation of orientations [rad], and of positions over the distance of landmarks, at which given poses are
/// exact.
const MIN_DEVIATION: f64 = 1e-5;
/// Rounds in which poses and their deviations are found in turn, and change of these at which they end.
const MAX_ROUNDS: usize = 12;
const SETTLED_CHANGE: f64 = 0.02;

/// Poses of so many frames, the median distance from their middle as unit of length.
pub(crate) fn in_unit_of_path(
    poses: &[Option<Pose<f64>>],
    frames: usize,
) -> Vec<Option<Pose<f64>>> {
    let at: Vec<Vec3<f64>> = poses.iter().flatten().map(|pose| pose.translation).collect();
    if at.is_empty() {
        return Vec::new();
    }
    let middle = at.iter().fold(Vec3::zero(), |sum, at| sum + *at) * (at.len() as f64).recip();
    let mut distances: Vec<f64> = at.iter().map(|at| (*at - middle).norm()).collect();
    let unit = median(&mut distances).filter(|distance| *distance > 0.0).unwrap_or(1.0);
    let scaled = |pose: Pose<f64>| Pose { translation: pose.translation * unit.recip(), ..pose };
    let all = poses.iter().map(|pose| pose.map(scaled));
    all.chain(std::iter::repeat(None)).take(frames).collect()
}

/// Registers photographs from given poses, `world_from_camera` of every frame; true if these are as exact as
/// pictures tell, and stay.
pub(crate) fn register_near(
    tracks: SfmState,
    photographs: &PhotoCollection,
    given: &[Option<Pose<f64>>],
) -> (SfmState, bool) {
    let mut state = with_matches(tracks, photographs, given);
    let stays = adjust_given_poses(&mut state, given);
    (state, stays)
}

/// Poses all frames as given, adjusts them, and registers those without a given pose; true if the given poses
/// stay.
fn adjust_given_poses(state: &mut SfmState, given: &[Option<Pose<f64>>]) -> bool {
    state.poses = given.to_vec();
    state.progress.report(Stage::BundleAdjustment, 0, 0);
    triangulate_at_given_poses(state);
    let mut deviations = first_deviations(state);
    for _ in 0..MAX_ROUNDS {
        state.relative_poses = Arc::new(relative_poses(given, deviations));
        adjust_globally(state, false);
        place_unsupported(state, given);
        if state.poses.contains(&None) {
            register_keyframes(state, false, usize::MAX);
        }
        let Some(found) = found_deviations(state).filter(|found| found != &least(state)) else {
            take_given_poses(state, given);
            return true;
        };
        let is_settled = (0..2).all(|i| (found[i] / deviations[i]).ln().abs() < SETTLED_CHANGE);
        deviations = found;
        if state.progress.is_cancelled() || is_settled {
            break;
        }
    }
    false
}

/// Poses all frames as given, and triangulates landmarks from there.
pub(crate) fn take_given_poses(state: &mut SfmState, given: &[Option<Pose<f64>>]) {
    state.reset();
    state.poses = given.to_vec();
    triangulate_at_given_poses(state);
    state.reject_outliers();
}

/// Triangulates landmarks with as much tolerance as matches miss each other at the given poses.
fn triangulate_at_given_poses(state: &mut SfmState) {
    state.noise_scale = MAX_NOISE_SCALE;
    state.triangulate_missing();
    state.update_noise_scale();
    state.landmarks.fill(None);
    state.triangulate_missing();
}

/// Places photographs without a landmark by their given poses, relative to the nearest one with some.
pub(crate) fn place_unsupported(state: &mut SfmState, given: &[Option<Pose<f64>>]) {
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
fn first_deviations(state: &SfmState) -> [f64; 2] {
    let angle = state.noise_scale * position_sigma(&state.camera) / state.camera.fx;
    [angle * median_distance(state), angle]
}

/// Deviations at which given poses are exact.
fn least(state: &SfmState) -> [f64; 2] {
    [MIN_DEVIATION * median_distance(state), MIN_DEVIATION]
}

/// Median distance of landmarks from the first photograph that shows each.
fn median_distance(state: &SfmState) -> f64 {
    let distance = |(track, landmark): (&Track, &Option<Landmark>)| {
        let at = state.poses[track.observations.first()?.frame]?;
        Some((landmark.as_ref()?.position() - at.translation).norm())
    };
    let distances = state.tracks.tracks.iter().zip(&state.landmarks).filter_map(distance);
    median(&mut distances.collect::<Vec<_>>()).unwrap_or(1.0)
}

/// Standard deviations of given positions and orientations [rad], a coordinate, by distances and rotations
/// between photographs that show landmarks together; the adjusted ones count as exact. `None` where too few
/// show some.
fn found_deviations(state: &SfmState) -> Option<[f64; 2]> {
    let (mut lengths, mut angles) = (Vec::new(), Vec::new());
    for &RelativePoseFactor { first, second, first_from_second: given, .. } in
        state.relative_poses.iter().filter(|f| shares_landmarks(state, [f.first, f.second]))
    {
        let (Some(a), Some(b)) = (state.poses[first], state.poses[second]) else { continue };
        let found = a.inverse() * b;
        lengths.push((found.translation.norm() - given.translation.norm()).abs());
        angles.extend(given.local(found).rotation.to_array().map(f64::abs));
    }
    if lengths.len() < MIN_PAIRS {
        return None;
    }
    let deviation = |all: &mut Vec<f64>, least: f64| {
        let of_both = SIGMA_PER_MEDIAN * median(all)?;
        Some((of_both / 2_f64.sqrt()).max(least))
    };
    let [position, rotation] = least(state);
    Some([deviation(&mut lengths, position)?, deviation(&mut angles, rotation)?])
}

/// True if two photographs show enough landmarks together.
fn shares_landmarks(state: &SfmState, [first, second]: [usize; 2]) -> bool {
    let is_inlier = |track: usize, frame: usize| {
        state.tracks.tracks[track].observation_in(frame).is_some_and(|o| !o.is_outlier)
    };
    let is_shared = |track: &&usize| {
        state.landmarks[**track].is_some()
            && is_inlier(**track, first)
            && is_inlier(**track, second)
    };
    state.by_frame[first].iter().filter(is_shared).count() >= MIN_SHARED
}

/// The given poses relative to those of the nearest photographs, and of others from near to far, so that
/// errors do not add up from one to the next.
fn relative_poses(given: &[Option<Pose<f64>>], deviations: [f64; 2]) -> Vec<RelativePoseFactor> {
    let known: Vec<usize> = (0..given.len()).filter(|f| given[*f].is_some()).collect();
    let mut out = Vec::new();
    for &first in &known {
        let linked = linked_to(given, first, &known);
        for &second in &linked {
            let (Some(a), Some(b)) = (given[first], given[second]) else { continue };
            let first_from_second = a.inverse() * b;
            let information = information_of_relative(first_from_second, deviations, linked.len());
            if let Some(information) = information {
                out.push(RelativePoseFactor { first, second, first_from_second, information });
            }
        }
    }
    out
}

/// The nearest photographs to one, and as many others, evenly from near to far.
fn linked_to(given: &[Option<Pose<f64>>], first: usize, known: &[usize]) -> Vec<usize> {
    let near = nearest(given, first, known);
    let (nearest, others) = near.split_at(NEIGHBOURS.min(near.len()));
    let count = NEIGHBOURS.min(others.len());
    let far = (1..=count).map(|i| others[i * others.len() / count - 1]);
    nearest.iter().copied().chain(far).collect()
}

/// Information of a relative pose of two with such deviations, `Σ + J Σ Jᵀ` inverted: moving the first by
/// `(ρ, φ)` moves it by `R⁻¹ (t × φ - ρ)`, and turns it by `-R⁻¹ φ`. Each pose is in so many
/// `links`, which count once together.
fn information_of_relative(
    relative: Pose<f64>,
    [position, rotation]: [f64; 2],
    links: usize,
) -> Option<[[f64; 6]; 6]> {
    let back = relative.rotation.matrix().transpose();
    let spin = back * Mat3::skew(relative.translation);
    let [position, rotation] = [position, rotation].map(|d| d * d * links as f64);
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
    use i2slam_geometry::{Rotation, Tangent};

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
        let sigma = position_sigma(&state.camera);
        for o in state.tracks.tracks.iter_mut().flat_map(|track| &mut track.observations) {
            *o = crate::track::tracks::Observation::new(o.frame, o.at(), sigma);
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
        for (deviations, worst) in [([0.0, 0.0], 1e-12), ([0.004, 0.002], 0.008)] {
            let mut state = state(3.0, |_| true);
            adjust_given_poses(&mut state, &disturbed(deviations));
            assert!(error(&state) < worst, "{deviations:?}: {}", error(&state));
        }
    }

    /// Orientations of a level say nothing of positions.
    #[test]
    fn wrong_positions_of_exact_orientations_are_adjusted() {
        let mut state = state(1.5, |_| true);
        assert!(!adjust_given_poses(&mut state, &disturbed([0.06, 0.0])));
        assert!(error(&state) < 0.3 * 3_f64.sqrt() * 0.06, "{}", error(&state));
    }

    /// Nothing that is seen together contradicts the given poses.
    #[test]
    fn given_poses_without_matches_stay() {
        let mut state = state(1.5, |frame| frame % 12 == 0);
        let given = disturbed([0.06, 0.02]);
        assert!(adjust_given_poses(&mut state, &given));
        assert_eq!(state.poses, given);
    }

    /// A photograph without matches keeps its place relative to the nearest one.
    #[test]
    fn photographs_without_matches_keep_their_place() {
        let mut state = state(0.5, |frame| frame != 7);
        let given = disturbed([0.03, 0.01]);
        adjust_given_poses(&mut state, &given);
        // Relative to the nearest one by the given poses, not where it was given.
        let posed = |frame: usize| state.poses[frame].expect("posed");
        let own = given[7].expect("given");
        let off = |near: usize| {
            let due = posed(near) * given[near].expect("given").inverse() * own;
            due.local(posed(7)).translation.norm()
        };
        assert!(off(6).min(off(8)) < 1e-9, "{} {}", off(6), off(8));
        assert!(own.local(posed(7)).translation.norm() > 1e-3);
    }

    /// Covariance of a relative pose by many disturbed pairs.
    #[test]
    fn relative_poses_are_as_exact_as_both_poses_make_them() {
        let deviations = [0.02, 0.01];
        let (first, second) = (truth(3), truth(9));
        let exact = first.inverse() * second;
        let information = information_of_relative(exact, deviations, 8).expect("positive");
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
        let due = 6.0 / 8.0;
        assert!((sum / due - 1.0).abs() < 0.05, "{sum} {due}");
    }
}

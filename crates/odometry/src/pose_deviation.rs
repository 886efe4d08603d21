//! Deviations of the poses of all frames from the final adjustment.
//!
//! A path may be moved as a whole, and drifts over a long way; what a frame's measurements tell is
//! its place among the frames around it. So deviations are of the error against the frames within
//! [`NEIGHBOUR_WINDOW`]: after the paths, found and true, are brought together there by their mean
//! orientation and position. With errors `e` of position and `r` of orientation in the world, as samples of the
//! noise give them (`bundle::pose_scatter`),
//!
//! ```text
//! r' = r - r̄,   e' = e - ē - r̄ × (t - t̄)
//! ```

use crate::bundle::PoseScatter;
use crate::progress::Stage;
use crate::sfm_state::SfmState;
use crate::track::tracks::repeated_frame;
use i2slam_geometry::{Pose, Vec3};
use std::ops::Range;

/// Time before and after a frame within which frames are compared [s].
pub const NEIGHBOUR_WINDOW: f64 = 0.25;
/// Frames before and after one that are compared in any case.
pub const MIN_NEIGHBOURS: usize = 2;
/// Frames whose scatter is found together, and those at either end that only surround others.
const PART: usize = 300;
const MARGIN: usize = 40;
/// Frames before and behind one whose scales are compared.
const SCALE_WINDOW: usize = 15;
/// Deviation of the logarithm of their ratio beyond which lengths do not compare: a factor of two is
/// within three deviations.
const MAX_SCALE_DEVIATION: f64 = std::f64::consts::LN_2 / 3.0;

/// Standard deviations of a pose against those of the frames within a quarter of a second, two
/// frames on either side at least: root of the summed variances of three coordinates each. A drift
/// over longer stretches is not in it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseDeviation {
    /// Of the position, in the unit of the poses.
    pub position: f64,
    /// Of the orientation [rad].
    pub rotation: f64,
    /// True if the adjustment ended at its minimum, within a deviation, most of the frame's landmarks
    /// agree with it, and nothing wrong was found in its picture.
    pub converged: bool,
}

/// Frames of a path that hardly bind the scale behind them to that before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct WeakLink {
    /// First and last frame.
    pub(crate) frames: [usize; 2],
    /// Largest deviation of the logarithm of the ratio of both scales.
    pub(crate) deviation: f64,
}

/// Deviations of all frames with a pose that the observations determine, and by colour alone the
/// frames that hardly bind the path's scale; frames that repeat the picture before them have its
/// deviation, those of weak links have not converged.
pub(crate) fn pose_deviations(
    state: &SfmState,
    is_repeat: &[bool],
) -> (Vec<Option<PoseDeviation>>, Vec<WeakLink>) {
    // Frames whose observations no landmark explains are not determined.
    let is_shared = state.shared_landmarks();
    let is_determined = |frame: &usize| {
        state.observations_in(*frame).any(|(track, o)| is_shared[track] && !o.is_outlier)
    };
    let posed: Vec<usize> = state.posed_frames().into_iter().filter(is_determined).collect();
    let mut out = vec![None; state.poses.len()];
    let mut weak: Vec<(usize, f64)> = Vec::new();
    let is_scale_measured = state.is_scale_measured();
    let parts = parts(posed.len());
    let total = parts.len();
    for (done, (part, inner)) in parts.into_iter().enumerate() {
        state.progress.report(Stage::BundleAdjustment, done, total);
        let frames = &posed[part.clone()];
        let Some(errors) = PoseErrors::new(state, frames) else { continue };
        for place in inner {
            let local = place - part.start;
            out[frames[local]] = errors.deviation(local, &neighbours(state, frames, local));
            let scale = errors.scale_deviation(local).filter(|_| !is_scale_measured);
            weak.extend(scale.filter(|d| *d > MAX_SCALE_DEVIATION).map(|d| (frames[local], d)));
        }
    }
    let links: Vec<WeakLink> =
        weak.chunk_by(|a, b| b.0 - a.0 <= SCALE_WINDOW).map(weak_link).collect();
    let mut out: Vec<Option<PoseDeviation>> =
        (0..out.len()).map(|frame| out[repeated_frame(is_repeat, frame)]).collect();
    for (frame, known) in out.iter_mut().enumerate() {
        let is_agreed = || state.agrees_with_landmarks(repeated_frame(is_repeat, frame));
        known.iter_mut().for_each(|known| known.converged &= is_agreed());
    }
    for WeakLink { frames: [first, last], .. } in &links {
        out[*first..=*last].iter_mut().flatten().for_each(|known| known.converged = false);
    }
    (out, links)
}

fn weak_link(run: &[(usize, f64)]) -> WeakLink {
    let deviation = run.iter().map(|(_, deviation)| *deviation).fold(0.0, f64::max);
    WeakLink { frames: [run[0].0, run[run.len() - 1].0], deviation }
}

/// Ranges of frames whose scatter is found together, with those among them that are told.
fn parts(count: usize) -> Vec<(Range<usize>, Range<usize>)> {
    if count <= PART {
        return vec![(0..count, 0..count)];
    }
    let step = PART - 2 * MARGIN;
    let part = |begin: usize| {
        let end = (begin + step).min(count);
        (begin.saturating_sub(MARGIN)..(end + MARGIN).min(count), begin..end)
    };
    (0..count).step_by(step).map(part).collect()
}

/// Places of the frames around one of `frames`, itself among them.
fn neighbours(state: &SfmState, frames: &[usize], place: usize) -> Range<usize> {
    let time = |place: usize| state.timestamps.get(frames[place]).copied().unwrap_or(0.0);
    let is_near = |other: &usize| {
        other.abs_diff(place) <= MIN_NEIGHBOURS
            || (time(*other) - time(place)).abs() <= NEIGHBOUR_WINDOW
    };
    let first = (0..=place).rev().take_while(is_near).last().unwrap_or(place);
    let last = (place..frames.len()).take_while(is_near).last().unwrap_or(place);
    first..last + 1
}

/// Errors of position and orientation in the world.
type Error = [Vec3<f64>; 2];

/// Samples of the errors of some frames.
struct PoseErrors {
    positions: Vec<Vec3<f64>>,
    samples: Vec<Vec<Error>>,
    remaining: Vec<Error>,
}

impl PoseErrors {
    fn new(state: &SfmState, frames: &[usize]) -> Option<Self> {
        // Of a part of a long path keyframes hold the landmarks that other frames see, too.
        let keyframes = &state.tracks.keyframes;
        let is_within =
            |f: usize| frames.binary_search(&f).is_ok() || keyframes.binary_search(&f).is_ok();
        let (bundle, of_bundle, _) = state.bundle_within(frames, false, is_within);
        let PoseScatter { samples, remaining } = bundle.pose_scatter(state.noise_scale)?;
        let places: Option<Vec<usize>> =
            frames.iter().map(|frame| of_bundle.binary_search(frame).ok()).collect();
        let places = places?;
        let poses: Vec<Pose<f64>> = places.iter().map(|place| bundle.poses[*place]).collect();
        let errors = |tangents: &Vec<[f64; 6]>| -> Vec<Error> {
            let error = |(pose, place): (&Pose<f64>, &usize)| {
                let [x, y, z, a, b, c] = tangents[*place];
                [[x, y, z], [a, b, c]].map(|v| pose.rotation.rotate(Vec3::from_array(v)))
            };
            poses.iter().zip(&places).map(error).collect()
        };
        Some(Self {
            positions: poses.iter().map(|pose| pose.translation).collect(),
            samples: samples.iter().map(errors).collect(),
            remaining: errors(&remaining),
        })
    }

    /// Deviation of a frame against those in a range.
    fn deviation(&self, place: usize, around: &Range<usize>) -> Option<PoseDeviation> {
        let squares = |errors: &Vec<Error>| {
            relative_error(&self.positions, errors, place, around).map(|v| v.norm_squared())
        };
        let mut sums = [0.0; 2];
        for sample in &self.samples {
            let found = squares(sample);
            (0..2).for_each(|i| sums[i] += found[i]);
        }
        // What is left of the way to the minimum is an error, too.
        let left = squares(&self.remaining);
        let scatter = sums.map(|sum| sum / self.samples.len() as f64);
        let [position, rotation] = [0, 1].map(|i| (scatter[i] + left[i]).sqrt());
        let is_sound = |v: f64| v.is_finite() && v > 0.0;
        (is_sound(position) && is_sound(rotation)).then_some(PoseDeviation {
            position,
            rotation,
            converged: left[0] <= scatter[0] && left[1] <= scatter[1],
        })
    }

    /// Deviation of the logarithm of the ratio between the scales of the path behind a frame and
    /// before it; `None` near the ends of the path.
    fn scale_deviation(&self, place: usize) -> Option<f64> {
        let before = place.checked_sub(SCALE_WINDOW)?..place;
        let behind = place..place + SCALE_WINDOW;
        if behind.end > self.positions.len() {
            return None;
        }
        let square = |errors: &Vec<Error>| {
            let [a, b] = [&before, &behind].map(|range| self.scale_error(errors, range));
            (b - a) * (b - a)
        };
        let mean = self.samples.iter().map(square).sum::<f64>() / self.samples.len() as f64;
        Some(mean.sqrt())
    }

    /// The logarithm of the scale that errors of some frames amount to: `Σ e (t - t̄) / Σ ‖t - t̄‖²`.
    fn scale_error(&self, errors: &[Error], range: &Range<usize>) -> f64 {
        let sum = range.clone().fold(Vec3::zero(), |sum, i| sum + self.positions[i]);
        let centre = sum * (1.0 / range.len() as f64);
        let (mut along, mut squares) = (0.0, 0.0);
        for i in range.clone() {
            let from = self.positions[i] - centre;
            along += from.dot(errors[i][0]);
            squares += from.norm_squared();
        }
        along / squares
    }
}

/// The error of a frame that is left when the frames in a range are brought together.
fn relative_error(
    positions: &[Vec3<f64>],
    errors: &[Error],
    place: usize,
    around: &Range<usize>,
) -> Error {
    let share = 1.0 / around.len() as f64;
    let mean = |of: &dyn Fn(usize) -> Vec3<f64>| {
        around.clone().fold(Vec3::zero(), |sum, i| sum + of(i) * share)
    };
    let (turn, moved) = (mean(&|i| errors[i][1]), mean(&|i| errors[i][0]));
    let centre = mean(&|i| positions[i]);
    let [position, rotation] = errors[place];
    [position - moved - turn.cross(positions[place] - centre), rotation - turn]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::RelativePoseFactor;
    use crate::fixtures;
    use crate::track::tracks::Observation;
    use i2slam_check::noise;
    use i2slam_compute::median;
    use i2slam_geometry::{Rotation, Tangent};
    use std::sync::Arc;

    const FRAMES: usize = 36;

    fn path(frame: usize) -> Pose<f64> {
        let s = frame as f64;
        let turn = Vec3::new(0.03 * (0.3 * s).sin(), 0.04 * (0.2 * s).cos(), 0.01 * s);
        Pose::new(Rotation::exp(turn), Vec3::new(0.04 * s, 0.05 * (0.3 * s).sin(), 0.0))
    }

    /// A path from points whose positions err by `own` independently and by `shared` in all frames
    /// but the first [px], the tracker claiming 0.3.
    fn points(own: f64, shared: f64) -> SfmState {
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = fixtures::camera().project(path(frame).inverse() * point);
            let common = if n.len() < 24 { shared * n[n.len() - 1] } else { 0.0 };
            // Uniform numbers in [-1, 1] have a deviation of 0.58.
            Some([u + 1.73 * (own * n[0] + common), v + 1.73 * (own * n[1] + common)])
        };
        let mut state = fixtures::state((FRAMES, 12, 4), [150.0, 110.0], path, observe);
        state.timestamps = Arc::new((0..FRAMES).map(|f| f as f64 / 30.0).collect());
        state
    }

    /// Medians of error over deviation, of positions and rotations.
    fn ratios(mut state: SfmState) -> [f64; 2] {
        let frames = state.posed_frames();
        state.adjust(&frames, false, 40);
        state.update_noise_scale();
        state.adjust(&frames, false, 40);
        let (found, links) = pose_deviations(&state, &[]);
        assert!(links.is_empty(), "{links:?}");
        let poses: Vec<Pose<f64>> = state.poses.iter().flatten().copied().collect();
        let error = |(frame, pose): (usize, &Pose<f64>)| {
            let turn = pose.rotation * path(frame).rotation.inverse();
            [pose.translation - path(frame).translation, turn.log()]
        };
        let errors: Vec<Error> = poses.iter().enumerate().map(error).collect();
        let positions: Vec<Vec3<f64>> = poses.iter().map(|pose| pose.translation).collect();
        let ratio = |frame: usize| {
            let around = neighbours(&state, &frames, frame);
            let [e, r] = relative_error(&positions, &errors, frame, &around).map(Vec3::norm);
            let claimed = found[frame].expect("determined");
            [e / claimed.position, r / claimed.rotation]
        };
        let converged = found.iter().flatten().filter(|d| d.converged).count();
        assert!(5 * converged > 4 * FRAMES, "{converged}");
        let all: Vec<[f64; 2]> = frames.iter().map(|frame| ratio(*frame)).collect();
        [0, 1].map(|i| median(&mut all.iter().map(|r| r[i]).collect::<Vec<_>>()).unwrap_or(0.0))
    }

    /// Within a factor of two of 0.89, the median for three equal variances.
    fn assert_due(ratios: [f64; 2]) {
        assert!(ratios.iter().all(|r| (0.45..1.8).contains(r)), "{ratios:?}");
    }

    #[test]
    fn deviations_from_points_are_those_of_the_errors() {
        for (own, shared) in [(0.3, 0.0), (0.05, 0.0), (1.0, 0.0), (0.2, 0.4)] {
            assert_due(ratios(points(own, shared)));
        }
    }

    /// Every frame's noise is in all of its constraints.
    #[test]
    fn deviations_from_relative_poses_are_those_of_the_errors() {
        let deviations = [0.002, 0.002, 0.002, 0.001, 0.001, 0.001];
        for factor in [1.0, 3.0] {
            let mut state = points(1.0, 0.0);
            let noisy = |frame: usize| {
                let n = noise(900 + frame as u64, 6);
                let share = factor * 1.73 * std::f64::consts::FRAC_1_SQRT_2;
                let by = std::array::from_fn(|i| share * deviations[i] * n[i]);
                path(frame).retract(Tangent::from_array(by))
            };
            let between = |first: usize, second: usize| RelativePoseFactor {
                first,
                second,
                first_from_second: noisy(first).inverse() * noisy(second),
                information: std::array::from_fn(|a| {
                    std::array::from_fn(|b| if a == b { deviations[a].powi(-2) } else { 0.0 })
                }),
            };
            let pairs = (0..FRAMES).step_by(4).flat_map(|key| {
                (key.saturating_sub(3)..(key + 13).min(FRAMES)).map(move |other| (key, other))
            });
            let pairs = pairs.filter(|(a, b)| b < &(a + 4) && a != b || b > a && b % 4 == 0);
            state.relative_poses = Arc::new(pairs.map(|(a, b)| between(a, b)).collect());
            assert_due(ratios(state));
        }
    }

    /// Points in the middle of the path that are far away bind its halves by rotation alone.
    #[test]
    fn a_link_that_does_not_bind_the_scale_is_told() {
        let mut state = points(0.3, 0.0);
        let middle = FRAMES / 2;
        for (track, landmark) in state.tracks.tracks.iter_mut().zip(&mut state.landmarks) {
            let seen = &mut track.observations;
            let is_crossing = seen.first().is_some_and(|o| o.frame < middle)
                && seen.last().is_some_and(|o| o.frame >= middle);
            if !is_crossing {
                continue;
            }
            let at = seen[0].at();
            let ray = path(seen[0].frame)
                .rotation
                .rotate(fixtures::camera().unproject(at[0], at[1], 1.0));
            for o in seen.iter_mut() {
                let here = path(o.frame).rotation.inverse().rotate(ray);
                let (u, v) = fixtures::camera().project(here);
                let n = noise(o.frame as u64 + 77 * at[0] as u64, 2);
                *o = Observation::whitened(o.frame, [u, v], *o.whitening())
                    .moved_to([u + n[0], v + n[1]]);
            }
            *landmark = None;
        }
        state.triangulate_missing();
        let frames = state.posed_frames();
        state.adjust(&frames, false, 40);
        let (found, links) = pose_deviations(&state, &[]);
        assert!(!links.is_empty());
        assert!(
            links.iter().any(|link| link.frames[0] <= middle + 2 && link.frames[1] + 2 >= middle),
            "{links:?}"
        );
        assert!(found[links[0].frames[0]].is_none_or(|d| !d.converged));
    }

    #[test]
    fn every_frame_of_a_long_sequence_is_in_one_part() {
        for count in [5, PART, PART + 1, 1000] {
            let all = parts(count);
            let inner: Vec<usize> = all.iter().flat_map(|(_, inner)| inner.clone()).collect();
            assert_eq!(inner, (0..count).collect::<Vec<_>>());
            assert!(all.iter().all(|(outer, _)| outer.len() <= PART));
            assert!(all.iter().all(|(outer, inner)| {
                (outer.start == 0 || inner.start - outer.start == MARGIN) && outer.end >= inner.end
            }));
        }
    }
}

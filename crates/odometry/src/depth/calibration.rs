//! Registration of depth to colour, found from the landmarks: offset in the picture, and delay.
//!
//! With landmarks that the pictures alone determine, the readings of the sensor at displaced
//! positions tell by which displacement they agree best. A constant one is an offset of the
//! cameras, one that follows the motion of the picture a delay:
//!
//! ```text
//! Σ ln(1 + (q / s - 1)² / c²),   q = (1/z(u(t) + shift) - ρ(t) + ρ(0)) / ρ(0)
//! ```
//!
//! with `t` the time from the colour to the depth picture, delay included, position `u(t)` and
//! inverse depth `ρ(t)` of the landmark then, and `s` the median of `q`: pictures alone leave the
//! scale open.

use crate::depth::pairing::pair_depth;
use crate::depth::readings::update_depth_model;
use crate::multiview::lens_distortion::undistort;
use crate::register::registration::adjust_globally;
use crate::rolling_shutter::readout::{median_frame_interval, parabola_minimum, pose_later};
use crate::sfm_state::SfmState;
use crate::track::tracks::Observation;
use i2slam_compute::median;
use i2slam_geometry::Pose;
use std::sync::Arc;

/// First steps of the search: offset as a ratio of the picture's width, delay in frame intervals.
const FIRST_SHIFT: f64 = 1.0 / 64.0;
const FIRST_DELAY: f64 = 0.25;
/// Steps of offset to either side of the coarse search.
const COARSE_STEPS: i32 = 3;
/// Largest delay [s], that of a slow driver; three quarters of a frame interval where that is longer.
const MAX_DELAY: f64 = 0.1;
/// First steps of delay within that range, at most.
const MAX_DELAY_STEPS: f64 = 25.0;
/// Halvings of the steps in the fine search.
const HALVINGS: usize = 7;
/// Rounds of the search with landmarks of pictures and depth, and the ratio of their steps.
const JOINT_REFINEMENTS: i32 = 3;
const JOINT_STEP_RATIO: f64 = 1.0 / 3.0;
/// Most passes over the coordinates with steps of one size.
const MAX_JOINT_PASSES: usize = 8;
/// Largest cost relative to that of registered depth at which a displacement is accepted.
const MAX_COST_RATIO: f64 = 0.97;
/// Scale of the robust cost over the median absolute residual of registered depth.
const SCALE_RATIO: f64 = 0.5;
/// Time before and after a frame by which the motion of its landmarks is predicted [frame intervals].
const PREDICTED_TIME: f64 = 0.5;
/// Observations from which on the registration is looked for, and most that are compared.
const MIN_OBSERVATIONS: usize = 300;
const MAX_OBSERVATIONS: usize = 8_000;
/// Steps of an even sequence in the unit square: `1/φ` and `1/φ²` with `φ³ = φ + 1`.
const SPREADING_STEPS: [f64; 2] = [0.754_877_666_246_692_7, 0.569_840_290_998_053_2];
/// Relative deviation of a landmark's inverse depth by pictures alone, at most.
const MAX_LANDMARK_DEVIATION: f64 = 0.03;

/// An observation whose depth is predicted by its landmark.
struct Prediction {
    frame: usize,
    /// Position in the colour picture, moved within a pixel (see [`spread_over_a_pixel`]) [px], and
    /// inverse depth [1/m]; their first and half their second derivative by time [s].
    now: [f64; 3],
    velocity: [f64; 3],
    bend: [f64; 3],
    /// Time from the colour to the depth picture by their timestamps [s].
    later: f64,
}

impl Prediction {
    /// Position and inverse depth some time later [s].
    fn after(&self, time: f64) -> [f64; 3] {
        std::array::from_fn(|i| self.now[i] + time * (self.velocity[i] + time * self.bend[i]))
    }
}

/// Displacement of the depth picture: right and down [px], delay [s].
type Displacement = [f64; 3];

/// Finds offset and delay of the depth pictures; zero where they are not clearly better. Returns
/// whether they changed.
pub(crate) fn calibrate_depth(state: &mut SfmState) -> bool {
    if state.is_unscaled {
        return false;
    }
    let found = displacements_by_pictures(state).unwrap_or_default();
    let none = adjusted_keyframes(state, Some([0.0; 3]));
    let registered = predictions(&none, state);
    let usual = usual_deviation(state, &registered, &[0.0; 3]);
    let Some(usual) = usual.filter(|_| registered.len() >= MIN_OBSERVATIONS) else { return false };
    // Landmarks that the pictures determine badly are off together, which a displacement may fit:
    // it must also suit landmarks that pictures and depth determine together.
    let joint = |d: &Displacement| {
        let adjusted = adjusted_keyframes(state, Some(*d));
        cost(state, &predictions(&adjusted, state), d, SCALE_RATIO * usual)
    };
    let at_none = cost(state, &registered, &[0.0; 3], SCALE_RATIO * usual);
    let (mut least, mut chosen) = (at_none, [0.0; 3]);
    let by_all = delay_by_all(&joint, least, state);
    let tried = found.into_iter().map(|d| (joint(&d), d)).chain(by_all);
    let is_both = |d: &Displacement| d[2] != 0.0 && d[..2] != [0.0; 2];
    let (both, alone): (Vec<_>, Vec<_>) = tried.partition(|(_, d)| is_both(d));
    // Where the camera turns evenly, a delay and an offset look alike: each has to pay for itself.
    let better = alone.into_iter().min_by(|a, b| a.0.total_cmp(&b.0));
    for (now, displacement) in better.into_iter().chain(both) {
        if now < MAX_COST_RATIO * least {
            (least, chosen) = (now, displacement);
        }
    }
    let [right, down, delay] = refine_jointly(&joint, state, (least, chosen));
    let model = &mut state.depth_model;
    let changed = model.shift != [right, down] || model.delay != delay;
    (model.shift, model.delay) = ([right, down], delay);
    if changed {
        pair_depth(state);
        update_depth_model(state);
    }
    changed
}

/// The delay alone, the offset alone, and both together that suit the landmarks of the pictures
/// alone best, those of them that have a minimum; `None` with too few landmarks.
fn displacements_by_pictures(state: &SfmState) -> Option<Vec<Displacement>> {
    let interval = median_frame_interval(&state.timestamps)?;
    let predictions = predictions(&adjusted_keyframes(state, None), state);
    if predictions.len() < MIN_OBSERVATIONS {
        return None;
    }
    let usual = usual_deviation(state, &predictions, &[0.0; 3])?;
    let cost = |d: &Displacement| cost(state, &predictions, d, SCALE_RATIO * usual);
    let step = FIRST_SHIFT * state.camera.width as f64;
    let [delay, longest] = delay_range(interval);
    let steps = [[0.0, 0.0, delay], [step, step, 0.0], [step, step, delay]];
    Some(steps.into_iter().filter_map(|steps| search(&cost, steps, longest)).collect())
}

/// First step and largest size of a delay at a median frame interval [s].
fn delay_range(interval: f64) -> [f64; 2] {
    let longest = MAX_DELAY.max(f64::from(COARSE_STEPS) * FIRST_DELAY * interval);
    [(FIRST_DELAY * interval).max(longest / MAX_DELAY_STEPS), longest]
}

/// The delay at which landmarks that pictures and depth determine together agree with depth best, and
/// its cost: found from none, whose cost is `least`, in steps to either side while the cost falls; the
/// only one that is found where pictures alone determine their landmarks badly.
fn delay_by_all(
    cost: &impl Fn(&Displacement) -> f64,
    least: f64,
    state: &SfmState,
) -> Option<(f64, Displacement)> {
    let [step, longest] = delay_range(median_frame_interval(&state.timestamps)?);
    let walk = |step: f64| {
        let mut best = (least, [0.0; 3]);
        loop {
            let next = [0.0, 0.0, best.1[2] + step];
            let found = cost(&next);
            if found >= best.0 {
                return Some(best);
            }
            if next[2].abs() > longest {
                return None;
            }
            best = (found, next);
        }
    };
    let walked = [-step, step].into_iter().filter_map(walk);
    walked.min_by(|a, b| a.0.total_cmp(&b.0)).filter(|(_, d)| d[2] != 0.0)
}

/// The displacement of least cost: on a grid of offsets, then along each coordinate with steps
/// that are halved; one with a step of zero stays. `None` at an end of the range: a cost that falls
/// up to there has no minimum.
fn search(
    cost: &impl Fn(&Displacement) -> f64,
    mut steps: Displacement,
    longest: f64,
) -> Option<Displacement> {
    let reach = if steps[0] > 0.0 { COARSE_STEPS } else { 0 };
    let offsets = -reach..=reach;
    let grid = offsets.clone().flat_map(|i| offsets.clone().map(move |j| (i, j)));
    let places = grid.map(|(i, j)| [f64::from(i) * steps[0], f64::from(j) * steps[1], 0.0]);
    let tried = places.map(|place| (cost(&place), place));
    let (mut least, mut best) =
        tried.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, [0.0; 3]));
    let [right, down, later] = steps;
    let farthest = f64::from(COARSE_STEPS);
    let most = [farthest * right, farthest * down, if later > 0.0 { longest } else { 0.0 }];
    let free: Vec<usize> = (0..3).filter(|axis| steps[*axis] > 0.0).collect();
    for _ in 0..HALVINGS {
        let mut moves = true;
        while moves {
            moves = false;
            for (axis, side) in free.iter().flat_map(|axis| [(*axis, -1.0), (*axis, 1.0)]) {
                let mut next = best;
                next[axis] += side * steps[axis];
                next[axis] = next[axis].clamp(-most[axis], most[axis]);
                let found = cost(&next);
                if found < least {
                    (least, best, moves) = (found, next, true);
                }
            }
        }
        steps = steps.map(|step| 0.5 * step);
    }
    let is_inside = |(found, most): (&f64, f64)| most == 0.0 || found.abs() < most;
    best.iter().zip(most).all(is_inside).then_some(best)
}

/// The displacement of least cost near one that was found from pictures alone, which do not
/// determine far landmarks as well as depth does: by parabolas along the coordinates that are not
/// zero, each step of falling size repeated while the cost falls.
fn refine_jointly(
    cost: &impl Fn(&Displacement) -> f64,
    state: &SfmState,
    start: (f64, Displacement),
) -> Displacement {
    let shift = FIRST_SHIFT * state.camera.width as f64;
    let delay = FIRST_DELAY * median_frame_interval(&state.timestamps).unwrap_or(0.0);
    let free: Vec<usize> = (0..3).filter(|axis| start.1[*axis] != 0.0).collect();
    let mut best = start;
    for round in 1..=JOINT_REFINEMENTS {
        let steps = [shift, shift, delay].map(|step| step * JOINT_STEP_RATIO.powi(round));
        for _ in 0..MAX_JOINT_PASSES {
            let before = best.1;
            for axis in &free {
                best = least_along(cost, best, (*axis, steps[*axis]));
            }
            if free.iter().all(|axis| (best.1[*axis] - before[*axis]).abs() < 0.5 * steps[*axis]) {
                break;
            }
        }
    }
    best.1
}

/// The least of the costs at a displacement, one step to either side of it along an axis, and at
/// the minimum of the parabola through the three.
fn least_along(
    cost: &impl Fn(&Displacement) -> f64,
    (least, best): (f64, Displacement),
    (axis, step): (usize, f64),
) -> (f64, Displacement) {
    let moved = |by: f64| {
        let mut next = best;
        next[axis] += by;
        (cost(&next), next)
    };
    let sides = [-step, step].map(moved);
    let lowest = parabola_minimum(step, [sides[0].0, least, sides[1].0]).map(moved);
    let tried = sides.into_iter().chain(lowest);
    tried.fold((least, best), |best, tried| if tried.0 < best.0 { tried } else { best })
}

/// The keyframes adjusted to their pictures, and to depth at a displacement if one is given.
fn adjusted_keyframes(state: &SfmState, displacement: Option<Displacement>) -> SfmState {
    let mut out = state.keyframes_only();
    out.landmarks.clone_from(&state.landmarks);
    for frame in &state.tracks.keyframes {
        out.poses[*frame] = state.poses[*frame];
    }
    (out.readout, out.distortion) = (state.readout, state.distortion);
    out.noise_scale = state.noise_scale;
    match displacement {
        Some([right, down, delay]) => {
            (out.depth_model.shift, out.depth_model.delay) = ([right, down], delay);
            update_depth_model(&mut out);
        }
        None => {
            out.depth_maps = Arc::default();
            let observations = out.tracks.tracks.iter_mut().flat_map(|t| &mut t.observations);
            observations.for_each(|o| *o = o.with_depth(None));
        }
    }
    adjust_globally(&mut out, false);
    out
}

/// Mean robust cost of the readings at a displacement; a missing reading costs as much as one off
/// by three deviations, so that displacements gain nothing by leaving the picture.
fn cost(state: &SfmState, predictions: &[Prediction], d: &Displacement, deviation: f64) -> f64 {
    let ratios: Vec<Option<f64>> = predictions.iter().map(|p| ratio(state, p, d)).collect();
    let Some(scale) = median(&mut ratios.iter().flatten().copied().collect::<Vec<_>>()) else {
        return f64::INFINITY;
    };
    let of = |ratio: &Option<f64>| {
        let off = ratio.map_or(3.0, |ratio| (ratio / scale - 1.0) / deviation);
        (off * off).ln_1p()
    };
    ratios.iter().map(of).sum::<f64>() / predictions.len() as f64
}

/// Median absolute relative residual at a displacement.
fn usual_deviation(state: &SfmState, predictions: &[Prediction], d: &Displacement) -> Option<f64> {
    let ratios: Vec<f64> = predictions.iter().filter_map(|p| ratio(state, p, d)).collect();
    let scale = median(&mut ratios.clone())?;
    let mut sizes: Vec<f64> = ratios.iter().map(|ratio| (ratio / scale - 1.0).abs()).collect();
    median(&mut sizes).filter(|m| *m > 0.0)
}

/// Read over predicted inverse depth.
fn ratio(state: &SfmState, p: &Prediction, [right, down, delay]: &Displacement) -> Option<f64> {
    let [u, v, then] = p.after(p.later + delay);
    let map = state.depth_maps.get(p.frame)?.as_ref()?;
    let read = map.readings().inverse_at([u + right, v + down])?;
    Some((read - then) / p.now[2] + 1.0)
}

/// Predictions of observations in keyframes with depth, evenly thinned.
fn predictions(visual: &SfmState, state: &SfmState) -> Vec<Prediction> {
    let Some(interval) = median_frame_interval(&state.timestamps) else { return Vec::new() };
    let is_precise = precise_landmarks(visual);
    let frames = visual.posed_frames().into_iter();
    let all: Vec<Prediction> =
        frames.flat_map(|frame| of_frame(visual, state, &is_precise, (frame, interval))).collect();
    let step = all.len().div_ceil(MAX_OBSERVATIONS).max(1);
    let mut some: Vec<Prediction> = all.into_iter().step_by(step).collect();
    spread_over_a_pixel(&mut some);
    some
}

/// Moves positions evenly over a pixel (the sequence R2 of Roberts 2018), so that as many fall on
/// pixel centres at every displacement. Corners begin at pixel centres, where a reading has the
/// noise of one pixel; between pixels it is an average, and half a pixel of displacement would
/// always suit noisy depth better.
fn spread_over_a_pixel(predictions: &mut [Prediction]) {
    for (index, prediction) in predictions.iter_mut().enumerate() {
        for (value, step) in prediction.now.iter_mut().zip(SPREADING_STEPS) {
            *value += (step * index as f64).fract() - 0.5;
        }
    }
}

/// Landmarks whose depth the pictures determine.
fn precise_landmarks(visual: &SfmState) -> Vec<bool> {
    let (mut bundle, _, tracks) = visual.bundle(&visual.posed_frames(), false);
    bundle.fixed.fill(true);
    let mut out = vec![false; visual.landmarks.len()];
    for (track, variance) in tracks.iter().zip(bundle.inverse_depth_variances()) {
        let (Some(landmark), Some(variance)) = (visual.landmarks[*track], variance) else {
            continue;
        };
        let deviation = visual.noise_scale * variance.sqrt();
        out[*track] = deviation < MAX_LANDMARK_DEVIATION * landmark.inverse_depth();
    }
    out
}

fn of_frame(
    visual: &SfmState,
    state: &SfmState,
    is_precise: &[bool],
    (frame, interval): (usize, f64),
) -> Vec<Prediction> {
    let map = state.depth_maps.get(frame).and_then(Option::as_ref);
    let (Some(pose), Some(map)) = (visual.poses[frame], map) else { return Vec::new() };
    // The motion of all frames; lengths of both states differ by little.
    let reach = PREDICTED_TIME * interval;
    let moved = |later: f64| {
        let now = state.poses[frame]?;
        let then = pose_later(&state.poses, &state.timestamps, frame, (later, interval))?;
        Some(pose * (now.inverse() * then))
    };
    let [before, after] = [-reach, reach].map(|later| moved(later).unwrap_or(pose));
    let (camera, distortion) = (&visual.camera, visual.distortion);
    let of = |(track, o): (usize, &Observation)| {
        let is_usable = is_precise[track] && !o.is_outlier;
        let landmark = visual.landmarks[track].as_ref().filter(|_| is_usable)?;
        let seen = |pose: &Pose<f64>| -> Option<[f64; 3]> {
            let [u, v] = landmark.image_position(camera, pose)?;
            Some([u, v, landmark.inverse_depth_in(pose)])
        };
        let (earlier, mut now, later) = (seen(&before)?, seen(&pose)?, seen(&after)?);
        let by = |of: &dyn Fn(usize) -> f64| std::array::from_fn(of);
        let velocity = by(&|i| (later[i] - earlier[i]) / (2.0 * reach));
        let bend = by(&|i| (later[i] + earlier[i] - 2.0 * now[i]) / (2.0 * reach * reach));
        let flat = undistort(camera, distortion, o.raw());
        (0..2).for_each(|i| now[i] = o.raw()[i] + o.at()[i] - flat[i]);
        let later = map.timestamp - state.timestamps[frame];
        (now[2] > 0.0).then_some(Prediction { frame, now, velocity, bend, later })
    };
    visual.observations_in(frame).filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth::depth_map::{DepthMap, DepthPicture};
    use crate::fixtures::camera;
    use crate::track::tracks::Tracks;
    use i2slam_check::noise;
    use i2slam_geometry::Image;
    use i2slam_storage::ScratchStore;

    /// Corners at the centres of pixels of a wall whose readings are noisy, and cost ratio of half a
    /// pixel's displacement to none.
    fn ratio_of_half_a_pixel(is_spread: bool) -> f64 {
        let camera = camera();
        let (width, height) = (camera.width, camera.height);
        let numbers = noise(5, width * height);
        let depth = Image::from_fn(width, height, 1, |_, column, row| {
            let inverse = 0.5 * (1.0 + 0.003 * numbers[row * width + column]);
            inverse.recip() as f32
        });
        let mut state = SfmState::new(camera, Tracks { frames: 1, ..Tracks::default() });
        let map = DepthMap::new(
            &DepthPicture { depth: &depth, timestamp: 0.0 },
            &ScratchStore::in_memory(),
        );
        state.depth_maps = Arc::new(vec![Some(map)]);
        let at = |index: usize| [8.5 + 4.0 * (index % 75) as f64, 8.5 + 4.0 * (index / 75) as f64];
        let of = |index: usize| Prediction {
            frame: 0,
            now: [at(index)[0], at(index)[1], 0.5],
            velocity: [0.0; 3],
            bend: [0.0; 3],
            later: 0.0,
        };
        let mut predictions: Vec<Prediction> = (0..75 * 55).map(of).collect();
        if is_spread {
            spread_over_a_pixel(&mut predictions);
        }
        let usual = usual_deviation(&state, &predictions, &[0.0; 3]).expect("readings");
        let cost = |d: &Displacement| cost(&state, &predictions, d, SCALE_RATIO * usual);
        cost(&[-0.5, 0.5, 0.0]) / cost(&[0.0; 3])
    }

    #[test]
    fn averages_between_pixels_are_no_displacement() {
        assert!(ratio_of_half_a_pixel(false) < 0.8, "{}", ratio_of_half_a_pixel(false));
        assert!(ratio_of_half_a_pixel(true) > MAX_COST_RATIO, "{}", ratio_of_half_a_pixel(true));
    }

    /// From where pictures alone put it; an axis that was not found stays.
    #[test]
    fn a_displacement_is_refined_to_the_minimum_of_its_axes() {
        let mut state = SfmState::new(camera(), Tracks { frames: 3, ..Tracks::default() });
        state.timestamps = Arc::new(vec![0.0, 1.0 / 30.0, 2.0 / 30.0]);
        let due = [1.0, 0.0, -0.02];
        let cost =
            |d: &Displacement| ((d[0] - due[0]) / 5.0).abs() + ((d[2] - due[2]) / 0.01).abs();
        for start in [[0.0, 0.0, -0.01], [0.5, 0.0, -0.022]] {
            let found = refine_jointly(&cost, &state, (cost(&start), start));
            assert!((found[2] - due[2]).abs() < 3e-4, "{found:?}");
            assert_eq!(found[0] == 0.0, start[0] == 0.0);
            assert!(start[0] == 0.0 || (found[0] - due[0]).abs() < 0.2, "{found:?}");
        }
    }

    /// To either side, past steps of which each is lower; nothing where none is, or at the end.
    #[test]
    fn a_delay_is_walked_to_from_none() {
        let mut state = SfmState::new(camera(), Tracks { frames: 3, ..Tracks::default() });
        state.timestamps = Arc::new(vec![0.0, 1.0 / 30.0, 2.0 / 30.0]);
        let found = |due: f64| {
            let cost = |d: &Displacement| (d[2] - due).abs();
            delay_by_all(&cost, cost(&[0.0; 3]), &state).map(|(_, d)| d[2])
        };
        for due in [-0.043, -0.02, 0.03, 0.09] {
            assert!((found(due).expect("within the range") - due).abs() < 0.005, "{due}");
        }
        assert_eq!([found(0.001), found(0.2), found(-0.2)], [None; 3]);
    }

    #[test]
    fn a_minimum_at_the_end_of_the_range_is_none() {
        let steps = [5.0, 5.0, 0.01];
        let around = |to: Displacement| {
            move |d: &Displacement| -> f64 {
                (0..3).map(|i| ((d[i] - to[i]) / steps[i]).powi(2)).sum()
            }
        };
        let found = search(&around([8.0, -3.0, 0.012]), steps, 0.1).expect("within the range");
        let off = [found[0] - 8.0, found[1] + 3.0, 1e3 * (found[2] - 0.012)];
        assert!(off.iter().all(|off| off.abs() < 0.1), "{found:?}");
        assert_eq!(search(&around([2.0, 40.0, 0.0]), steps, 0.1), None);
        assert_eq!(search(&around([0.0, 0.0, -0.15]), steps, 0.1), None);
    }
}

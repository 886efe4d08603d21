//! Registration of depth to colour, found from the landmarks: offset in the picture, and delay.
//!
//! With landmarks that the pictures determine, the readings of the sensor at displaced positions
//! tell by which displacement they agree best. A constant one is an offset of the cameras, one
//! that follows the motion of the picture a delay:
//!
//! ```text
//! Σ ln(1 + (r / c)²),   r = ρ - ρ̇ t - 1/z(u + u̇ t + shift),   t = stamp of depth + delay - stamp
//! ```

use crate::depth::readings::update_depth_model;
use crate::multiview::lens_distortion::undistort;
use crate::rolling_shutter::readout::{camera_velocity, median_frame_interval};
use crate::sfm_state::SfmState;
use i2slam_compute::median;

/// First steps of the search: offset as a ratio of the picture's width, delay in frame intervals.
const FIRST_SHIFT: f64 = 1.0 / 64.0;
const FIRST_DELAY: f64 = 0.25;
/// Steps to either side of the coarse search.
const COARSE_STEPS: i32 = 3;
/// Halvings of the steps in the fine search.
const HALVINGS: usize = 7;
/// Largest cost relative to that of registered depth at which a displacement is accepted.
const MAX_COST_RATIO: f64 = 0.97;
/// Scale of the robust cost over the median absolute residual of registered depth.
const SCALE_RATIO: f64 = 0.5;
/// Observations from which on the registration is looked for, and most that are compared.
const MIN_OBSERVATIONS: usize = 300;
const MAX_OBSERVATIONS: usize = 20_000;

/// An observation whose depth is predicted by its landmark.
struct Prediction {
    frame: usize,
    /// Position in the colour picture [px], and its velocity [px/s].
    at: [f64; 2],
    velocity: [f64; 2],
    /// Inverse depth [1/m], and its rate [1/(m s)].
    inverse: f64,
    rate: f64,
    /// Time from the colour to the depth picture by their timestamps [s].
    later: f64,
}

/// Displacement of the depth picture: right and down [px], delay [s].
type Displacement = [f64; 3];

/// Finds offset and delay of the depth pictures; zero where they are not clearly better. Returns
/// whether they changed.
pub(crate) fn calibrate_depth(state: &mut SfmState) -> bool {
    let predictions = predictions(state);
    let Some(interval) = median_frame_interval(&state.timestamps) else { return false };
    if predictions.len() < MIN_OBSERVATIONS {
        return false;
    }
    let Some(scale) = usual_residual(state, &predictions) else { return false };
    let cost = |d: &Displacement| cost(state, &predictions, d, SCALE_RATIO * scale);
    let steps = [FIRST_SHIFT * state.camera.width as f64; 2];
    let best = search(&cost, [steps[0], steps[1], FIRST_DELAY * interval]);
    let accepted = cost(&best) < MAX_COST_RATIO * cost(&[0.0; 3]);
    let [right, down, delay] = if accepted { best } else { [0.0; 3] };
    let model = &mut state.depth_model;
    let changed = model.shift != [right, down] || model.delay != delay;
    (model.shift, model.delay) = ([right, down], delay);
    if changed {
        update_depth_model(state);
    }
    changed
}

/// The displacement of least cost: on a grid of offsets, then along each coordinate with steps
/// that are halved.
fn search(cost: &impl Fn(&Displacement) -> f64, mut steps: Displacement) -> Displacement {
    let offsets = -COARSE_STEPS..=COARSE_STEPS;
    let grid = offsets.clone().flat_map(|i| offsets.clone().map(move |j| (i, j)));
    let places = grid.map(|(i, j)| [f64::from(i) * steps[0], f64::from(j) * steps[1], 0.0]);
    let tried = places.map(|place| (cost(&place), place));
    let (mut least, mut best) =
        tried.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((f64::INFINITY, [0.0; 3]));
    for _ in 0..HALVINGS {
        let mut moves = true;
        while moves {
            moves = false;
            for (axis, side) in (0..3).flat_map(|axis| [(axis, -1.0), (axis, 1.0)]) {
                let mut next = best;
                next[axis] += side * steps[axis];
                let found = cost(&next);
                if found < least {
                    (least, best, moves) = (found, next, true);
                }
            }
        }
        steps = steps.map(|step| 0.5 * step);
    }
    best
}

/// Mean robust cost of the readings at a displacement; a missing reading costs as much as one off
/// by three scales, so that displacements gain nothing by leaving the picture.
fn cost(state: &SfmState, predictions: &[Prediction], d: &Displacement, scale: f64) -> f64 {
    let of = |p: &Prediction| {
        let off = residual(state, p, d).map_or(3.0, |r| r / (scale * p.inverse));
        (off * off).ln_1p()
    };
    predictions.iter().map(of).sum::<f64>() / predictions.len() as f64
}

/// Median absolute residual over inverse depth, of depth that is registered.
fn usual_residual(state: &SfmState, predictions: &[Prediction]) -> Option<f64> {
    let none = [0.0; 3];
    let of = |p: &Prediction| Some(residual(state, p, &none)?.abs() / p.inverse);
    median(&mut predictions.iter().filter_map(of).collect::<Vec<_>>()).filter(|m| *m > 0.0)
}

/// Predicted minus read inverse depth.
fn residual(state: &SfmState, p: &Prediction, [right, down, delay]: &Displacement) -> Option<f64> {
    let time = p.later + delay;
    let at = [p.at[0] + right + time * p.velocity[0], p.at[1] + down + time * p.velocity[1]];
    let read = state.depth_maps.get(p.frame)?.as_ref()?.inverse_at(at)?;
    Some(p.inverse + time * p.rate - read)
}

/// Predictions of observations of frames with depth, evenly thinned.
fn predictions(state: &SfmState) -> Vec<Prediction> {
    let Some(interval) = median_frame_interval(&state.timestamps) else { return Vec::new() };
    let frames = (0..state.poses.len()).filter(|f| {
        state.poses[*f].is_some() && state.depth_maps.get(*f).is_some_and(Option::is_some)
    });
    let all: Vec<Prediction> = frames.flat_map(|frame| of_frame(state, frame, interval)).collect();
    let step = all.len().div_ceil(MAX_OBSERVATIONS).max(1);
    all.into_iter().step_by(step).collect()
}

fn of_frame(state: &SfmState, frame: usize, interval: f64) -> Vec<Prediction> {
    let (Some(pose), Some(map)) = (state.poses[frame], &state.depth_maps[frame]) else {
        return Vec::new();
    };
    let velocity = camera_velocity(state, &state.timestamps, frame, interval);
    // A short time, so that differences are velocities.
    let short = 1e-3 * interval;
    let soon = velocity.map_or(pose, |v| pose.retract(v.scaled(short)));
    let (camera, distortion) = (&state.camera, state.distortion);
    let of = |(track, o): (usize, &crate::track::tracks::Observation)| {
        let landmark = state.landmarks[track].as_ref().filter(|_| !o.is_outlier)?;
        let (now, then) =
            (landmark.image_position(camera, &pose)?, landmark.image_position(camera, &soon)?);
        let flat = undistort(camera, distortion, o.raw);
        let inverse = landmark.inverse_depth_in(&pose);
        (inverse > 0.0).then(|| Prediction {
            frame,
            at: std::array::from_fn(|i| o.raw[i] + o.at[i] - flat[i]),
            velocity: std::array::from_fn(|i| (then[i] - now[i]) / short),
            inverse,
            rate: (landmark.inverse_depth_in(&soon) - inverse) / short,
            later: map.timestamp - state.timestamps[frame],
        })
    };
    state.observations_in(frame).filter_map(of).collect()
}

//! Initial readout from rotations alone, before any frame has a pose.
//!
//! Between neighbouring frames most motion is rotation. Where its rate changes, frames some
//! intervals apart fit a rotation badly unless their rows are corrected for the readout.

use crate::multiview::two_view::{RayPair, fit_rotation, ray_pairs};
use crate::progress::{Progress, Stage};
use crate::rolling_shutter::readout::{MAX_COST_RATIO, median_frame_interval, parabola_minimum};
use crate::sfm_state::MAX_READOUT;
use crate::track::tracks::{Tracks, shared_positions};
use i2slam_geometry::{Camera, Rotation, Vec3};
use rayon::prelude::*;

/// Step of the compared readouts [frame intervals], and number of steps to either side.
const STEP: f64 = 0.3;
const STEPS_PER_SIDE: i32 = 4;
/// Distance of the compared frames.
const FRAME_GAP: usize = 4;

/// Estimates the readout [frame intervals] from rotation rates and corrects all observations; 0 if
/// none is clearly better than a global shutter. `by_frame` has the tracks of every frame, in order.
pub(crate) fn initialize_readout(
    (tracks, by_frame): (&mut Tracks, &[Vec<usize>]),
    camera: &Camera<f64>,
    timestamps: &[f64],
    progress: &Progress,
) -> f64 {
    progress.report(Stage::RollingShutter, 0, 0);
    let Some(times) = whole_intervals(timestamps) else { return 0.0 };
    let rates = rotation_rates(tracks, by_frame, camera, &times);
    let cost = |readout: f64| -> f64 {
        let one = |f: usize| match progress.is_cancelled() {
            true => 0.0,
            false => rotation_misfit(tracks, by_frame, camera, &rates, f, readout).unwrap_or(0.0),
        };
        let all: Vec<f64> =
            (0..tracks.frames.saturating_sub(FRAME_GAP)).into_par_iter().map(one).collect();
        all.iter().sum()
    };
    let costs: Vec<f64> =
        (-STEPS_PER_SIDE..=STEPS_PER_SIDE).map(|k| cost(STEP * f64::from(k))).collect();
    let Some(best) = best_readout(&costs) else { return 0.0 };
    let best = best.clamp(-MAX_READOUT, MAX_READOUT);
    if cost(best) > MAX_COST_RATIO * costs[STEPS_PER_SIDE as usize] {
        return 0.0;
    }
    for o in tracks.tracks.iter_mut().flat_map(|t| &mut t.observations) {
        let ray = row_corrected_ray(camera, &rates, o.frame, o.raw(), best);
        let (u, v) = camera.project(ray);
        *o = o.moved_to([u, v]);
    }
    best
}

/// Times between frames in whole intervals: counts missing pictures, ignores jitter of stamps.
fn whole_intervals(timestamps: &[f64]) -> Option<Vec<f64>> {
    let interval = median_frame_interval(timestamps)?;
    let whole = |pair: &[f64]| ((pair[1] - pair[0]) / interval).round().max(1.0);
    Some(timestamps.windows(2).map(whole).collect())
}

/// Readout of least cost, by a parabola through the least of `costs` and its neighbours.
fn best_readout(costs: &[f64]) -> Option<f64> {
    let inner = 1..costs.len() - 1;
    let least = inner.min_by(|a, b| costs[*a].total_cmp(&costs[*b]))?;
    let around = [costs[least - 1], costs[least], costs[least + 1]];
    Some(STEP * (least as f64 - f64::from(STEPS_PER_SIDE)) + parabola_minimum(STEP, around)?)
}

/// Angular velocity of every camera per interval in its own frame, from both neighbours.
fn rotation_rates(
    tracks: &Tracks,
    by_frame: &[Vec<usize>],
    camera: &Camera<f64>,
    times: &[f64],
) -> Vec<Vec3<f64>> {
    let turns: Vec<Option<Vec3<f64>>> = (1..tracks.frames.min(times.len() + 1))
        .into_par_iter()
        .map(|f| {
            let shared = shared_positions(&tracks.tracks, by_frame, f - 1, f);
            let rays = ray_pairs(camera, &shared);
            // The map found takes rays of the first camera to the second.
            fit_rotation(camera.fx, &rays).map(|(r, _)| r.inverse().log() * times[f - 1].recip())
        })
        .collect();
    let turn = |i: Option<usize>| i.and_then(|i| turns.get(i).copied().flatten());
    (0..tracks.frames)
        .map(|f| match (turn(f.checked_sub(1)), turn(Some(f))) {
            (Some(a), Some(b)) => (a + b) * 0.5,
            (Some(a), None) | (None, Some(a)) => a,
            (None, None) => Vec3::zero(),
        })
        .collect()
}

/// Median residual of a rotation between a frame and a later one [px].
fn rotation_misfit(
    tracks: &Tracks,
    by_frame: &[Vec<usize>],
    camera: &Camera<f64>,
    rates: &[Vec3<f64>],
    frame: usize,
    readout: f64,
) -> Option<f64> {
    let rays: Vec<RayPair> = shared_positions(&tracks.tracks, by_frame, frame, frame + FRAME_GAP)
        .iter()
        .map(|(a, b)| {
            let first = row_corrected_ray(camera, rates, frame, *a, readout);
            (first, row_corrected_ray(camera, rates, frame + FRAME_GAP, *b, readout))
        })
        .collect();
    fit_rotation(camera.fx, &rays).map(|(_, left)| left)
}

/// The ray of an image position at the moment of the middle row; its third component is 1.
fn row_corrected_ray(
    camera: &Camera<f64>,
    rates: &[Vec3<f64>],
    frame: usize,
    seen: [f64; 2],
    readout: f64,
) -> Vec3<f64> {
    let late = readout * (seen[1] / camera.height as f64 - 0.5);
    let ray = Rotation::exp(rates[frame] * late).rotate(camera.unproject(seen[0], seen[1], 1.0));
    ray * ray.z.recip()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::camera;
    use crate::track::tracks::{Observation, Track};
    use i2slam_check::noise;

    /// A steady turn has one rate, whether or not pictures are missing.
    #[test]
    fn rates_count_in_time_not_in_frames() {
        let camera = camera();
        let timestamps = [0.0, 1.0, 2.0, 5.0, 6.0, 8.0, 9.0, 10.0];
        let turn = Vec3::new(0.002, 0.01, -0.003);
        let track = |n: &[f64]| {
            let ray = camera.unproject(160.0 + 80.0 * n[0], 120.0 + 60.0 * n[1], 1.0);
            let observation = |(frame, time): (usize, &f64)| {
                let (u, v) = camera.project(Rotation::exp(turn * -*time).rotate(ray));
                Observation::new(frame, [u, v], 0.3)
            };
            Track { observations: timestamps.iter().enumerate().map(observation).collect() }
        };
        let tracks = noise(5, 160).chunks_exact(2).map(track).collect();
        let tracks = Tracks { tracks, frames: timestamps.len(), ..Tracks::default() };
        let stamps: Vec<f64> =
            timestamps.iter().zip(noise(6, 8)).map(|(time, n)| time + 0.1 * n).collect();
        let times = whole_intervals(&stamps).expect("several");
        for rate in rotation_rates(&tracks, &tracks.tracks_by_frame(), &camera, &times) {
            assert!((rate - turn).norm() < 1e-5, "{rate:?}");
        }
    }
}

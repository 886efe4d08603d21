//! Rows that are exposed one after the other.
//!
//! A camera with a rolling shutter takes row `r` of `H` at `stamp + readout (r / H - ½)`. The
//! motion between frames tells how far a point moves in that time, so that its position can be
//! given as the middle row's moment would have shown it; the readout is what fits best.

use crate::landmark::Landmark;
use crate::scene::Scene;
use i2slam_compute::median;
use i2slam_geometry::{Pose, Tangent};

/// Distance of the readouts that are compared first, and later [frame intervals].
const COARSE: f64 = 0.6;
const FINE: f64 = 0.2;
/// No readout is longer [frame intervals].
const LONGEST: f64 = 1.0;
/// A readout must lower the cost to this share, or all rows count as exposed together.
pub(crate) const WORTH: f64 = 0.97;
const STEPS: usize = 8;
/// Frames farther apart than so many intervals tell no velocity.
const NEIGHBOUR: f64 = 4.5;

/// The readout that fits best [s], positive if the top row comes first; 0 if none is clearly
/// better than that. Image positions in the scene are corrected for it. `about` is a readout that
/// they have been corrected for already [frame intervals].
pub(crate) fn correct_rolling_shutter(scene: &mut Scene, timestamps: &[f64], about: f64) -> f64 {
    let Some(interval) = interval(timestamps) else { return 0.0 };
    if about != 0.0 {
        return correct_again(scene, timestamps, about * interval);
    }
    let cost = |readout: f64| cost(scene, timestamps, readout, interval);
    let costs = [-COARSE, 0.0, COARSE].map(cost);
    let end = if costs[0] < costs[2] { -COARSE } else { COARSE };
    let best = lowest_of_parabola(COARSE, costs).unwrap_or(end).clamp(-LONGEST, LONGEST);
    let readout = if cost(best) < WORTH * costs[1] { best } else { 0.0 };
    move_rows(scene, timestamps, readout * interval, interval);
    readout * interval
}

/// Looks for a better readout near a known one [s], with the velocities that are known now.
pub(crate) fn correct_again(scene: &mut Scene, timestamps: &[f64], readout: f64) -> f64 {
    let Some(interval) = interval(timestamps).filter(|_| readout != 0.0) else { return readout };
    let about = readout / interval;
    let costs = [about - FINE, about, about + FINE].map(|r| cost(scene, timestamps, r, interval));
    let change = lowest_of_parabola(FINE, costs).unwrap_or(0.0);
    let readout = (about + change).clamp(-LONGEST, LONGEST) * interval;
    move_rows(scene, timestamps, readout, interval);
    readout
}

/// The median time between frames [s].
fn interval(timestamps: &[f64]) -> Option<f64> {
    median(&mut timestamps.windows(2).map(|p| p[1] - p[0]).collect::<Vec<_>>())
}

/// Cost per sight once all is adjusted to a readout [intervals].
fn cost(scene: &Scene, timestamps: &[f64], readout: f64, interval: f64) -> f64 {
    let mut tried = scene.clone();
    move_rows(&mut tried, timestamps, readout * interval, interval);
    let all = tried.posed();
    tried.adjust(&all, false, STEPS)
}

/// Where the parabola through the costs at `-step`, 0 and `step` is lowest, within twice `step`.
pub(crate) fn lowest_of_parabola(step: f64, [before, middle, after]: [f64; 3]) -> Option<f64> {
    let curvature = before - 2.0 * middle + after;
    let lowest = 0.5 * step * (before - after) / curvature;
    (curvature > 0.0 && lowest.is_finite()).then(|| lowest.clamp(-2.0 * step, 2.0 * step))
}

/// Sets every observation's position to that of the middle row's moment.
fn move_rows(scene: &mut Scene, timestamps: &[f64], readout: f64, interval: f64) {
    let velocities: Vec<Option<Tangent<f64>>> =
        (0..scene.poses.len()).map(|f| velocity(scene, timestamps, f, interval)).collect();
    let (camera, poses) = (scene.camera, &scene.poses);
    for (landmark, track) in scene.landmarks.iter().zip(&mut scene.tracks.tracks) {
        for o in &mut track.observations {
            let (Some(pose), Some(velocity)) = (poses[o.frame], velocities[o.frame]) else {
                continue;
            };
            let far = || Landmark::on_ray(&camera, pose, o.seen, 0.0);
            let landmark = landmark.unwrap_or_else(far);
            let late = readout * (o.seen[1] / camera.height as f64 - 0.5);
            let then = pose.retract(velocity.scaled(late));
            let positions =
                (landmark.image_position(&camera, &pose), landmark.image_position(&camera, &then));
            if let (Some(now), Some(then)) = positions {
                o.at = std::array::from_fn(|i| o.seen[i] - (then[i] - now[i]));
            }
        }
    }
}

/// Motion of a frame's camera per second, in its own frame, from its neighbours.
fn velocity(
    scene: &Scene,
    timestamps: &[f64],
    frame: usize,
    interval: f64,
) -> Option<Tangent<f64>> {
    let known = |f: usize| scene.poses[f].map(|p| (timestamps[f], p));
    let here = known(frame)?;
    let before = (0..frame).rev().find_map(known).unwrap_or(here);
    let after = (frame + 1..scene.poses.len()).find_map(known).unwrap_or(here);
    let time = after.0 - before.0;
    let near = |(t, _): &(f64, Pose<f64>)| (t - here.0).abs() < NEIGHBOUR * interval;
    if time <= 0.0 || !near(&before) || !near(&after) {
        return None;
    }
    let moved = after.1.translation - before.1.translation;
    let tangent = Tangent {
        translation: here.1.rotation.inverse().rotate(moved),
        rotation: before.1.local(after.1).rotation,
    };
    Some(tangent.scaled(1.0 / time))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lowest_point_of_a_parabola_is_found() {
        let f = |x: f64| 3.0 * (x - 0.4) * (x - 0.4) + 1.0;
        let lowest = lowest_of_parabola(0.6, [f(-0.6), f(0.0), f(0.6)]);
        assert!((lowest.expect("convex") - 0.4).abs() < 1e-12);
        assert!(lowest_of_parabola(0.6, [0.0, 1.0, 0.0]).is_none());
    }
}

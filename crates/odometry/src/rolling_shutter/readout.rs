//! Rows that are exposed one after the other.
//!
//! A camera with a rolling shutter takes row `r` of `H` at `stamp + readout (r / H - ½)`. The
//! motion between frames tells how far a point moves in that time, so that its position can be
//! given as the middle row's moment would have shown it; the readout is what fits best.

use crate::multiview::landmark::Landmark;
use crate::multiview::lens_distortion::undistorted;
use crate::progress::Stage;
use crate::sfm_state::{MAX_READOUT, Scene};
use i2slam_compute::median;
use i2slam_geometry::{Pose, Tangent};

/// Distance of the readouts that are compared first, and later [frame intervals].
const COARSE: f64 = 0.5;
const FINE: f64 = 0.2;
/// A readout must lower the cost to this share, or all rows count as exposed together.
pub(crate) const WORTH: f64 = 0.97;
const STEPS: usize = 8;
/// A long sequence is judged by so many stretches of so many frames.
const STRETCHES: usize = 3;
const STRETCH: usize = 100;
/// Frames farther apart than so many intervals tell no velocity.
const NEIGHBOUR: f64 = 4.5;

/// Looks for the readout that fits best, together with the focal length if asked, positive if the
/// top row comes first; none if it is not clearly better than that. Image positions in the scene
/// are corrected for it. A readout that they have been corrected for already is where the search
/// begins.
pub(crate) fn correct_rolling_shutter(scene: &mut Scene, timestamps: &[f64], adjust_focal: bool) {
    let Some(interval) = interval(timestamps) else { return };
    scene.progress.report(Stage::RollingShutter, 0, 0);
    let sample = Sample::of(scene, timestamps, interval, adjust_focal);
    let none = sample.cost(0.0);
    let about = scene.readout;
    let (best, cost) = if about == 0.0 { sample.coarse(none) } else { sample.near(about) };
    scene.readout = if cost < WORTH * none { best } else { 0.0 };
    scene.finds_readout = scene.readout != 0.0;
    move_rows(scene, timestamps, scene.readout * interval, interval);
}

/// The frames that decide on the readout: all, or some stretches of a long sequence.
struct Sample<'a> {
    scene: Scene,
    /// All of them but the first of every stretch, which stay.
    free: Vec<usize>,
    timestamps: &'a [f64],
    /// [s]
    interval: f64,
    adjust_focal: bool,
}

impl<'a> Sample<'a> {
    fn of(scene: &Scene, timestamps: &'a [f64], interval: f64, adjust_focal: bool) -> Self {
        let posed = scene.posed();
        let stretches: Vec<&[usize]> = if posed.len() <= STRETCHES * STRETCH {
            vec![&posed]
        } else {
            let parts = posed.chunks(posed.len().div_ceil(STRETCHES));
            parts.map(|part| most_turning(scene, part)).collect()
        };
        let mut sample = scene.clone();
        sample.progress = scene.progress.without_listener();
        sample.poses.fill(None);
        sample.finds_readout = false;
        stretches.iter().copied().flatten().for_each(|f| sample.poses[*f] = scene.poses[*f]);
        let free = stretches.iter().flat_map(|s| s.iter().skip(1)).copied().collect();
        Self { scene: sample, free, timestamps, interval, adjust_focal }
    }

    /// Cost per sight once all is adjusted to a readout [intervals].
    fn cost(&self, readout: f64) -> f64 {
        let mut tried = self.scene.clone();
        move_rows(&mut tried, self.timestamps, readout * self.interval, self.interval);
        tried.adjust(&self.free, self.adjust_focal, STEPS)
    }

    /// The best of all readouts [intervals] and its cost, when that of none is known.
    fn coarse(&self, none: f64) -> (f64, f64) {
        let mut costs = [self.cost(-COARSE), none, self.cost(COARSE)];
        let side = if costs[0] < costs[2] { -COARSE } else { COARSE };
        let (mut middle, end) = (0.0, costs[0].min(costs[2]));
        if end < none {
            let beyond = self.cost(2.0 * side);
            costs = if side < 0.0 { [beyond, end, none] } else { [none, end, beyond] };
            middle = side;
        }
        let change = lowest_of_parabola(COARSE, costs).unwrap_or(0.0).clamp(-COARSE, COARSE);
        let best = (middle + change).clamp(-MAX_READOUT, MAX_READOUT);
        (best, self.cost(best))
    }

    /// The best readout near one [intervals], and the cost of that one.
    fn near(&self, about: f64) -> (f64, f64) {
        let costs = [about - FINE, about, about + FINE].map(|r| self.cost(r));
        let change = lowest_of_parabola(FINE, costs).unwrap_or(0.0);
        ((about + change).clamp(-MAX_READOUT, MAX_READOUT), costs[1])
    }
}

/// The stretch of some frames in which the camera turns most.
fn most_turning<'a>(scene: &Scene, frames: &'a [usize]) -> &'a [usize] {
    let turn = |pair: &[usize]| match (scene.poses[pair[0]], scene.poses[pair[1]]) {
        (Some(a), Some(b)) => a.local(b).rotation.norm_squared(),
        _ => 0.0,
    };
    let turns: Vec<f64> = frames.windows(2).map(turn).collect();
    let begins = (0..frames.len().saturating_sub(STRETCH - 1)).step_by(STRETCH / 4);
    let sum = |begin: &usize| turns[*begin..*begin + STRETCH - 1].iter().sum::<f64>();
    let begin = begins.max_by(|a, b| sum(a).total_cmp(&sum(b))).unwrap_or(0);
    &frames[begin..(begin + STRETCH).min(frames.len())]
}

/// The median time between frames [s].
pub(crate) fn interval(timestamps: &[f64]) -> Option<f64> {
    median(&mut timestamps.windows(2).map(|p| p[1] - p[0]).collect::<Vec<_>>())
}

/// Where the parabola through the costs at `-step`, 0 and `step` is lowest, within twice `step`.
pub(crate) fn lowest_of_parabola(step: f64, [before, middle, after]: [f64; 3]) -> Option<f64> {
    let curvature = before - 2.0 * middle + after;
    let lowest = 0.5 * step * (before - after) / curvature;
    (curvature > 0.0 && lowest.is_finite()).then(|| lowest.clamp(-2.0 * step, 2.0 * step))
}

/// Sets every observation's position to that of the middle row's moment. Where nothing tells how
/// the camera moved, it stays as it was, or becomes what was seen if all rows share one moment.
fn move_rows(scene: &mut Scene, timestamps: &[f64], readout: f64, interval: f64) {
    let velocities: Vec<Option<Tangent<f64>>> =
        (0..scene.poses.len()).map(|f| velocity(scene, timestamps, f, interval)).collect();
    let (camera, lens, poses) = (scene.camera, scene.lens, &scene.poses);
    for (landmark, track) in scene.landmarks.iter().zip(&mut scene.tracks.tracks) {
        for o in &mut track.observations {
            let flat = undistorted(&camera, lens, o.seen);
            if readout == 0.0 {
                o.at = flat;
                continue;
            }
            let (Some(pose), Some(velocity)) = (poses[o.frame], velocities[o.frame]) else {
                continue;
            };
            let far = || Landmark::on_ray(&camera, pose, flat, 0.0);
            let landmark = landmark.unwrap_or_else(far);
            let late = readout * (o.seen[1] / camera.height as f64 - 0.5);
            let then = pose.retract(velocity.scaled(late));
            let positions =
                (landmark.image_position(&camera, &pose), landmark.image_position(&camera, &then));
            if let (Some(now), Some(then)) = positions {
                o.at = std::array::from_fn(|i| flat[i] - (then[i] - now[i]));
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

    use crate::intrinsics::observability::released;
    use crate::register::registration::refine;
    use crate::track::tracks::{Observation, Track, Tracks};
    use i2slam_check::noise;
    use i2slam_geometry::{Camera, Rotation, Vec3};

    /// A camera that shakes on its way; `s` in frames.
    fn path(s: f64) -> Pose<f64> {
        let turn =
            Vec3::new(0.03 * (0.9 * s).sin(), 0.05 * (0.61 * s).cos(), 0.02 * (0.37 * s).sin());
        Pose::new(Rotation::exp(turn), Vec3::new(0.03 * s, 0.05 * (0.4 * s).sin(), 0.0))
    }

    /// `frames` frames with their true poses, their rows exposed within `readout` intervals.
    fn scene(frames: usize, readout: f64) -> (Scene, Vec<f64>) {
        let camera = Camera { width: 320, height: 240, fx: 250.0, fy: 250.0, cx: 160.0, cy: 120.0 };
        let sight = |point: Vec3<f64>, frame: usize, error: &[f64]| {
            let mut at = camera.project(path(frame as f64).inverse() * point);
            for _ in 0..5 {
                let moment = frame as f64 + readout * (at.1 / 240.0 - 0.5);
                at = camera.project(path(moment).inverse() * point);
            }
            let at = [at.0 + 0.1 * error[0], at.1 + 0.1 * error[1]];
            camera.contains(at[0], at[1], 1.0).then(|| Observation::new(frame, at, 0.3))
        };
        let track = |index: usize| {
            let begin = index / 4;
            let n = noise(index as u64, 3 + 24);
            let ray = camera.unproject(160.0 + 150.0 * n[0], 120.0 + 110.0 * n[1], 2.5 + n[2]);
            let point = path(begin as f64) * ray;
            let seen = (begin..(begin + 12).min(frames)).filter_map(|f| {
                let k = 3 + 2 * (f - begin);
                sight(point, f, &n[k..k + 2])
            });
            Track { observations: seen.collect() }
        };
        let tracks = (0..4 * frames).map(track).collect();
        let keyframes = (0..frames).step_by(4).collect();
        let tracks = Tracks { tracks, keyframes, frames, ..Tracks::default() };
        let mut scene = Scene::new(camera, tracks);
        scene.poses = (0..frames).map(|f| Some(path(f as f64))).collect();
        scene.add_landmarks();
        (scene, (0..frames).map(|f| f as f64 / 30.0).collect())
    }

    #[test]
    fn the_readout_of_a_long_sequence_is_found_from_some_stretches() {
        let (mut rolling, timestamps) = scene(420, 0.5);
        correct_rolling_shutter(&mut rolling, &timestamps, false);
        assert!((rolling.readout - 0.5).abs() < 0.05, "{}", rolling.readout);
        assert_eq!(rolling.posed().len(), 420);
    }

    /// Each of both would be found wrong beside a wrong other one.
    #[test]
    fn readout_and_focal_length_are_found_together() {
        let (mut rolling, timestamps) = scene(60, 0.6);
        let wrong = 1.12 * rolling.camera.fx;
        (rolling.camera.fx, rolling.camera.fy) = (wrong, wrong);
        for _ in 0..2 {
            correct_rolling_shutter(&mut rolling, &timestamps, true);
            refine(&mut rolling, true);
        }
        // Speeds are means over two intervals, which are too low where the camera trembles.
        let found = ((rolling.camera.fx / 250.0).ln(), rolling.readout - 0.6);
        assert!(found.0.abs() < 0.01 && found.1.abs() < 0.08, "{found:?}");
        // What is told of the focal length leaves the readout open.
        let (_, covariance) = released(&rolling);
        let covariance = covariance.expect("determined");
        assert!(covariance[1][1] > 0.0 && covariance[0][1] != 0.0);
        rolling.finds_readout = false;
        let (_, alone) = released(&rolling);
        let alone = alone.expect("determined");
        assert!(alone[0][0] < covariance[0][0], "{} {}", alone[0][0], covariance[0][0]);
    }

    #[test]
    fn a_readout_that_explains_nothing_is_given_up() {
        let (mut global, timestamps) = scene(60, 0.0);
        // Frames without a pose, and one without neighbours, tell nothing of their motion.
        global.poses[20..26].fill(None);
        global.poses[30..40].fill(None);
        global.poses[35] = Some(path(35.0));
        for about in [0.0, 0.4] {
            let observations = global.tracks.tracks.iter_mut().flat_map(|t| &mut t.observations);
            observations.for_each(|o| o.at[0] = o.seen[0] + about);
            global.readout = about;
            correct_rolling_shutter(&mut global, &timestamps, false);
            assert_eq!(global.readout, 0.0);
            let observations = global.tracks.tracks.iter().flat_map(|t| &t.observations);
            assert!(observations.clone().all(|o| o.at == o.seen));
        }
    }

    #[test]
    fn the_lowest_point_of_a_parabola_is_found() {
        let f = |x: f64| 3.0 * (x - 0.4) * (x - 0.4) + 1.0;
        let lowest = lowest_of_parabola(0.6, [f(-0.6), f(0.0), f(0.6)]);
        assert!((lowest.expect("convex") - 0.4).abs() < 1e-12);
        assert!(lowest_of_parabola(0.6, [0.0, 1.0, 0.0]).is_none());
    }
}

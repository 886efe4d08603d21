//! Rolling shutter: estimation of the readout and correction of observations.
//!
//! Row `r` of `H` is exposed at `stamp + readout ((r + ½) / H - ½)`. The motion of the camera gives how far
//! a point moves in that time; its position is corrected to the moment of the middle row. The
//! readout of least cost is searched.

use crate::multiview::landmark::{Landmark, MAP_SIGMA, MAX_INLIER_ERROR};
use crate::multiview::lens_distortion::undistort;
use crate::multiview::robust_loss::length;
use crate::progress::Stage;
use crate::rolling_shutter::frame_motion::{FrameMotion, MAX_GAP};
use crate::sfm_state::{MAX_READOUT, SfmState};
use crate::track::tracks::Track;
use i2slam_compute::median;
use i2slam_geometry::{Camera, Pose, StampedPose, interpolate_pose};
use std::sync::Arc;

/// Steps of the first and of later searches [frame intervals].
const COARSE_STEP: f64 = 0.5;
const FINE_STEP: f64 = 0.2;
/// Largest cost relative to a global shutter at which a readout is accepted.
pub(crate) const MAX_COST_RATIO: f64 = 0.97;
/// Fewer frames do not tell the readout from other errors of their few poses.
pub(crate) const MIN_READOUT_FRAMES: usize = 8;
const ADJUSTMENT_STEPS: usize = 8;
/// Stretches of a long sequence that are searched, and frames of each.
const SAMPLE_STRETCHES: usize = 3;
const STRETCH_FRAMES: usize = 100;

/// Estimates the readout from the present one on, with the focal length on demand, and corrects the
/// observations; 0 if not clearly better than a global shutter. A whole film of too few frames tells none.
pub(crate) fn estimate_rolling_shutter(state: &mut SfmState, adjust_focal: bool) {
    if state.tracks.frames < MIN_READOUT_FRAMES {
        return;
    }
    state.progress.report(Stage::RollingShutter, 0, 0);
    if let Some(mut search) = ReadoutSearch::new(state, adjust_focal) {
        while search.step() {}
        search.apply(state);
    }
}

/// Search for the readout of least cost: around none first, or near the present one.
#[derive(Clone, Debug)]
pub(crate) struct ReadoutSearch {
    /// The frames that it is searched with: all, or some stretches of a long sequence.
    state: SfmState,
    /// All of them but the first of every stretch, which stay.
    free: Vec<usize>,
    timestamps: Arc<Vec<f64>>,
    /// Median frame interval [s].
    interval: f64,
    adjust_focal: bool,
    /// Readouts [frame intervals] that were tried, and their costs.
    tried: Vec<(f64, f64)>,
}

impl ReadoutSearch {
    /// A search from the present readout on; `None` of fewer than two frames.
    pub(crate) fn new(state: &SfmState, adjust_focal: bool) -> Option<Self> {
        let timestamps = Arc::clone(&state.timestamps);
        let interval = median_frame_interval(&timestamps)?;
        let posed = state.adjusted_frames();
        let stretches: Vec<&[usize]> = if posed.len() <= SAMPLE_STRETCHES * STRETCH_FRAMES {
            vec![&posed]
        } else {
            let parts = posed.chunks(posed.len().div_ceil(SAMPLE_STRETCHES));
            parts.map(|part| fastest_turning_stretch(state, part)).collect()
        };
        // Frames that are left out of adjustment tell velocities, too.
        let is_within =
            |f: usize| stretches.iter().any(|s| s.first() <= Some(&f) && Some(&f) <= s.last());
        let mut sample = state.within(is_within);
        sample.progress = state.progress.without_listener();
        sample.estimates_readout = false;
        let free = stretches.iter().flat_map(|s| s.iter().skip(1)).copied().collect();
        Some(Self { state: sample, free, timestamps, interval, adjust_focal, tried: Vec::new() })
    }

    /// Tries the next readout; false if there is none left.
    pub(crate) fn step(&mut self) -> bool {
        let next = self.next_readout();
        self.tried.extend(next.map(|readout| (readout, self.cost(readout))));
        next.is_some()
    }

    /// Sets the readout that was found, if it is clearly better than none, and corrects the
    /// observations; nothing where another one was found since the search began.
    pub(crate) fn apply(&self, state: &mut SfmState) {
        let about = self.state.readout;
        if state.readout != about {
            return;
        }
        let best = self.best();
        let accepted = if about == 0.0 { best } else { Some(about) };
        let cost = |readout: f64| self.tried_cost(readout);
        let is_better = accepted
            .and_then(|accepted| Some(cost(accepted)? < MAX_COST_RATIO * cost(0.0)?))
            .unwrap_or(false);
        state.readout = best.filter(|_| is_better).unwrap_or(0.0);
        state.estimates_readout = state.readout != 0.0;
        let timestamps = Arc::clone(&state.timestamps);
        correct_observations(state, &timestamps, state.readout * self.interval, self.interval);
    }

    fn next_readout(&self) -> Option<f64> {
        let is_new = |readout: &f64| self.tried_cost(*readout).is_none();
        let about = self.state.readout;
        let first = match about == 0.0 {
            true => vec![0.0, -COARSE_STEP, COARSE_STEP],
            false => vec![0.0, about - FINE_STEP, about, about + FINE_STEP],
        };
        let found =
            || if about == 0.0 { self.end_beyond().filter(is_new).or(self.best()) } else { None };
        first.into_iter().find(is_new).or_else(found).filter(is_new)
    }

    /// Twice the coarse step on the side that is better than none.
    fn end_beyond(&self) -> Option<f64> {
        let [before, none, after] = [-COARSE_STEP, 0.0, COARSE_STEP].map(|r| self.tried_cost(r));
        let (before, after) = (before?, after?);
        let side = if before < after { -COARSE_STEP } else { COARSE_STEP };
        (before.min(after) < none?).then_some(2.0 * side)
    }

    /// Minimum of the parabola through the readouts around the least cost.
    fn best(&self) -> Option<f64> {
        let about = self.state.readout;
        let (middle, step) = match about == 0.0 {
            true => (self.end_beyond().map_or(0.0, |end| 0.5 * end), COARSE_STEP),
            false => (about, FINE_STEP),
        };
        let [before, there, after] =
            [middle - step, middle, middle + step].map(|r| self.tried_cost(r));
        let change = parabola_minimum(step, [before?, there?, after?]).unwrap_or(0.0);
        // Beyond the range of a coarse search nothing was tried.
        let most = if about == 0.0 { step } else { 2.0 * step };
        Some((middle + change.clamp(-most, most)).clamp(-MAX_READOUT, MAX_READOUT))
    }

    fn tried_cost(&self, readout: f64) -> Option<f64> {
        self.tried.iter().find(|(tried, _)| *tried == readout).map(|(_, cost)| *cost)
    }

    /// Mean cost per observation after adjustment to a readout [intervals].
    fn cost(&self, readout: f64) -> f64 {
        let mut tried = self.state.clone();
        correct_observations(&mut tried, &self.timestamps, readout * self.interval, self.interval);
        tried.adjust(&self.free, self.adjust_focal, ADJUSTMENT_STEPS)
    }
}

/// The stretch of some frames in which the camera turns most.
fn fastest_turning_stretch<'a>(state: &SfmState, frames: &'a [usize]) -> &'a [usize] {
    let turn = |pair: &[usize]| match (state.poses[pair[0]], state.poses[pair[1]]) {
        (Some(a), Some(b)) => a.local(b).rotation.norm_squared(),
        _ => 0.0,
    };
    let turns: Vec<f64> = frames.windows(2).map(turn).collect();
    let begins = (0..frames.len().saturating_sub(STRETCH_FRAMES - 1)).step_by(STRETCH_FRAMES / 4);
    let sum = |begin: &usize| turns[*begin..*begin + STRETCH_FRAMES - 1].iter().sum::<f64>();
    let begin = begins.max_by(|a, b| sum(a).total_cmp(&sum(b))).unwrap_or(0);
    &frames[begin..(begin + STRETCH_FRAMES).min(frames.len())]
}

/// Median time between frames [s].
pub(crate) fn median_frame_interval(timestamps: &[f64]) -> Option<f64> {
    median(&mut timestamps.windows(2).map(|p| p[1] - p[0]).collect::<Vec<_>>())
}

/// Minimum of the parabola through the costs at `-step`, 0 and `step`, within twice `step`.
pub(crate) fn parabola_minimum(step: f64, [before, middle, after]: [f64; 3]) -> Option<f64> {
    let curvature = before - 2.0 * middle + after;
    let lowest = 0.5 * step * (before - after) / curvature;
    (curvature > 0.0 && lowest.is_finite()).then(|| lowest.clamp(-2.0 * step, 2.0 * step))
}

/// Corrects all observations with known velocity to the middle row; readout 0 only undistorts.
pub(crate) fn correct_observations(
    state: &mut SfmState,
    timestamps: &[f64],
    readout: f64,
    interval: f64,
) {
    for frame in 0..state.poses.len() {
        correct_observations_in(state, frame, timestamps, (readout, interval));
    }
}

/// Corrects the observations of one frame to the middle row, for a readout and an interval [s].
pub(crate) fn correct_observations_in(
    state: &mut SfmState,
    frame: usize,
    timestamps: &[f64],
    (readout, interval): (f64, f64),
) {
    let around = || FrameMotion::new(&state.poses, timestamps, frame, interval);
    let motion = if readout == 0.0 { None } else { around() };
    let (camera, distortion, by_frame) =
        (state.camera, state.distortion, Arc::clone(&state.by_frame));
    for index in &by_frame[frame] {
        let (track, landmark) = (&mut state.tracks.tracks[*index], &state.landmarks[*index]);
        let Some(o) = track.observation_in(frame) else { continue };
        let flat = undistort(&camera, distortion, o.raw());
        let late = readout * (o.raw()[1] / camera.height as f64 - 0.5);
        let moved = match &motion {
            Some(motion) => {
                let tracked = tracked_velocity(track, frame, timestamps);
                let tracked = tracked
                    .map(|v| (v.map(|v| v * late), MAX_INLIER_ERROR * o.sigma().hypot(MAP_SIGMA)));
                let landmark = (landmark.as_ref(), flat);
                picture_motion(&camera, motion, landmark, late, tracked)
            }
            None => (readout == 0.0).then_some([0.0; 2]),
        };
        if let (Some(moved), Some(o)) = (moved, track.observation_in_mut(frame)) {
            *o = o.moved_to([flat[0] - moved[0], flat[1] - moved[1]]);
        }
    }
}

/// Motion of a point in the picture some time after a frame [px], by its landmark. By a point at infinity
/// on its ray instead, where there is no landmark, or where its motion is farther from the `tracked` one by
/// more than the error given with that.
///
/// A landmark of wrong depth close to the camera would move by thousands of pixels.
fn picture_motion(
    camera: &Camera<f64>,
    motion: &FrameMotion,
    (landmark, at): (Option<&Landmark>, [f64; 2]),
    late: f64,
    tracked: Option<([f64; 2], f64)>,
) -> Option<[f64; 2]> {
    let (now, then) = (motion.world_from_camera, motion.pose_at(late));
    let moved = |landmark: &Landmark| {
        let [now, then] = [now, then].map(|pose| landmark.image_position(camera, &pose));
        now.zip(then).map(|(now, then)| [then[0] - now[0], then[1] - now[1]])
    };
    let far = || moved(&Landmark::on_ray(camera, now, at, 0.0));
    let is_tracked = |near: &[f64; 2]| {
        tracked.is_none_or(|(tracked, error)| {
            let off = |moved: &[f64; 2]| length([moved[0] - tracked[0], moved[1] - tracked[1]]);
            let is_nearer = |far: [f64; 2]| off(near) <= off(&far) + error;
            off(near) <= error || far().is_none_or(is_nearer)
        })
    };
    landmark.and_then(moved).filter(is_tracked).or_else(far)
}

/// Velocity of a point in the picture between its observations before and after a frame [px/s].
fn tracked_velocity(track: &Track, frame: usize, timestamps: &[f64]) -> Option<[f64; 2]> {
    let all = &track.observations;
    let place = all.partition_point(|o| o.frame < frame);
    let from = all.get(place.saturating_sub(1))?;
    let to = all.get(place + 1).or(all.last())?;
    let time = timestamps[to.frame] - timestamps[from.frame];
    let (from, to) = (from.raw(), to.raw());
    (time > 0.0).then(|| std::array::from_fn(|i| (to[i] - from[i]) / time))
}

/// The pose of a frame's camera some time `later` \[s\], on the parabola through it and the frames
/// before and after; `None` where those are far away in median frame intervals [s].
///
/// Poses are corrected by what they predict here: through more frames, errors that alternate from
/// frame to frame would grow by that from round to round.
pub(crate) fn pose_later(
    poses: &[Option<Pose<f64>>],
    timestamps: &[f64],
    frame: usize,
    (later, interval): (f64, f64),
) -> Option<Pose<f64>> {
    let known = |f: usize| {
        Some(StampedPose { timestamp: timestamps[f], world_from_camera: (*poses.get(f)?)? })
    };
    let here = known(frame)?;
    let is_near = |p: &StampedPose| (p.timestamp - here.timestamp).abs() < MAX_GAP * interval;
    let before = (0..frame).rev().find_map(known).filter(is_near);
    let after = (frame + 1..poses.len()).find_map(known).filter(is_near);
    let path: Vec<StampedPose> = before.into_iter().chain([here]).chain(after).collect();
    interpolate_pose(&path, here.timestamp + later)
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::fixtures::{self, camera};
    use crate::intrinsics::observability::reestimate_intrinsics;
    use crate::register::registration::adjust_path;
    use crate::track::tracks::Observation;
    use i2slam_geometry::{Rotation, Vec3};

    /// A camera that shakes on its way; `s` in frames.
    fn path(s: f64) -> Pose<f64> {
        let turn =
            Vec3::new(0.03 * (0.9 * s).sin(), 0.05 * (0.61 * s).cos(), 0.02 * (0.37 * s).sin());
        Pose::new(Rotation::exp(turn), Vec3::new(0.03 * s, 0.05 * (0.4 * s).sin(), 0.0))
    }

    /// `frames` frames with their true poses, their rows exposed within `readout` intervals.
    fn state(frames: usize, readout: f64) -> SfmState {
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let mut at = camera().project(path(frame as f64).inverse() * point);
            for _ in 0..5 {
                let moment = frame as f64 + readout * (at.1 / 240.0 - 0.5);
                at = camera().project(path(moment).inverse() * point);
            }
            let at = [at.0 + 0.1 * n[0], at.1 + 0.1 * n[1]];
            camera().contains(at[0], at[1], 1.0).then_some(at)
        };
        let pose = |frame: usize| path(frame as f64);
        let timestamps = Arc::new((0..frames).map(|f| f as f64 / 30.0).collect());
        SfmState { timestamps, ..fixtures::state((frames, 4, 4), [150.0, 110.0], pose, observe) }
    }

    #[test]
    fn the_readout_of_a_long_sequence_is_found_from_some_stretches() {
        let mut rolling = state(420, 0.5);
        estimate_rolling_shutter(&mut rolling, false);
        assert!((rolling.readout - 0.5).abs() < 0.05, "{}", rolling.readout);
        assert_eq!(rolling.posed_frames().len(), 420);
    }

    #[test]
    fn a_few_frames_tell_no_readout() {
        for (frames, found) in [(MIN_READOUT_FRAMES - 1, 0.0), (60, 0.5)] {
            let mut rolling = state(frames, 0.5);
            estimate_rolling_shutter(&mut rolling, false);
            assert!((rolling.readout - found).abs() < 0.05, "{frames}: {}", rolling.readout);
        }
    }

    /// Each would be wrong if the other were fixed at a wrong value.
    #[test]
    fn readout_and_focal_length_are_found_together() {
        let mut rolling = state(60, 0.6);
        let wrong = 1.12 * rolling.camera.fx;
        (rolling.camera.fx, rolling.camera.fy) = (wrong, wrong);
        for _ in 0..2 {
            estimate_rolling_shutter(&mut rolling, true);
            adjust_path(&mut rolling, true);
        }
        let found = ((rolling.camera.fx / 250.0).ln(), rolling.readout - 0.6);
        assert!(found.0.abs() < 0.01 && found.1.abs() < 0.04, "{found:?}");
        // The covariance leaves the readout free.
        let (_, covariance) = reestimate_intrinsics(rolling.clone());
        let covariance = covariance.expect("determined");
        assert!(covariance[1][1] > 0.0 && covariance[0][1] != 0.0);
        rolling.estimates_readout = false;
        let (_, alone) = reestimate_intrinsics(rolling);
        let alone = alone.expect("determined");
        assert_eq!([alone[1][1], alone[0][1]], [0.0; 2]);
        for (error, variance) in [(found.0, covariance[0][0]), (found.1, covariance[1][1])] {
            assert!(error.abs() < 4.0 * variance.sqrt(), "{found:?} {covariance:?}");
        }
    }

    /// A landmark right before the camera would move by hundreds of pixels, and no step of an adjustment
    /// would bring its observations together again.
    #[test]
    fn a_landmark_of_wrong_depth_does_not_carry_its_observations_away() {
        let mut rolling = state(20, 0.6);
        let (timestamps, interval) = (Arc::clone(&rolling.timestamps), 1.0 / 30.0);
        let positions = |state: &SfmState| -> Vec<[f64; 2]> {
            state.tracks.tracks.iter().flat_map(|t| &t.observations).map(Observation::at).collect()
        };
        correct_observations(&mut rolling, &timestamps, 0.6 * interval, interval);
        let due = positions(&rolling);
        let centre = path(10.0).translation;
        for landmark in rolling.landmarks.iter_mut().flatten() {
            let ray = (landmark.position() - centre) * 2e-3;
            landmark.values[2] = (ray + centre - landmark.origin).norm().recip();
        }
        correct_observations(&mut rolling, &timestamps, 0.6 * interval, interval);
        for (found, due) in positions(&rolling).iter().zip(due) {
            let off = length([found[0] - due[0], found[1] - due[1]]);
            assert!(off < 4.0, "{off}");
        }
    }

    #[test]
    fn a_readout_that_explains_nothing_is_given_up() {
        let mut global = state(60, 0.0);
        // Frames without a pose, and one without neighbours, have no known velocity.
        global.poses[20..26].fill(None);
        global.poses[30..40].fill(None);
        global.poses[35] = Some(path(35.0));
        for about in [0.0, 0.4] {
            let observations = global.tracks.tracks.iter_mut().flat_map(|t| &mut t.observations);
            observations.for_each(|o| *o = o.moved_to([o.raw()[0] + about, o.at()[1]]));
            global.readout = about;
            estimate_rolling_shutter(&mut global, false);
            assert_eq!(global.readout, 0.0);
            let observations = global.tracks.tracks.iter().flat_map(|t| &t.observations);
            assert!(observations.clone().all(|o| o.at() == o.raw()));
        }
    }
}

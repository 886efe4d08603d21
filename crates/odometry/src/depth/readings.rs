//! Depth readings of observations, compared with the landmarks that they see.

use crate::depth::sensor_model::DepthModel;
use crate::multiview::landmark::Landmark;
use crate::multiview::lens_distortion::undistort;
use crate::rolling_shutter::readout::{median_frame_interval, pose_later};
use crate::sfm_state::SfmState;
use crate::track::tracks::{DepthReading, Observation};
use i2slam_geometry::{Camera, Pose};
use std::sync::Arc;

/// Difference to the landmark from which on a reading shows something else [standard deviations].
pub(super) const MAX_READING_ERROR: f64 = 6.0;
/// Readings of a landmark from which on their residuals tell the sensor's deviation.
const MIN_READINGS_PER_LANDMARK: usize = 4;

/// Gives every observation of a frame with a depth picture its reading; readings that contradict a
/// landmark are left out, and all of them while the map has no unit of length.
///
/// A depth picture taken at another time than the colour picture is read where the landmark was
/// then, and the reading is corrected by how much nearer the landmark came in between.
pub(crate) fn read_depth(state: &mut SfmState) {
    let Some(interval) = median_frame_interval(&state.timestamps) else { return };
    if state.has_depth() {
        (0..state.poses.len()).for_each(|frame| read_depth_in(state, frame, interval));
    }
}

/// Gives the observations of one frame their readings, at a median frame interval [s].
pub(crate) fn read_depth_in(state: &mut SfmState, frame: usize, interval: f64) {
    read_depth_within(state, frame, interval, MAX_READING_ERROR);
}

/// As [`read_depth_in`], for a frame whose pose is a prediction: landmarks seen from there contradict
/// no reading.
pub(crate) fn read_depth_at_prediction(state: &mut SfmState, frame: usize, interval: f64) {
    read_depth_within(state, frame, interval, f64::INFINITY);
}

/// Reads depth that differs from landmarks by at most so many standard deviations.
fn read_depth_within(state: &mut SfmState, frame: usize, interval: f64, max_error: f64) {
    let (maps, by_frame) = (Arc::clone(&state.depth_maps), Arc::clone(&state.by_frame));
    let Some(map) = maps.get(frame).and_then(Option::as_ref) else { return };
    if by_frame[frame].is_empty() {
        return;
    }
    let map = map.readings();
    let poses = poses_at_both_times(state, frame, interval);
    let (camera, distortion, model) = (state.camera, state.distortion, &state.depth_model);
    for track in &by_frame[frame] {
        let landmark = state.landmarks[*track].as_ref();
        let Some(o) = state.tracks.tracks[*track].observation_in_mut(frame) else { continue };
        let mut at = position_in_depth_picture(&camera, distortion, model, o);
        let view = landmark.zip(poses.as_ref());
        let between = view.and_then(|(landmark, poses)| motion(&camera, landmark, poses));
        let (moved, nearer) = between.unwrap_or_default();
        (0..2).for_each(|i| at[i] += moved[i]);
        let read = map.inverse_at(at).map(|inverse| inverse - nearer);
        let depth = read
            .filter(|inverse| *inverse > 0.0 && !state.is_unscaled)
            .map(|inverse| DepthReading { inverse, sigma: model.sigma(inverse) });
        *o = o.with_depth(depth);
        let residual = view.and_then(|(landmark, [pose, _])| residual(landmark, pose, o));
        *o = o.with_depth(
            depth.filter(|reading| residual.is_none_or(|r| r.abs() <= max_error * reading.sigma)),
        );
    }
}

/// Position of an observation in a depth picture that was taken with its colour picture [px].
pub(super) fn position_in_depth_picture(
    camera: &Camera<f64>,
    distortion: [f64; 2],
    model: &DepthModel,
    o: &Observation,
) -> [f64; 2] {
    let flat = undistort(camera, distortion, o.raw());
    std::array::from_fn(|i| o.raw()[i] + o.at()[i] - flat[i] + model.shift[i])
}

/// Updates the sensor's deviations from all registered frames, and reads depth anew.
pub(crate) fn update_depth_model(state: &mut SfmState) {
    if !state.has_depth() {
        return;
    }
    let mut residuals = Vec::new();
    for (landmark, track) in state.landmarks.iter().zip(&state.tracks.tracks) {
        let seen =
            track.observations.iter().filter(|o| !o.is_outlier && state.is_adjusted(o.frame));
        let off = |o: &Observation| {
            let view = landmark.as_ref().zip(state.poses[o.frame].as_ref());
            view.and_then(|(landmark, pose)| {
                Some([o.depth()?.inverse, residual(landmark, pose, o)?])
            })
        };
        let of_landmark: Vec<[f64; 2]> = seen.filter_map(off).collect();
        // A landmark lies where its first readings say.
        if of_landmark.len() >= MIN_READINGS_PER_LANDMARK {
            residuals.extend(of_landmark);
        }
    }
    state.depth_model.fit_deviation(residuals);
    read_depth(state);
}

/// Inverse depth of a landmark in a frame minus the one read there.
fn residual(landmark: &Landmark, pose: &Pose<f64>, o: &Observation) -> Option<f64> {
    Some(landmark.inverse_depth_in(pose) - o.depth()?.inverse)
}

/// Poses of a frame when its colour and its depth picture were taken.
fn poses_at_both_times(state: &SfmState, frame: usize, interval: f64) -> Option<[Pose<f64>; 2]> {
    let (pose, map) = (state.poses[frame]?, state.depth_maps.get(frame)?.as_ref()?);
    let stamp = state.timestamps.get(frame)?;
    let later = map.timestamp + state.depth_model.delay - stamp;
    Some([pose, pose_later(&state.poses, &state.timestamps, frame, (later, interval))?])
}

/// Change of image position [px] and inverse depth of a landmark from one pose to the other.
fn motion(
    camera: &Camera<f64>,
    landmark: &Landmark,
    poses: &[Pose<f64>; 2],
) -> Option<([f64; 2], f64)> {
    let at = |pose: &Pose<f64>| landmark.image_position(camera, pose);
    let (now, then) = (at(&poses[0])?, at(&poses[1])?);
    let [before, after] = poses.each_ref().map(|pose| landmark.inverse_depth_in(pose));
    Some((std::array::from_fn(|i| then[i] - now[i]), after - before))
}

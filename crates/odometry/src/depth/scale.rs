//! Unit of length of a map that began by parallax, where depth is measured later.
//!
//! The scale is the median of `z / ẑ` over the landmarks, with `z` as read and `ẑ` in the map; it
//! holds where readings agree with the scaled landmarks as readings of a metric map have to.

use crate::depth::readings::{MAX_READING_ERROR, position_in_depth_picture, read_depth};
use crate::multiview::landmark::Landmark;
use crate::sfm_state::{MIN_MEASURED_LANDMARKS, SfmState};
use crate::track::tracks::{Observation, Track};
use i2slam_compute::median;
use i2slam_geometry::{Pose, Similarity};

/// Scales a map without a unit of length to metres and reads depth, where enough landmarks and most
/// of those with a reading agree on the scale; returns whether they do.
pub(crate) fn scale_to_readings(state: &mut SfmState) -> bool {
    if !state.is_unscaled || !state.has_depth() {
        return false;
    }
    let readings = first_readings(state);
    let mut ratios: Vec<f64> = readings.iter().map(|[read, known]| known / read).collect();
    let Some(scale) = median(&mut ratios) else { return false };
    let agrees = |[read, known]: &&[f64; 2]| {
        (known / scale - read).abs() <= MAX_READING_ERROR * state.depth_model.sigma(*read)
    };
    let agreeing = readings.iter().filter(agrees).count();
    if agreeing < MIN_MEASURED_LANDMARKS || 2 * agreeing < readings.len() {
        return false;
    }
    state.is_unscaled = false;
    state.transform(&Similarity::from_pose(Pose::identity(), scale));
    read_depth(state);
    true
}

/// Inverse depth as read [1/m] and in the map, of every landmark where it is read first. The motion
/// between colour and depth picture is left to the adjustment that follows.
fn first_readings(state: &SfmState) -> Vec<[f64; 2]> {
    let reading = |landmark: &Landmark, o: &Observation| {
        let (pose, map) = (state.poses[o.frame]?, state.depth_maps.get(o.frame)?.as_ref()?);
        let model = &state.depth_model;
        let at = position_in_depth_picture(&state.camera, state.distortion, model, o);
        let both = [map.readings().inverse_at(at)?, landmark.inverse_depth_in(&pose)];
        both.iter().all(|inverse| *inverse > 0.0).then_some(both)
    };
    let first = |(landmark, track): (&Option<Landmark>, &Track)| {
        let landmark = landmark.as_ref()?;
        let mut inliers = track.observations.iter().filter(|o| !o.is_outlier);
        inliers.find_map(|o| reading(landmark, o))
    };
    state.landmarks.iter().zip(&state.tracks.tracks).filter_map(first).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth::depth_map::{DepthMap, DepthPicture};
    use crate::fixtures::{self, camera};
    use i2slam_check::noise;
    use i2slam_geometry::{Image, Rotation, Vec3};
    use i2slam_storage::ScratchStore;
    use std::sync::Arc;

    const FRAMES: usize = 12;

    fn path(frame: usize) -> Pose<f64> {
        let s = frame as f64;
        Pose::new(Rotation::exp(Vec3::new(0.0, 0.01 * s, 0.0)), Vec3::new(0.05 * s, 0.0, 0.01 * s))
    }

    /// A map of an arbitrary unit, with depth of the last frames whose logarithm errs by `error`.
    fn state(error: f64) -> SfmState {
        let observe = |point: Vec3<f64>, frame: usize, _: &[f64]| {
            let (u, v) = camera().project(path(frame).inverse() * point);
            camera().contains(u, v, 2.0).then_some([u, v])
        };
        let mut state = fixtures::state((FRAMES, 20, 1), [120.0, 90.0], path, observe);
        let picture = |frame: usize| {
            let mut depth = Image::new(320, 240, 1);
            for (track, o) in state.observations_in(frame) {
                let Some(landmark) = &state.landmarks[track] else { continue };
                let off = (error * noise(track as u64, 1)[0]).exp();
                let z = off / landmark.inverse_depth_in(&path(frame));
                let [column, row] = o.at().map(|v| v as usize);
                for (c, r) in
                    [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (2, 1), (0, 2), (1, 2), (2, 2)]
                {
                    depth.data[(row + r - 1) * 320 + column + c - 1] = z as f32;
                }
            }
            DepthMap::new(
                &DepthPicture { depth: &depth, timestamp: frame as f64 },
                &ScratchStore::in_memory(),
            )
        };
        let maps = (0..FRAMES).map(|frame| (frame >= 8).then(|| picture(frame))).collect();
        state.depth_maps = Arc::new(maps);
        state.timestamps = Arc::new((0..FRAMES).map(|frame| frame as f64).collect());
        state.transform(&Similarity::from_pose(Pose::identity(), 7.0));
        state.is_unscaled = true;
        state
    }

    #[test]
    fn a_map_takes_the_scale_on_which_readings_agree() {
        let mut agreeing = state(0.05);
        assert!(scale_to_readings(&mut agreeing));
        for (frame, pose) in agreeing.poses.iter().enumerate() {
            let off = (pose.expect("a pose").translation - path(frame).translation).norm();
            assert!(off < 0.01, "frame {frame} is off by {off}");
        }
        assert!(agreeing.is_metric() && !scale_to_readings(&mut agreeing));
    }

    #[test]
    fn readings_that_contradict_one_another_give_no_scale() {
        let mut contradicting = state(1.5);
        read_depth(&mut contradicting);
        assert!(!scale_to_readings(&mut contradicting));
        assert!(contradicting.is_unscaled && !contradicting.is_metric());
    }
}

//! Landmarks too near to be points of the scene.
//!
//! A wrong track of a few frames is explained best by a point right before the camera, which a small motion
//! takes anywhere in the picture. The nearer it is, the more a residual of it weighs against a motion of the
//! camera, without bound: three frames that see such a point end with one centre, however they moved.

use super::SfmState;
use crate::multiview::landmark::Landmark;
use crate::track::tracks::Track;
use i2slam_compute::median;
use rayon::prelude::*;

/// Median depth of the landmarks of a frame over the depth of one, at most: of a room 3 m deep, points nearer
/// than 10 cm are none.
const MAX_DEPTH_RATIO: f64 = 30.0;
/// Fewest landmarks that tell the depth of a frame.
const MIN_LANDMARKS: usize = 8;

/// Largest inverse depth of a point in each frame.
pub(super) struct NearestDepths(Vec<f64>);

impl NearestDepths {
    /// By the landmarks of all adjusted frames.
    pub(super) fn new(state: &SfmState) -> Self {
        let of_frame = |frame: usize| {
            let pose = state.poses[frame].filter(|_| state.is_adjusted(frame))?;
            let landmarks =
                state.by_frame[frame].iter().filter_map(|i| state.landmarks[*i].as_ref());
            let mut depths: Vec<f64> = landmarks.map(|l| l.inverse_depth_in(&pose)).collect();
            let typical = median(&mut depths).filter(|d| *d > 0.0)?;
            (depths.len() >= MIN_LANDMARKS).then_some(MAX_DEPTH_RATIO * typical)
        };
        let frames = (0..state.poses.len()).into_par_iter();
        Self(frames.map(|frame| of_frame(frame).unwrap_or(f64::INFINITY)).collect())
    }

    /// True if a landmark is nearer than a point can be, in one of the adjusted frames that observe it.
    pub(super) fn exclude(&self, state: &SfmState, landmark: &Landmark, track: &Track) -> bool {
        let seen = track.observations.iter().filter(|o| state.is_adjusted(o.frame));
        seen.filter_map(|o| Some((o.frame, state.poses[o.frame]?)))
            .any(|(frame, pose)| landmark.inverse_depth_in(&pose) > self.0[frame])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{camera, state};
    use crate::track::tracks::Observation;
    use i2slam_geometry::{Pose, Rotation, Vec3};

    fn at(frame: usize) -> Pose<f64> {
        Pose::new(Rotation::identity(), Vec3::new(0.05 * frame as f64, 0.0, 0.0))
    }

    /// Both are explained by a point between two cameras without a residual.
    #[test]
    fn points_right_before_the_camera_are_none() {
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = camera().project(at(frame).inverse() * point);
            Some([u + 0.2 * n[0], v + 0.2 * n[1]])
        };
        let mut film = state((10, 12, 1), [25.0, 20.0], at, observe);
        for (depth, is_point) in [(0.1, true), (0.05, false)] {
            let point = Vec3::new(0.225, 0.0, depth);
            let seen = |frame: usize| {
                let (u, v) = camera().project(at(frame).inverse() * point);
                Observation::new(frame, [u, v], 0.3)
            };
            film.tracks.tracks[50].observations = [4, 5].map(seen).to_vec();
            film.landmarks[50] = None;
            film.triangulate_missing();
            assert_eq!(film.landmarks[50].is_some(), is_point, "{depth}");
            film.landmarks[50] =
                Some(Landmark::on_ray(&camera(), at(4), seen(4).at(), depth.recip()));
            film.reject_outliers();
            assert_eq!(film.landmarks[50].is_some(), is_point, "{depth}");
        }
    }
}

//! Landmarks of the last keyframes, searched in a frame where a predicted pose shows them: a frame whose
//! points were lost is posed by them.

use crate::multiview::landmark::{Match, warp_between_views};
use crate::multiview::pnp::{pose_of_samples, solve_pnp};
use crate::register::registration::initial_poses;
use crate::relocalize::geometric_verification::rolling_shutter_offset;
use crate::sfm_state::SfmState;
use crate::track::patch::AffineWarp;
use crate::track::tracker::Tracker;
use crate::track::tracker::predicted_points::{FoundPoint, PredictedPoint};
use i2slam_geometry::{Pose, Rotation, Vec3};
use std::collections::BTreeMap;

/// Hypotheses of the pose.
const HYPOTHESES: usize = 300;
/// Adjustments of the pose, each to the landmarks that are found near where it shows them.
const ADJUSTMENTS: usize = 2;
/// Landmarks that must be found.
const MIN_FOUND: usize = 12;
/// Distance of a landmark from where it is predicted [px].
const MAX_DISTANCE: f32 = 4.0;
/// Displacement of all predictions at which landmarks are found by chance [px].
const CHANCE_DISPLACEMENT: f32 = 12.0;
/// Distance from the edge within which no landmark is searched [px].
const BORDER: f64 = 8.0;

/// Pose of the last frame of the tracker by landmarks of the last keyframes, and those found; `None` where as
/// many might be found by chance.
pub(super) fn localize(
    state: &SfmState,
    tracker: &Tracker,
    frame: usize,
) -> Option<(Pose<f64>, Vec<FoundPoint>)> {
    let map = LocalMap { state, tracker, frame };
    let sampled = map.predicted_poses().into_iter().filter_map(|start| map.sampled_pose(start));
    let mut pose = sampled.max_by_key(|(inliers, _)| *inliers)?.1;
    let mut found = Vec::new();
    for _ in 0..ADJUSTMENTS {
        found = map.search(&map.predict(&pose), MAX_DISTANCE);
        let solved = solve_pnp(&state.camera, pose, &map.matches(&found), state.noise_scale)?;
        pose = solved.world_from_camera;
    }
    let most = map.found_by_chance(&pose) as f64;
    let is_certain =
        found.len() >= MIN_FOUND && found.len() as f64 > 2.0 * most + 3.0 * most.sqrt();
    is_certain.then_some((pose, found))
}

/// Landmarks of the keyframes whose pictures the tracker keeps, around its last frame.
#[derive(Clone, Copy)]
struct LocalMap<'a> {
    state: &'a SfmState,
    tracker: &'a Tracker,
    frame: usize,
}

impl LocalMap<'_> {
    /// Poses where the frame may be: at constant velocity, and where the last one with a pose was, turned as
    /// the picture has moved since.
    fn predicted_poses(&self) -> Vec<Pose<f64>> {
        let Self { state, tracker, frame } = *self;
        let mut poses: Vec<Pose<f64>> = initial_poses(state, frame).into_iter().take(1).collect();
        let last = (0..frame).rev().find_map(|f| Some((f, state.poses[f]?)));
        let moved = last.and_then(|(f, pose)| Some((pose, tracker.translation_over(frame - f)?)));
        poses.extend(moved.map(|(pose, [x, y])| {
            let [x, y] = [f64::from(x) / state.camera.fx, f64::from(y) / state.camera.fy];
            Pose::new(pose.rotation * Rotation::exp(Vec3::new(y, -x, 0.0)), pose.translation)
        }));
        poses
    }

    /// The pose that most landmarks found around their predictions from `start` agree with, and their number.
    fn sampled_pose(&self, start: Pose<f64>) -> Option<(usize, Pose<f64>)> {
        let found = self.search(&self.predict(&start), f32::INFINITY);
        let matches = self.matches(&found);
        let (pose, inliers) = pose_of_samples(&self.state.camera, &[start], &matches, HYPOTHESES)?;
        Some((inliers.len(), pose))
    }

    /// Landmarks seen from a pose, each as the sharpest of the keyframes shows it.
    fn predict(&self, pose: &Pose<f64>) -> Vec<PredictedPoint> {
        let is_posed = |f: &(usize, f32)| f.0 < self.frame && self.state.poses[f.0].is_some();
        let mut keyframes: Vec<(usize, f32)> =
            self.tracker.kept_keyframes().filter(is_posed).collect();
        keyframes.sort_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
        let mut points = BTreeMap::new();
        for (keyframe, _) in keyframes {
            for (track, o) in self.state.observations_in(keyframe).filter(|(_, o)| !o.is_outlier) {
                if points.contains_key(&track) {
                    continue;
                }
                let at = o.raw().map(|v| v as f32);
                let warp = self.predicted_warp(track, keyframe, pose);
                points
                    .extend(warp.map(|warp| (track, PredictedPoint { track, keyframe, at, warp })));
            }
        }
        points.into_values().collect()
    }

    /// Warp of the surroundings of a landmark from a keyframe into the picture seen from a pose, rows
    /// included; `None` outside of it.
    fn predicted_warp(
        &self,
        track: usize,
        keyframe: usize,
        pose: &Pose<f64>,
    ) -> Option<AffineWarp> {
        let camera = &self.state.camera;
        let landmark = self.state.landmarks[track].as_ref()?;
        let at = landmark.image_position(camera, pose)?;
        let from = self.state.poses[keyframe].as_ref()?;
        let matrix = warp_between_views(camera, landmark, from, pose)?;
        let rows = self.rows(at);
        let centre = std::array::from_fn(|i| (at[i] + rows[i]) as f32);
        camera.contains(at[0], at[1], BORDER).then_some(AffineWarp { matrix, centre })
    }

    /// Correction of the rows around a position of the frame [px].
    fn rows(&self, at: [f64; 2]) -> [f64; 2] {
        rolling_shutter_offset(self.state, self.frame, at)
    }

    /// Predicted landmarks found within a distance [px], with their rows corrected.
    fn search(&self, points: &[PredictedPoint], most: f32) -> Vec<FoundPoint> {
        let corrected = |found: FoundPoint| {
            let raw = found.observation.raw();
            let rows = self.rows(raw);
            let at = std::array::from_fn(|i| raw[i] - rows[i]);
            FoundPoint { observation: found.observation.moved_to(at), ..found }
        };
        self.tracker.search_predicted(points, most).into_iter().map(corrected).collect()
    }

    /// Most landmarks that are found as near to their predictions where all of these are displaced.
    fn found_by_chance(&self, pose: &Pose<f64>) -> usize {
        let points = self.predict(pose);
        let by = CHANCE_DISPLACEMENT;
        let found = |[x, y]: [f32; 2]| {
            let displaced = |point: &PredictedPoint| {
                let [u, v] = point.warp.centre;
                PredictedPoint {
                    warp: AffineWarp { centre: [u + x, v + y], ..point.warp },
                    ..*point
                }
            };
            let displaced: Vec<PredictedPoint> = points.iter().map(displaced).collect();
            self.tracker.search_predicted(&displaced, MAX_DISTANCE).len()
        };
        [[by, 0.0], [-by, 0.0], [0.0, by], [0.0, -by]].map(found).into_iter().fold(0, usize::max)
    }

    fn matches<'b>(&'b self, found: &'b [FoundPoint]) -> Vec<Match<'b>> {
        let landmark = |f: &FoundPoint| self.state.landmarks[f.point.track].as_ref();
        found.iter().filter_map(|f| Some((landmark(f)?, &f.observation))).collect()
    }
}

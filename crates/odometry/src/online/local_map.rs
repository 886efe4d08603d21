//! Landmarks of the last keyframes, searched in a frame where a predicted pose shows them: a frame whose
//! points were lost is registered by them (ORB-SLAM's local map).

use crate::multiview::landmark::{
    Landmark, MAX_INLIER_ERROR, Match, registration_error, warp_between_views,
};
use crate::multiview::pnp::{pose_of_samples, solve_pnp};
use crate::register::registration::initial_poses;
use crate::rolling_shutter::frame_motion::FrameMotion;
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

/// Landmarks of the keyframes whose pictures the tracker keeps, around its last frame, which has no pose.
#[derive(Clone, Copy)]
pub(super) struct LocalMap<'a> {
    pub(super) state: &'a SfmState,
    pub(super) tracker: &'a Tracker,
    pub(super) frame: usize,
    /// Median frame interval [s].
    pub(super) interval: f64,
}

/// Pose of the last frame by landmarks of the last keyframes, and those found where it shows them; it is
/// predicted from the frames before and tried at `start`, too. `None` where twice as many, and three deviations
/// more, are not found with all predictions displaced, as chance would have it.
pub(super) fn track_local_map(
    map: &LocalMap<'_>,
    start: Option<Pose<f64>>,
) -> Option<(Pose<f64>, Vec<FoundPoint>)> {
    let starts = map.predicted_poses()?.into_iter().chain(start);
    let sampled = starts.filter_map(|start| map.sampled_pose(start));
    let mut pose = sampled.max_by_key(|(inliers, _)| *inliers)?.1;
    let mut found = Vec::new();
    for _ in 0..ADJUSTMENTS {
        found = map.search(&pose, [0.0; 2], MAX_DISTANCE);
        let noise = map.state.noise_scale;
        pose = solve_pnp(&map.state.camera, pose, &map.matches(&found), noise)?.world_from_camera;
        found.retain(|f| map.agrees(f, &pose));
    }
    if found.len() < MIN_FOUND {
        return None;
    }
    let by_chance = map.found_by_chance(&pose) as f64;
    (found.len() as f64 > 2.0 * by_chance + 3.0 * by_chance.sqrt()).then_some((pose, found))
}

impl LocalMap<'_> {
    /// Poses where the frame may be: at constant velocity, and where the last one with a pose was, turned as
    /// the picture has moved since; `None` where that is not known any more.
    fn predicted_poses(&self) -> Option<Vec<Pose<f64>>> {
        let Self { state, tracker, frame, .. } = *self;
        let (last, pose) = (0..frame).rev().find_map(|f| Some((f, state.poses[f]?)))?;
        let [x, y] = tracker.translation_over(frame - last)?.map(f64::from);
        let turn = Vec3::new(y / state.camera.fy, -x / state.camera.fx, 0.0);
        let turned = Pose::new(pose.rotation * Rotation::exp(turn), pose.translation);
        Some(initial_poses(state, frame).into_iter().take(1).chain([turned]).collect())
    }

    /// The pose that most landmarks found around their predictions from `start` agree with, and their number.
    fn sampled_pose(&self, start: Pose<f64>) -> Option<(usize, Pose<f64>)> {
        let found = self.search(&start, [0.0; 2], f32::INFINITY);
        let matches = self.matches(&found);
        let (pose, inliers) = pose_of_samples(&self.state.camera, &[start], &matches, HYPOTHESES)?;
        Some((inliers.len(), pose))
    }

    /// Landmarks found within a distance of where a pose shows them [px], or of places displaced from there;
    /// their rows are corrected for its motion.
    fn search(&self, pose: &Pose<f64>, displaced: [f32; 2], most: f32) -> Vec<FoundPoint> {
        let motion = self.motion_at(pose);
        let mut points = self.predict(pose, motion.as_ref());
        for point in &mut points {
            let [x, y] = point.warp.centre;
            point.warp.centre = [x + displaced[0], y + displaced[1]];
        }
        let corrected = |found: FoundPoint| {
            let landmark = self.state.landmarks[found.point.track].as_ref()?;
            let raw = found.observation.raw();
            let rows = self.row_offset(landmark, raw[1], motion.as_ref());
            let at = std::array::from_fn(|i| raw[i] - rows[i]);
            Some(FoundPoint { observation: found.observation.moved_to(at), ..found })
        };
        self.tracker.search_predicted(&points, most).into_iter().filter_map(corrected).collect()
    }

    /// Landmarks seen from a pose, each as the sharpest of the keyframes shows it.
    fn predict(&self, pose: &Pose<f64>, motion: Option<&FrameMotion>) -> Vec<PredictedPoint> {
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
                let at_keyframe = o.raw().map(|v| v as f32);
                let warp = self.predicted_warp((track, keyframe), pose, motion);
                let point = warp.map(|warp| PredictedPoint { track, keyframe, at_keyframe, warp });
                points.extend(point.map(|point| (track, point)));
            }
        }
        points.into_values().collect()
    }

    /// Warp of the surroundings of a landmark from a keyframe into the picture seen from a pose; `None`
    /// outside of it.
    fn predicted_warp(
        &self,
        (track, keyframe): (usize, usize),
        pose: &Pose<f64>,
        motion: Option<&FrameMotion>,
    ) -> Option<AffineWarp> {
        let camera = &self.state.camera;
        let landmark = self.state.landmarks[track].as_ref()?;
        let at = landmark.image_position(camera, pose)?;
        if !camera.contains(at[0], at[1], BORDER) {
            return None;
        }
        let matrix =
            warp_between_views(camera, landmark, self.state.poses[keyframe].as_ref()?, pose)?;
        let rows = self.row_offset(landmark, at[1], motion);
        let centre = std::array::from_fn(|i| (at[i] + rows[i]) as f32);
        Some(AffineWarp { matrix, centre })
    }

    /// Motion of the frame if it has a pose; `None` where all rows are read at once.
    fn motion_at(&self, pose: &Pose<f64>) -> Option<FrameMotion> {
        if self.state.readout == 0.0 {
            return None;
        }
        let mut poses = self.state.poses.clone();
        poses[self.frame] = Some(*pose);
        FrameMotion::new(&poses, &self.state.timestamps, self.frame, self.interval)
    }

    /// Offset of a landmark in some row from where the middle row would show it [px].
    fn row_offset(&self, landmark: &Landmark, row: f64, motion: Option<&FrameMotion>) -> [f64; 2] {
        let camera = &self.state.camera;
        let offset = |motion: &FrameMotion| {
            let readout = self.state.readout * self.interval;
            let then = motion.pose_at(readout * (row / camera.height as f64 - 0.5));
            let now = landmark.image_position(camera, &motion.world_from_camera)?;
            let then = landmark.image_position(camera, &then)?;
            Some([then[0] - now[0], then[1] - now[1]])
        };
        motion.and_then(offset).unwrap_or([0.0; 2])
    }

    /// Most landmarks that are found as near to their predictions where all of these are displaced.
    fn found_by_chance(&self, pose: &Pose<f64>) -> usize {
        let by = CHANCE_DISPLACEMENT;
        let displaced = [[by, 0.0], [-by, 0.0], [0.0, by], [0.0, -by]];
        let found = displaced.map(|by| self.search(pose, by, MAX_DISTANCE).len());
        found.into_iter().fold(0, usize::max)
    }

    /// True if the reprojection error of a landmark that was found is that of an inlier.
    fn agrees(&self, found: &FoundPoint, pose: &Pose<f64>) -> bool {
        let Self { state, .. } = self;
        let error = |m: Match<'_>| registration_error(&state.camera, pose, &m, state.noise_scale);
        let matched = self.state.landmarks[found.point.track].as_ref();
        let error = matched.map(|landmark| error((landmark, &found.observation)));
        error.is_some_and(|error| error < MAX_INLIER_ERROR)
    }

    fn matches<'b>(&'b self, found: &'b [FoundPoint]) -> Vec<Match<'b>> {
        let landmark = |f: &FoundPoint| self.state.landmarks[f.point.track].as_ref();
        found.iter().filter_map(|f| Some((landmark(f)?, &f.observation))).collect()
    }
}

//! State of the reconstruction: camera, tracks, poses and landmarks.

mod near_points;
mod parts;
mod residuals;
mod scale;

pub(crate) use residuals::{MAX_NOISE_SCALE, MIN_INLIER_RATIO};
pub(crate) use scale::MIN_MEASURED_LANDMARKS;

use crate::bundle::{FreeIntrinsics, RelativePoseFactor};
use crate::depth::depth_map::{DepthMap, DepthPicture};
use crate::depth::sensor_model::DepthModel;
use crate::depth::stored_picture::StoredPicture;
use crate::features::collection::MatchedPhotographs;
use crate::multiview::landmark::{Landmark, Match};
use crate::multiview::lens_distortion::undistort;
use crate::multiview::triangulation::{PosedObservation, triangulate};
use crate::progress::Progress;
use crate::track::tracker::TrackedFrame;
use crate::track::tracks::{Observation, Track, Tracks, repeated_frame, shared_positions};
use i2slam_geometry::{Camera, Image, Pose, Similarity};
use i2slam_storage::ScratchStore;
use near_points::NearestDepths;
use rayon::prelude::*;
use std::sync::Arc;

/// Frames from which on distortion or readout are adjusted.
const MIN_SELF_CALIBRATION_FRAMES: usize = 8;
/// Longest rolling-shutter readout [frame intervals].
pub(crate) const MAX_READOUT: f64 = 1.0;
/// Largest number of poses in one bundle adjustment.
pub(crate) const MAX_JOINT_POSES: usize = 1000;

/// Camera, poses and landmarks of a sequence, with the tracks that they explain.
#[derive(Clone, Debug)]
pub(crate) struct SfmState {
    pub(crate) camera: Camera<f64>,
    pub(crate) tracks: Tracks,
    /// Tracks of large moving objects, which have no landmarks.
    pub(crate) moving_tracks: Arc<Vec<Track>>,
    /// Tracks of every frame.
    pub(crate) by_frame: Arc<Vec<Vec<usize>>>,
    /// `world_from_camera` of every registered frame.
    pub(crate) poses: Vec<Option<Pose<f64>>>,
    /// Frames other than keyframes that are left out of adjustment, triangulation and rejection of
    /// outliers; empty if none is.
    pub(crate) left_out: Vec<bool>,
    /// Landmark of every triangulated track.
    pub(crate) landmarks: Vec<Option<Landmark>>,
    /// Ratio of residuals to the tracker's deviations, at least 1.
    pub(crate) noise_scale: f64,
    /// [`undistort`]'s coefficients, and whether they are adjusted.
    pub(crate) distortion: [f64; 2],
    pub(crate) estimates_distortion: bool,
    /// Readout of the observations [frame intervals], and whether it is adjusted.
    pub(crate) readout: f64,
    pub(crate) estimates_readout: bool,
    /// Timestamp of every frame [s]; empty where depth is not read.
    pub(crate) timestamps: Arc<Vec<f64>>,
    /// Depth picture of every frame that has one; empty by colour alone.
    pub(crate) depth_maps: Arc<Vec<Option<DepthMap>>>,
    /// Model of the depth sensor.
    pub(crate) depth_model: DepthModel,
    /// Matches of photographs in any order, whose neighbours in time need not be near; none of a film.
    pub(crate) photographs: Option<Arc<MatchedPhotographs>>,
    /// Whether the map began by parallax, so that its lengths have no unit: depth is not read until
    /// readings agree on one.
    pub(crate) is_unscaled: bool,
    /// Picture of every frame, for dense alignment; empty by colour alone.
    pub(crate) pictures: Arc<Vec<Option<StoredPicture>>>,
    /// Relative poses of frames by dense alignment.
    pub(crate) relative_poses: Arc<Vec<RelativePoseFactor>>,
    /// Listener and cancellation.
    pub(crate) progress: Progress,
}

impl SfmState {
    /// No pose and no landmark.
    pub(crate) fn new(camera: Camera<f64>, tracks: Tracks) -> Self {
        let (poses, landmarks) = (vec![None; tracks.frames], vec![None; tracks.tracks.len()]);
        let by_frame = Arc::new(tracks.tracks_by_frame());
        Self {
            camera,
            tracks,
            moving_tracks: Arc::default(),
            by_frame,
            poses,
            left_out: Vec::new(),
            landmarks,
            noise_scale: 1.0,
            distortion: [0.0; 2],
            estimates_distortion: false,
            readout: 0.0,
            estimates_readout: false,
            timestamps: Arc::default(),
            depth_maps: Arc::default(),
            depth_model: DepthModel::default(),
            photographs: None,
            is_unscaled: false,
            pictures: Arc::default(),
            relative_poses: Arc::default(),
            progress: Progress::default(),
        }
    }

    /// Adds timestamp [s] and depth of the next frame, and its picture from the first depth on. Depth
    /// without any reading is none.
    pub(crate) fn add_input(
        &mut self,
        picture: &Image<f32>,
        timestamp: f64,
        depth: Option<&DepthPicture<'_>>,
        scratch: &Arc<ScratchStore>,
    ) {
        let depth = depth.map(|depth| DepthMap::new(depth, scratch)).filter(DepthMap::has_readings);
        let is_kept = depth.is_some() || self.pictures.last().is_some_and(Option::is_some);
        Arc::make_mut(&mut self.timestamps).push(timestamp);
        Arc::make_mut(&mut self.depth_maps).push(depth);
        Arc::make_mut(&mut self.pictures)
            .push(is_kept.then(|| StoredPicture::new(picture, scratch)));
    }

    /// Adds a frame that was tracked; one that repeats another comes without observations.
    pub(crate) fn add_frame(&mut self, tracked: TrackedFrame, is_repeat: &[bool]) {
        let frame = self.poses.len();
        self.poses.push(None);
        Arc::make_mut(&mut self.by_frame).push(Vec::new());
        if !is_repeat[frame] {
            self.add_observations(tracked.observed);
        }
        for mut track in tracked.started {
            track.observations.retain(|o| !is_repeat[o.frame]);
            self.add_track(track);
        }
        self.tracks.frames = frame + 1;
        if let Some(image) = tracked.keyframe {
            self.tracks.add_keyframe(&image, repeated_frame(is_repeat, frame));
        }
    }

    /// Adds a track of known frames.
    pub(crate) fn add_track(&mut self, track: Track) {
        let by_frame = Arc::make_mut(&mut self.by_frame);
        track.observations.iter().for_each(|o| by_frame[o.frame].push(self.landmarks.len()));
        self.tracks.tracks.push(track);
        self.landmarks.push(None);
    }

    /// An empty state of the keyframes alone, with the same camera.
    pub(crate) fn keyframes_only(&self) -> Self {
        Self {
            estimates_distortion: self.estimates_distortion,
            timestamps: Arc::clone(&self.timestamps),
            depth_maps: Arc::clone(&self.depth_maps),
            depth_model: self.depth_model.clone(),
            photographs: self.photographs.clone(),
            is_unscaled: self.is_unscaled,
            progress: self.progress.without_listener(),
            ..Self::new(self.camera, self.tracks.keyframes_only())
        }
    }

    /// Frees the room that tracks keep for more observations.
    pub(crate) fn shrink_to_fit(&mut self) {
        self.tracks.tracks.iter_mut().for_each(|track| track.observations.shrink_to_fit());
        Arc::make_mut(&mut self.by_frame).iter_mut().for_each(Vec::shrink_to_fit);
    }

    /// Whether any frame has measured depth.
    pub(crate) fn has_depth(&self) -> bool {
        self.depth_maps.iter().any(Option::is_some)
    }

    /// Moves poses and landmarks by a similarity of the world.
    pub(crate) fn transform(&mut self, by: &Similarity<f64>) {
        self.poses.iter_mut().flatten().for_each(|pose| *pose = by.apply_to_pose(*pose));
        let landmarks = self.landmarks.iter_mut().flatten();
        landmarks.for_each(|landmark| *landmark = landmark.transformed(by));
    }

    /// Removes all poses and landmarks; tracks, camera and distortion stay.
    pub(crate) fn reset(&mut self) {
        self.poses.fill(None);
        self.landmarks.fill(None);
        self.noise_scale = 1.0;
        let observations = self.tracks.tracks.iter_mut().flat_map(|t| &mut t.observations);
        observations.for_each(|o| o.is_outlier = false);
    }

    /// Landmarks observed in a frame.
    pub(crate) fn matches(&self, frame: usize) -> Vec<Match<'_>> {
        let pair = |i: &usize| {
            let landmark = self.landmarks[*i].as_ref()?;
            Some((landmark, self.tracks.tracks[*i].observation_in(frame)?))
        };
        self.by_frame[frame].iter().filter_map(pair).collect()
    }

    /// Observations in a frame, with their tracks.
    pub(crate) fn observations_in(
        &self,
        frame: usize,
    ) -> impl Iterator<Item = (usize, &Observation)> {
        let observation =
            move |i: &usize| Some((*i, self.tracks.tracks[*i].observation_in(frame)?));
        self.by_frame[frame].iter().filter_map(observation)
    }

    /// Number of tracks that two frames share.
    pub(crate) fn shared_count(&self, first: usize, second: usize) -> usize {
        let both = |i: &&usize| self.tracks.tracks[**i].observation_in(second).is_some();
        self.by_frame[first].iter().filter(both).count()
    }

    /// Number of tracks with at least three observations in the frames from `first` to `last`.
    pub(crate) fn tracked_points_within(&self, [first, last]: [usize; 2]) -> usize {
        let seen = |track: &&Track| {
            let within = |o: &&Observation| (first..=last).contains(&o.frame);
            track.observations.iter().filter(within).count() > 2
        };
        self.tracks.tracks.iter().filter(seen).count()
    }

    /// Adds observations to tracks, at most one per track and frame.
    pub(crate) fn add_observations(&mut self, observations: Vec<(usize, Observation)>) {
        let by_frame = Arc::make_mut(&mut self.by_frame);
        for (track, observation) in observations {
            if self.tracks.tracks[track].insert(observation) {
                by_frame[observation.frame].push(track);
            }
        }
    }

    /// Removes the observation of a track in a frame.
    pub(crate) fn remove_observation(&mut self, track: usize, frame: usize) {
        self.tracks.tracks[track].observations.retain(|o| o.frame != frame);
        Arc::make_mut(&mut self.by_frame)[frame].retain(|t| *t != track);
    }

    /// Image positions of the points that two frames share.
    pub(crate) fn shared_positions(
        &self,
        first: usize,
        second: usize,
    ) -> Vec<([f64; 2], [f64; 2])> {
        shared_positions(&self.tracks.tracks, &self.by_frame, first, second)
    }

    /// Whether a frame has a pose that is adjusted.
    pub(crate) fn is_adjusted(&self, frame: usize) -> bool {
        self.poses[frame].is_some() && !self.left_out.get(frame).is_some_and(|left_out| *left_out)
    }

    /// Frames with a pose that is adjusted, in order.
    pub(crate) fn adjusted_frames(&self) -> Vec<usize> {
        (0..self.poses.len()).filter(|f| self.is_adjusted(*f)).collect()
    }

    /// Result of an adjustment from which all frames but keyframes are left out.
    pub(crate) fn with_keyframes_alone<T>(&mut self, adjust: impl FnOnce(&mut Self) -> T) -> T {
        self.left_out = vec![true; self.poses.len()];
        self.tracks.keyframes.iter().for_each(|frame| self.left_out[*frame] = false);
        let result = adjust(self);
        self.left_out.clear();
        result
    }

    /// Frames with a pose, in order.
    pub(crate) fn posed_frames(&self) -> Vec<usize> {
        (0..self.poses.len()).filter(|f| self.poses[*f].is_some()).collect()
    }

    /// Keyframes with a pose, in order.
    pub(crate) fn posed_keyframes(&self) -> Vec<(usize, Pose<f64>)> {
        self.tracks.keyframes.iter().filter_map(|f| Some((*f, self.poses[*f]?))).collect()
    }

    /// Triangulates every track without a landmark that enough registered frames observe.
    pub(crate) fn triangulate_missing(&mut self) {
        self.triangulate((0..self.landmarks.len()).collect());
    }

    /// Triangulates the tracks of one frame that have no landmark.
    pub(crate) fn triangulate_missing_in(&mut self, frame: usize) {
        self.triangulate(self.by_frame[frame].clone());
    }

    fn triangulate(&mut self, mut tracks: Vec<usize>) {
        tracks.retain(|i| self.landmarks[*i].is_none());
        let nearest = NearestDepths::new(self);
        let landmark = |i: &usize| {
            let right = self.tracks.tracks[*i].observations.iter().filter(|o| !o.is_outlier);
            let observations: Vec<PosedObservation<'_>> = right
                .filter(|o| self.is_adjusted(o.frame))
                .filter_map(|o| Some((o, self.poses[o.frame]?)))
                .collect();
            triangulate(&self.camera, &observations, self.noise_scale)
                .filter(|found| !nearest.exclude(self, found, &self.tracks.tracks[*i]))
        };
        let found: Vec<Option<Landmark>> = tracks.par_iter().map(landmark).collect();
        tracks.into_iter().zip(found).for_each(|(i, found)| self.landmarks[i] = found);
    }

    /// Adjusts the poses of `free` frames, their landmarks and, on demand, the intrinsics; all
    /// other frames stay. Returns the mean cost per observation.
    ///
    /// More than [`MAX_JOINT_POSES`] are adjusted in overlapping parts, which bounds the memory.
    pub(crate) fn adjust(&mut self, free: &[usize], adjust_focal: bool, steps: usize) -> f64 {
        if free.len() <= MAX_JOINT_POSES {
            return self.adjust_together(free, adjust_focal, steps);
        }
        // Parts overlap by half, so that every pose is adjusted beside neighbours on both sides.
        let (mut sum, mut parts) = (0.0, 0.0);
        for begin in (0..free.len() - MAX_JOINT_POSES / 2).step_by(MAX_JOINT_POSES / 2) {
            let part = &free[begin.max(1)..(begin + MAX_JOINT_POSES).min(free.len())];
            sum += self.adjust_together(part, adjust_focal && begin == 0, steps);
            parts += 1.0;
        }
        sum / parts
    }

    fn adjust_together(&mut self, free: &[usize], adjust_focal: bool, steps: usize) -> f64 {
        let (mut bundle, frames, tracks) = self.bundle(free, adjust_focal);
        let cost = bundle.adjust(steps, &self.progress);
        self.move_landmarks_of_one_frame(&frames, &bundle.poses);
        for (frame, pose) in frames.iter().zip(&bundle.poses) {
            self.poses[*frame] = Some(*pose);
        }
        for (track, landmark) in tracks.iter().zip(&bundle.landmarks) {
            self.landmarks[*track] = Some(*landmark);
        }
        self.camera = bundle.camera;
        match bundle.free_intrinsics {
            FreeIntrinsics::FocalLengthAndDistortion => {
                self.update_distortion(bundle.camera_change)
            }
            FreeIntrinsics::FocalLengthAndReadout => self.update_readout(bundle.camera_change[0]),
            FreeIntrinsics::FocalLength | FreeIntrinsics::None => {}
        }
        cost
    }

    /// Moves landmarks that only one adjusted frame observes, which a bundle leaves out, with the new
    /// pose of that frame.
    fn move_landmarks_of_one_frame(&mut self, frames: &[usize], poses: &[Pose<f64>]) {
        for (frame, now) in frames.iter().zip(poses) {
            let Some(was) = self.poses[*frame].filter(|was| was != now) else { continue };
            let moved = Similarity::from_pose(*now * was.inverse(), 1.0);
            for track in Arc::clone(&self.by_frame)[*frame].iter().copied() {
                let is_its_own = self.adjusted_inliers(track).map(|o| o.frame).eq([*frame]);
                if let Some(landmark) = self.landmarks[track].filter(|_| is_its_own) {
                    self.landmarks[track] = Some(landmark.transformed(&moved));
                }
            }
        }
    }

    /// Observations of a track that are no outliers, in frames that are adjusted.
    pub(crate) fn adjusted_inliers(&self, track: usize) -> impl Iterator<Item = &Observation> {
        let observations = self.tracks.tracks[track].observations.iter();
        observations.filter(|o| !o.is_outlier && self.is_adjusted(o.frame))
    }

    /// Whether two adjusted frames observe a landmark, so that adjustment determines it.
    fn is_seen_twice(&self, track: usize) -> bool {
        self.adjusted_inliers(track).nth(1).is_some()
    }

    /// Whether each track has a landmark that adjustment determines.
    pub(crate) fn shared_landmarks(&self) -> Vec<bool> {
        let is_shared = |track: usize| self.landmarks[track].is_some() && self.is_seen_twice(track);
        (0..self.landmarks.len()).into_par_iter().map(is_shared).collect()
    }

    /// Corrects all observations for a change of the distortion.
    pub(crate) fn update_distortion(&mut self, change: [f64; 2]) {
        (0..2).for_each(|i| self.distortion[i] += change[i]);
        for o in self.tracks.tracks.iter_mut().flat_map(|t| &mut t.observations) {
            let moved = undistort(&self.camera, change, o.raw());
            let (at, raw) = (o.at(), o.raw());
            *o = o.moved_to(std::array::from_fn(|i| at[i] + moved[i] - raw[i]));
        }
    }

    /// Takes all rows for exposed at once.
    pub(crate) fn drop_readout(&mut self) {
        self.readout = 0.0;
        let (camera, distortion) = (self.camera, self.distortion);
        for o in self.tracks.tracks.iter_mut().flat_map(|t| &mut t.observations) {
            *o = o.moved_to(undistort(&camera, distortion, o.raw()));
        }
    }

    /// Scales all corrections to a changed readout: the speeds in them are known already.
    fn update_readout(&mut self, change: f64) {
        let readout = (self.readout + change).clamp(-MAX_READOUT, MAX_READOUT);
        let ratio = readout / self.readout;
        if !ratio.is_finite() || ratio <= 0.0 {
            return;
        }
        self.readout = readout;
        let (camera, distortion) = (self.camera, self.distortion);
        for o in self.tracks.tracks.iter_mut().flat_map(|t| &mut t.observations) {
            let flat = undistort(&camera, distortion, o.raw());
            let at = o.at();
            *o = o.moved_to(std::array::from_fn(|i| flat[i] + ratio * (at[i] - flat[i])));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures;
    use i2slam_geometry::{Rotation, Tangent, Vec3};

    /// A frame that was off moves to its points, and the landmark that it alone sees moves with it.
    #[test]
    fn a_landmark_of_one_frame_is_adjusted_with_the_frame() {
        let pose =
            |frame: usize| Pose::new(Rotation::identity(), Vec3::new(0.1 * frame as f64, 0.0, 0.0));
        let observe = |point: Vec3<f64>, frame: usize, _: &[f64]| {
            let (u, v) = fixtures::camera().project(pose(frame).inverse() * point);
            Some([u, v])
        };
        let mut state = fixtures::state((6, 12, 1), [120.0, 90.0], pose, observe);
        let track = state.by_frame[5][0];
        state.tracks.tracks[track].observations.retain(|o| o.frame == 5);
        state.by_frame = Arc::new(state.tracks.tracks_by_frame());
        let there = state.landmarks[track].expect("triangulated").position();
        let off = Tangent {
            translation: Vec3::new(0.02, 0.0, 0.01),
            rotation: Vec3::new(0.0, 0.01, 0.0),
        };
        let wrong = pose(5).retract(off);
        let moved = Similarity::from_pose(wrong * pose(5).inverse(), 1.0);
        state.poses[5] = Some(wrong);
        state.landmarks[track] =
            state.landmarks[track].map(|landmark| landmark.transformed(&moved));
        state.adjust(&[5], false, 20);
        let found = state.poses[5].expect("posed");
        assert!((found.translation - pose(5).translation).norm() < 1e-6);
        let found = state.landmarks[track].expect("kept").position();
        assert!((found - there).norm() < 1e-5, "{found:?} {there:?}");
        assert!(state.residuals_in(&[5]).iter().all(|residual| *residual < 1e-3));
        assert_eq!(state.residuals_in(&[5]).len(), state.matches(5).len() - 1);
    }
}

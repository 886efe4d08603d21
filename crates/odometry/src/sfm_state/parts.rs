//! Parts of the state: bundles of some frames, and a state of some frames alone.

use super::{MIN_SELF_CALIBRATION_FRAMES, SfmState};
use crate::bundle::{Bundle, BundleObservation, FreeIntrinsics, RelativePoseFactor};
use crate::multiview::lens_distortion::{CameraJacobian, distortion_jacobian, undistort};
use crate::track::tracks::{DepthReading, Observation, Track, Tracks};
use std::sync::Arc;

impl SfmState {
    /// The state with the poses and observations of some frames alone.
    pub(crate) fn within(&self, is_within: impl Fn(usize) -> bool) -> Self {
        let (mut tracks, mut landmarks) = (Vec::new(), Vec::new());
        for (track, landmark) in self.tracks.tracks.iter().zip(&self.landmarks) {
            let kept = track.observations.iter().filter(|o| is_within(o.frame)).copied();
            let observations: Vec<Observation> = kept.collect();
            if !observations.is_empty() {
                tracks.push(Track { observations });
                landmarks.push(*landmark);
            }
        }
        let tracks = Tracks {
            tracks,
            keyframes: self.tracks.keyframes.clone(),
            keyframe_images: self.tracks.keyframe_images.clone(),
            frames: self.tracks.frames,
        };
        let pose = |frame: usize| self.poses[frame].filter(|_| is_within(frame));
        Self {
            by_frame: Arc::new(tracks.tracks_by_frame()),
            tracks,
            landmarks,
            poses: (0..self.poses.len()).map(pose).collect(),
            moving_tracks: Arc::clone(&self.moving_tracks),
            left_out: self.left_out.clone(),
            timestamps: Arc::clone(&self.timestamps),
            depth_maps: Arc::clone(&self.depth_maps),
            depth_model: self.depth_model.clone(),
            photographs: self.photographs.clone(),
            pictures: Arc::clone(&self.pictures),
            relative_poses: Arc::clone(&self.relative_poses),
            progress: self.progress.clone(),
            ..*self
        }
    }

    /// Number of frames from a keyframe, given by its index among them, to the next one.
    pub(crate) fn frames_represented(&self, place: usize) -> usize {
        let keyframes = &self.tracks.keyframes;
        keyframes.get(place + 1).copied().unwrap_or(self.poses.len()) - keyframes[place]
    }

    /// Number of frames represented by registered keyframes.
    pub(crate) fn frames_covered(&self) -> usize {
        let keyframes = self.tracks.keyframes.iter().enumerate();
        let posed = keyframes.filter(|(_, frame)| self.poses[**frame].is_some());
        posed.map(|(place, _)| self.frames_represented(place)).sum()
    }

    /// Intrinsics that a bundle of so many frames adjusts.
    fn free_intrinsics(&self, adjust_focal: bool, frames: usize) -> FreeIntrinsics {
        let is_enough = frames >= MIN_SELF_CALIBRATION_FRAMES;
        match (self.estimates_distortion && is_enough, self.estimates_readout && is_enough) {
            _ if !adjust_focal => FreeIntrinsics::None,
            (true, _) => FreeIntrinsics::FocalLengthAndDistortion,
            (false, true) => FreeIntrinsics::FocalLengthAndReadout,
            (false, false) => FreeIntrinsics::FocalLength,
        }
    }

    /// Derivatives by distortion, or by the readout: the present correction per frame interval.
    fn camera_jacobian(&self, free_intrinsics: FreeIntrinsics, o: &Observation) -> CameraJacobian {
        if free_intrinsics != FreeIntrinsics::FocalLengthAndReadout {
            return distortion_jacobian(&self.camera, o.raw());
        }
        let flat = undistort(&self.camera, self.distortion, o.raw());
        [std::array::from_fn(|i| (o.at()[i] - flat[i]) / self.readout), [0.0; 2]]
    }

    /// Tracks observed in any of some frames, in order.
    pub(super) fn tracks_in(&self, frames: &[usize]) -> Vec<usize> {
        let mut is_shown = vec![false; self.landmarks.len()];
        frames.iter().flat_map(|f| &self.by_frame[*f]).for_each(|t| is_shown[*t] = true);
        (0..is_shown.len()).filter(|t| is_shown[*t]).collect()
    }

    /// The bundle of `free` frames and all others that share landmarks with them, with the frames
    /// of its poses and the tracks of its landmarks. The first frame is fixed where none would be.
    pub(crate) fn bundle(
        &self,
        free: &[usize],
        adjust_focal: bool,
    ) -> (Bundle, Vec<usize>, Vec<usize>) {
        self.bundle_within(free, adjust_focal, |_| true)
    }

    /// As [`bundle`](Self::bundle), with the observations of some frames alone.
    pub(crate) fn bundle_within(
        &self,
        free: &[usize],
        adjust_focal: bool,
        is_within: impl Fn(usize) -> bool,
    ) -> (Bundle, Vec<usize>, Vec<usize>) {
        let inliers = |track: &usize| self.adjusted_inliers(*track).filter(|o| is_within(o.frame));
        let kept =
            |track: &usize| self.landmarks[*track].is_some() && inliers(track).nth(1).is_some();
        let tracks: Vec<usize> = self.tracks_in(free).into_iter().filter(kept).collect();
        let mut place = vec![None; self.poses.len()];
        tracks.iter().flat_map(inliers).for_each(|o| place[o.frame] = Some(0));
        let frames: Vec<usize> = (0..place.len()).filter(|f| place[*f].is_some()).collect();
        frames.iter().enumerate().for_each(|(i, f)| place[*f] = Some(i));
        let free_intrinsics = self.free_intrinsics(adjust_focal, frames.len());
        let observation = |o: &Observation| {
            let camera_jacobian = self.camera_jacobian(free_intrinsics, o);
            let pose = place[o.frame]?;
            // Deviations of positions are those of the tracker, which residuals exceed.
            let scaled = |d: DepthReading| DepthReading { sigma: d.sigma / self.noise_scale, ..d };
            let depth = o.depth().map(scaled);
            let (at, whitening) = (o.at(), *o.whitening());
            Some(BundleObservation { pose, at, whitening, camera_jacobian, depth })
        };
        let observations =
            tracks.iter().map(|t| inliers(t).filter_map(observation).collect()).collect();
        let mut fixed: Vec<bool> = frames.iter().map(|_| true).collect();
        free.iter().filter_map(|f| place[*f]).for_each(|i| fixed[i] = false);
        if !fixed.contains(&true) {
            fixed.iter_mut().take(1).for_each(|f| *f = true);
        }
        let bundle = Bundle {
            camera: self.camera,
            poses: frames.iter().filter_map(|f| self.poses[*f]).collect(),
            fixed,
            landmarks: tracks.iter().filter_map(|t| self.landmarks[*t]).collect(),
            observations: Arc::new(observations),
            relative_poses: Arc::new(self.relative_factors(&place)),
            camera_change: [0.0; 2],
            free_intrinsics,
        };
        (bundle, frames, tracks)
    }

    /// Relative poses between frames at places of a bundle, their deviations scaled as those of
    /// positions.
    fn relative_factors(&self, place: &[Option<usize>]) -> Vec<RelativePoseFactor> {
        let square = self.noise_scale * self.noise_scale;
        let placed = |f: &RelativePoseFactor| {
            let information = f.information.map(|row| row.map(|v| square * v));
            let (first, second) = (place[f.first]?, place[f.second]?);
            Some(RelativePoseFactor { first, second, information, ..*f })
        };
        self.relative_poses.iter().filter_map(placed).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::fixtures;
    use i2slam_geometry::{Pose, Rotation, Vec3};

    /// Frames outside of a part count for nothing in its adjustment.
    #[test]
    fn a_part_is_adjusted_to_the_same_poses_as_within_the_whole() {
        let pose =
            |frame: usize| Pose::new(Rotation::identity(), Vec3::new(0.1 * frame as f64, 0.0, 0.0));
        let observe = |point: Vec3<f64>, frame: usize, n: &[f64]| {
            let (u, v) = fixtures::camera().project(pose(frame).inverse() * point);
            Some([u + 0.5 * n[0], v + 0.5 * n[1]])
        };
        let mut whole = fixtures::state((40, 12, 4), [150.0, 110.0], pose, observe);
        let within = 10..25;
        for frame in (0..40).filter(|frame| !within.contains(frame)) {
            whole.poses[frame] = None;
        }
        let mut part = whole.within(|frame| within.contains(&frame));
        let free: Vec<usize> = (11..25).collect();
        let costs = [&mut whole, &mut part].map(|state| state.adjust(&free, false, 10));
        assert_eq!(costs[0], costs[1]);
        assert_eq!(whole.poses, part.poses);
        assert!(part.tracks.tracks.len() < whole.tracks.tracks.len());
    }
}

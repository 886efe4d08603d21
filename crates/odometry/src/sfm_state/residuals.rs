//! Residuals of landmarks: their scale, and the observations that are outliers.

use super::SfmState;
use super::near_points::NearestDepths;
use crate::multiview::landmark::{MAX_INLIER_ERROR, Match, registration_error, reprojection_error};
use crate::track::tracks::Observation;
use i2slam_compute::median;
use i2slam_geometry::Pose;
use std::collections::BTreeSet;

/// Reprojection error of an outlier [standard deviations].
const OUTLIER_ERROR: f64 = 6.0;
/// Ratio of inliers from which on landmarks determine a frame's pose as well as their deviations say.
pub(crate) const MIN_INLIER_RATIO: f64 = 0.5;
/// Largest factor between residuals and the tracker's deviations.
pub(crate) const MAX_NOISE_SCALE: f64 = 4.0;

impl SfmState {
    /// Marks observations that their landmark does not explain as outliers, and drops landmarks that are
    /// left with fewer than two inliers or [too near](super::near_points); their observations may be tried
    /// again.
    pub(crate) fn reject_outliers(&mut self) {
        self.reject_outliers_of((0..self.landmarks.len()).collect());
    }

    /// Rejects outliers among the landmarks that some frames observe.
    pub(crate) fn reject_outliers_in(&mut self, frames: &[usize]) {
        self.reject_outliers_of(self.tracks_in(frames));
    }

    fn reject_outliers_of(&mut self, tracks: Vec<usize>) {
        let (camera, worst) = (self.camera, OUTLIER_ERROR * self.noise_scale);
        let adjusted: Vec<Option<Pose<f64>>> =
            (0..self.poses.len()).map(|f| self.poses[f].filter(|_| self.is_adjusted(f))).collect();
        let nearest = NearestDepths::new(self);
        let is_near = |index: &usize| {
            let landmark = self.landmarks[*index].as_ref();
            landmark.is_some_and(|l| nearest.exclude(self, l, &self.tracks.tracks[*index]))
        };
        let near: BTreeSet<usize> = tracks.iter().copied().filter(is_near).collect();
        for index in tracks {
            let (landmark, track) = (&mut self.landmarks[index], &mut self.tracks.tracks[index]);
            let Some(known) = landmark else { continue };
            let mut left = 0;
            for observation in &mut track.observations {
                let Some(pose) = &adjusted[observation.frame] else { continue };
                let off = reprojection_error(&camera, pose, &(&*known, observation));
                observation.is_outlier = off > worst;
                left += usize::from(!observation.is_outlier);
            }
            let has_depth = track.observations.iter().any(|o| !o.is_outlier && o.depth().is_some());
            // Slightly negative inverse depths are far points with noise.
            let is_lost = left < 2 - usize::from(has_depth);
            if is_lost || known.inverse_depth() < -0.02 || near.contains(&index) {
                *landmark = None;
                track.observations.iter_mut().for_each(|o| o.is_outlier = false);
            }
        }
    }

    /// Updates [`noise_scale`](Self::noise_scale) from the residuals of all registered frames.
    pub(crate) fn update_noise_scale(&mut self) {
        self.noise_scale =
            self.residual_scale().map_or(1.0, |scale| scale.clamp(1.0, MAX_NOISE_SCALE));
    }

    /// Median residual over that expected from the tracker's deviations.
    pub(crate) fn residual_scale(&self) -> Option<f64> {
        // The median length of a two-dimensional normal residual is √(2 ln 2) deviations.
        let usual = (2.0 * std::f64::consts::LN_2).sqrt();
        median(&mut self.residuals_in(&self.adjusted_frames())).map(|m| m / usual)
    }

    /// Residuals [standard deviations] of the landmarks in some frames, without those that only one
    /// adjusted frame observes: they lie where it sees them.
    pub(crate) fn residuals_in(&self, frames: &[usize]) -> Vec<f64> {
        let is_shared = self.shared_landmarks();
        let mut all = Vec::new();
        for frame in frames {
            let Some(pose) = self.poses[*frame] else { continue };
            for track in self.by_frame[*frame].iter().filter(|track| is_shared[**track]) {
                let seen = self.tracks.tracks[*track].observation_in(*frame);
                let seen = self.landmarks[*track].as_ref().zip(seen);
                all.extend(seen.map(|m| reprojection_error(&self.camera, &pose, &m)));
            }
        }
        all
    }

    /// Mean squared residual [variances] of all observations in some frames of tracks that two of these see, at
    /// most [`MAX_INLIER_ERROR`] squared each, as of tracks without a landmark (MSAC; Torr and Zisserman 2000):
    /// maps of the same tracks compare by it.
    pub(crate) fn truncated_cost(&self, frames: &[usize]) -> f64 {
        let mut seen = vec![0_usize; self.landmarks.len()];
        frames.iter().flat_map(|f| &self.by_frame[*f]).for_each(|track| seen[*track] += 1);
        let (mut sum, mut count) = (0.0, 0_usize);
        for frame in frames {
            for (track, observation) in self.observations_in(*frame).filter(|(t, _)| seen[*t] > 1) {
                let landmark = self.landmarks[track].as_ref().zip(self.poses[*frame].as_ref());
                let error = landmark.map_or(f64::INFINITY, |(landmark, pose)| {
                    registration_error(&self.camera, pose, &(landmark, observation), 1.0)
                });
                sum += error.min(MAX_INLIER_ERROR).powi(2);
                count += 1;
            }
        }
        sum / count.max(1) as f64
    }

    /// Number of landmarks within [`MAX_INLIER_ERROR`] in a frame.
    pub(crate) fn count_inliers(&self, frame: usize) -> usize {
        let Some(pose) = self.poses[frame] else { return 0 };
        let agrees = |m: &&Match<'_>| {
            registration_error(&self.camera, &pose, m, self.noise_scale) < MAX_INLIER_ERROR
        };
        self.matches(frame).iter().filter(agrees).count()
    }

    /// Tracks observed in a frame elsewhere than a pose shows their landmarks.
    pub(crate) fn tracks_off_pose(&self, frame: usize, pose: &Pose<f64>) -> Vec<usize> {
        let is_off = |(track, o): &(usize, &Observation)| {
            let landmark = self.landmarks[*track].as_ref();
            landmark.is_some_and(|landmark| {
                let noise = self.noise_scale;
                registration_error(&self.camera, pose, &(landmark, o), noise) >= MAX_INLIER_ERROR
            })
        };
        self.observations_in(frame).filter(is_off).map(|(track, _)| track).collect()
    }

    /// True where most landmarks in a frame are explained by its pose.
    pub(crate) fn agrees_with_landmarks(&self, frame: usize) -> bool {
        self.count_inliers(frame) as f64 >= MIN_INLIER_RATIO * self.matches(frame).len() as f64
    }
}

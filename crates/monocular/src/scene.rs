//! What is known so far: poses of frames, landmarks of tracks.

use crate::bundle::{Bundle, Sight};
use crate::landmark::Landmark;
use crate::resection::{AGREEING, Match};
use crate::tracks::{Tracks, shared};
use crate::triangulate::{PosedSight, triangulate};
use i2slam_compute::median;
use i2slam_geometry::{Camera, Pose};
use rayon::prelude::*;
use std::sync::Arc;

/// Residuals beyond this are wrong matches [standard deviations].
const WRONG: f64 = 6.0;
/// The tracker's deviations are never taken as wrong by more than this.
const MOST_NOISE: f64 = 4.0;

/// Poses and landmarks, and the tracks that they explain.
#[derive(Clone, Debug)]
pub(crate) struct Scene {
    pub(crate) camera: Camera<f64>,
    pub(crate) tracks: Tracks,
    /// For every frame the tracks that it shows.
    by_frame: Arc<Vec<Vec<usize>>>,
    /// `world_from_camera` of every frame that has one.
    pub(crate) poses: Vec<Option<Pose<f64>>>,
    /// For every track its landmark, if it has one.
    pub(crate) landmarks: Vec<Option<Landmark>>,
    /// How many times as large residuals are as the tracker says, at least 1.
    pub(crate) noise: f64,
}

impl Scene {
    /// Nothing is known yet.
    pub(crate) fn new(camera: Camera<f64>, tracks: Tracks) -> Self {
        let (poses, landmarks) = (vec![None; tracks.frames], vec![None; tracks.tracks.len()]);
        let by_frame = Arc::new(tracks.by_frame());
        Self { camera, tracks, by_frame, poses, landmarks, noise: 1.0 }
    }

    /// Landmarks that a frame shows.
    pub(crate) fn matches(&self, frame: usize) -> Vec<Match<'_>> {
        let pair = |i: &usize| {
            let landmark = self.landmarks[*i].as_ref()?;
            Some((landmark, self.tracks.tracks[*i].in_frame(frame)?))
        };
        self.by_frame[frame].iter().filter_map(pair).collect()
    }

    /// Image positions of the points that two frames share.
    pub(crate) fn shared(&self, first: usize, second: usize) -> Vec<([f64; 2], [f64; 2])> {
        shared(&self.tracks.tracks, &self.by_frame, first, second)
    }

    /// Frames with a pose, in order.
    pub(crate) fn posed(&self) -> Vec<usize> {
        (0..self.poses.len()).filter(|f| self.poses[*f].is_some()).collect()
    }

    /// Gives a landmark to every track without one that enough posed frames show.
    pub(crate) fn add_landmarks(&mut self) {
        self.triangulate((0..self.landmarks.len()).collect());
    }

    /// The same for the tracks that one frame shows.
    pub(crate) fn add_landmarks_in(&mut self, frame: usize) {
        self.triangulate(self.by_frame[frame].clone());
    }

    fn triangulate(&mut self, mut tracks: Vec<usize>) {
        tracks.retain(|i| self.landmarks[*i].is_none());
        let landmark = |i: &usize| {
            let right = self.tracks.tracks[*i].observations.iter().filter(|o| !o.is_wrong);
            let sights: Vec<PosedSight<'_>> =
                right.filter_map(|o| Some((o, self.poses[o.frame]?))).collect();
            triangulate(&self.camera, &sights, self.noise)
        };
        let found: Vec<Option<Landmark>> = tracks.par_iter().map(landmark).collect();
        tracks.into_iter().zip(found).for_each(|(i, found)| self.landmarks[i] = found);
    }

    /// Adjusts the poses of `free` frames, the landmarks that they see, and the focal length if
    /// asked, all other posed frames fixed. Returns the cost per sight.
    pub(crate) fn adjust(&mut self, free: &[usize], adjust_focal: bool, steps: usize) -> f64 {
        let (mut bundle, frames, tracks) = self.bundle(free, adjust_focal);
        let cost = bundle.adjust(steps);
        for (frame, pose) in frames.iter().zip(&bundle.poses) {
            self.poses[*frame] = Some(*pose);
        }
        for (track, landmark) in tracks.iter().zip(&bundle.landmarks) {
            self.landmarks[*track] = Some(*landmark);
        }
        self.camera = bundle.camera;
        cost
    }

    /// The bundle of `free` frames and all others that see the same landmarks, the frames of its
    /// poses and the tracks of its landmarks. Where none would be fixed, the first one is.
    pub(crate) fn bundle(
        &self,
        free: &[usize],
        adjust_focal: bool,
    ) -> (Bundle, Vec<usize>, Vec<usize>) {
        let mut is_free = vec![false; self.poses.len()];
        free.iter().for_each(|f| is_free[*f] = true);
        let frames = self.posed();
        let mut place = vec![None; self.poses.len()];
        frames.iter().enumerate().for_each(|(i, f)| place[*f] = Some(i));
        let (mut landmarks, mut sights, mut tracks) = (Vec::new(), Vec::new(), Vec::new());
        for (index, track) in self.tracks.tracks.iter().enumerate() {
            let Some(landmark) = self.landmarks[index] else { continue };
            if !track.observations.iter().any(|o| is_free[o.frame]) {
                continue;
            }
            let sight = |o: &crate::tracks::Observation| {
                Some(Sight { pose: place[o.frame]?, at: o.at, sigma: o.sigma })
            };
            let right = track.observations.iter().filter(|o| !o.is_wrong);
            let seen: Vec<Sight> = right.filter_map(sight).collect();
            if seen.len() > 1 {
                landmarks.push(landmark);
                sights.push(seen);
                tracks.push(index);
            }
        }
        let mut fixed: Vec<bool> = frames.iter().map(|f| !is_free[*f]).collect();
        if !fixed.contains(&true) {
            fixed.iter_mut().take(1).for_each(|f| *f = true);
        }
        let poses = frames.iter().filter_map(|f| self.poses[*f]).collect();
        let bundle = Bundle { camera: self.camera, poses, fixed, landmarks, sights, adjust_focal };
        (bundle, frames, tracks)
    }

    /// Marks the sights that their landmark does not explain, and gives up landmarks that are left
    /// with fewer than two. Returns how many sights are wrong.
    pub(crate) fn mark_wrong_sights(&mut self) -> usize {
        let (camera, poses, worst) = (self.camera, &self.poses, WRONG * self.noise);
        let mut wrong = 0;
        for (landmark, track) in self.landmarks.iter_mut().zip(&mut self.tracks.tracks) {
            let Some(known) = landmark else { continue };
            let mut left = 0;
            for observation in &mut track.observations {
                let Some(pose) = &poses[observation.frame] else { continue };
                let off = crate::resection::residual(&camera, pose, &(&*known, observation));
                observation.is_wrong = off > worst;
                wrong += usize::from(observation.is_wrong);
                left += usize::from(!observation.is_wrong);
            }
            if left < 2 || known.values[2] < -0.02 {
                *landmark = None;
            }
        }
        wrong
    }

    /// Sets [`noise`](Self::noise) to what half of all sights in posed frames keep to.
    pub(crate) fn measure_noise(&mut self) {
        self.noise = self.residual_scale().map_or(1.0, |scale| scale.clamp(1.0, MOST_NOISE));
    }

    /// How many times as large residuals are as the tracker says, by their median.
    pub(crate) fn residual_scale(&self) -> Option<f64> {
        let mut all = Vec::new();
        for frame in self.posed() {
            let Some(pose) = self.poses[frame] else { continue };
            let of = |m: &Match<'_>| crate::resection::residual(&self.camera, &pose, m);
            all.extend(self.matches(frame).iter().map(of));
        }
        // The median length of a two-dimensional normal residual is √(2 ln 2) deviations.
        let usual = (2.0 * std::f64::consts::LN_2).sqrt();
        median(&mut all).map(|m| m / usual)
    }

    /// Number of the landmarks in a frame that agree with its pose.
    pub(crate) fn agreeing(&self, frame: usize) -> usize {
        let Some(pose) = self.poses[frame] else { return 0 };
        let agrees = |m: &&Match<'_>| {
            crate::resection::residual(&self.camera, &pose, m) < AGREEING * self.noise
        };
        self.matches(frame).iter().filter(agrees).count()
    }
}

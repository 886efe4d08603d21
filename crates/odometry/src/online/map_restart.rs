//! Maps that begin anew: from a better pair of keyframes, or with another readout of the rows.

use crate::online::online_map::{INITIALIZATION_WINDOW, OnlineMap, move_with_keyframes};
use crate::online::path_alignment::{PosePair, path_change};
use crate::register::dense_constraints::RecentKeyframes;
use crate::register::registration::adjust_globally;
use crate::rolling_shutter::readout::{MAX_COST_RATIO, ReadoutSearch, correct_observations};
use crate::rolling_shutter::rolling_shutter_init::initialize_readout;
use crate::sfm_state::{MAX_READOUT, SfmState};
use i2slam_compute::median;
use i2slam_geometry::{Pose, Similarity};
use std::sync::Arc;

/// Relative change of the path by a keyframe and its adjustment, below which poses are given by
/// colour alone. Before, translations may be noise: where a camera hardly moved, factors of 2 to 7
/// were seen.
const MAX_SETTLED_CHANGE: f64 = 0.05;
/// Frames up to which another readout starts the map anew: rows were some pixels off.
const MAX_RESTART_FRAMES: usize = 30;

impl OnlineMap {
    /// Starts the map of few keyframes by colour alone anew from the best pair of all, as long as
    /// keyframes change the path: the pair that was there first may have had too little parallax.
    pub(super) fn settle(&mut self, before: &[(usize, Pose<f64>)], interval: f64) {
        if self.is_settled || self.state.has_depth() {
            return;
        }
        if before.len() <= INITIALIZATION_WINDOW {
            let timestamps = Arc::clone(&self.state.timestamps);
            let other = match self.state.readout == 0.0 {
                true => self.restarted(|_| {}),
                false => self.restarted(|state| initialize_rows(state, &timestamps)),
            };
            self.replace_if_better(other, (&timestamps, interval), 1.0);
        }
        let now = |(frame, was): &(usize, Pose<f64>)| Some((self.state.poses[*frame]?, *was));
        let pairs: Vec<PosePair> = before.iter().filter_map(now).collect();
        self.is_settled = path_change(&pairs).is_some_and(|change| change < MAX_SETTLED_CHANGE);
    }

    /// Looks for the readout, and adjusts the path to it: in the first frames by a map with the one
    /// that explains the rotations best, which has to explain more than the present map; later by the
    /// cost of the map, in steps of which each frame takes one.
    pub(super) fn estimate_readout(&mut self, interval: f64) {
        if self.is_started() && self.state.poses.len() > MAX_RESTART_FRAMES {
            let search = |state: &mut SfmState| ReadoutSearch::new(state, false);
            self.readout_search = self.state.with_keyframes_alone(search);
            return;
        }
        let timestamps = Arc::clone(&self.state.timestamps);
        let found = self.restarted(|state| initialize_rows(state, &timestamps));
        if !self.is_started() {
            // At the end of the range there is no minimum, and no map yet to tell.
            if found.state.readout.abs() < MAX_READOUT {
                *self = found;
            }
            return;
        }
        // A global shutter holds until another readout explains more.
        let (now, then) = (self.state.readout, found.state.readout);
        if then != 0.0 && then != now {
            self.replace_if_better(found, (&timestamps, interval), MAX_COST_RATIO);
        } else if then == 0.0 && now != 0.0 {
            self.replace_if_better(found, (&timestamps, interval), MAX_COST_RATIO.recip());
        }
    }

    /// Takes a step of the search for the readout; after the last one adjusts the path to it.
    pub(super) fn continue_readout_search(&mut self) {
        let Some(mut search) = self.readout_search.take() else { return };
        if search.step() {
            self.readout_search = Some(search);
            return;
        }
        let before = self.state.posed_keyframes();
        self.state.with_keyframes_alone(|state| {
            search.apply(state);
            adjust_globally(state, false);
        });
        move_with_keyframes(&mut self.state, &before, &self.followers);
        self.keep_world();
    }

    /// A map of the same pictures that has not started, with all rows as seen and a readout that
    /// `set_readout` finds.
    fn restarted(&self, set_readout: impl FnOnce(&mut SfmState)) -> Self {
        let mut other = self.clone();
        other.recent_keyframes = RecentKeyframes::default();
        let state = &mut other.state;
        state.reset();
        state.relative_poses = Arc::default();
        let timestamps = Arc::clone(&state.timestamps);
        correct_observations(state, &timestamps, 0.0, 1.0);
        set_readout(state);
        other
    }

    /// Starts another map of the same pictures, and takes it if it misfits less than this one by a
    /// ratio.
    fn replace_if_better(
        &mut self,
        mut other: Self,
        (timestamps, interval): (&[f64], f64),
        ratio: f64,
    ) {
        other.start();
        if other.is_started() {
            other.improve(timestamps, interval);
            self.improve(timestamps, interval);
            if other.misfit() < ratio * self.misfit() {
                other.move_to_world_of(&self.state);
                *self = other;
            }
            self.keep_world();
        }
    }

    /// Corrects all rows for the velocities of the path, and adjusts the keyframes.
    fn improve(&mut self, timestamps: &[f64], interval: f64) {
        let state = &mut self.state;
        correct_observations(state, timestamps, state.readout * interval, interval);
        let before = state.posed_keyframes();
        state.with_keyframes_alone(|state| adjust_globally(state, false));
        move_with_keyframes(state, &before, &self.followers);
    }

    /// Median residual of all keyframes [standard deviations] over the number of inliers: a map that
    /// explains fewer points fits them better.
    fn misfit(&self) -> f64 {
        let (state, keyframes) = (&self.state, &self.state.tracks.keyframes);
        let posed = keyframes.iter().filter(|frame| state.poses[**frame].is_some());
        let inliers = |frame| state.matches(frame).iter().filter(|(_, o)| !o.is_outlier).count();
        let explained: usize = posed.map(|frame| inliers(*frame)).sum();
        let usual = median(&mut state.residuals_in(keyframes));
        usual.map_or(f64::INFINITY, |usual| usual / explained.max(1) as f64)
    }

    /// Moves the map to the world of another one with the same keyframes, with its unit of length if
    /// it has none of its own.
    fn move_to_world_of(&mut self, other: &SfmState) {
        let known = |frame: &usize| Some((other.poses[*frame]?, self.state.poses[*frame]?));
        let common: Vec<(Pose<f64>, Pose<f64>)> =
            other.tracks.keyframes.iter().filter_map(known).collect();
        let Some(((there, here), (last_there, last_here))) = common.first().zip(common.last())
        else {
            return;
        };
        let length = |a: &Pose<f64>, b: &Pose<f64>| (a.translation - b.translation).norm();
        let ratio = length(there, last_there) / length(here, last_here);
        let is_scaled = self.state.is_unscaled && ratio.is_finite() && ratio > 0.0;
        let scale = if is_scaled { ratio } else { 1.0 };
        let by = Similarity::from_pose(*there, scale)
            .compose(&Similarity::from_pose(*here, 1.0).inverse());
        self.state.transform(&by);
    }
}

/// Finds the readout that explains the rotations best, and corrects the rows of all observations.
fn initialize_rows(state: &mut SfmState, timestamps: &[f64]) {
    let (camera, progress) = (state.camera, state.progress.clone());
    let by_frame = state.tracks.tracks_by_frame();
    let tracks = (&mut state.tracks, by_frame.as_slice());
    state.readout = initialize_readout(tracks, &camera, timestamps, &progress);
}

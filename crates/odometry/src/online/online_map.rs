//! Map and path so far, to which every frame is added when it comes.
//!
//! A frame is registered to the landmarks of the keyframes before it, from where constant velocity
//! takes it; a keyframe brings new landmarks, and the keyframes around it are adjusted. Frames
//! between keyframes move with the one before them.

use crate::depth::readings::{read_depth_at_prediction, read_depth_in};
use crate::depth::scale::scale_to_readings;
use crate::online::path_alignment::{PosePair, align_path, path_change};
use crate::online::revisits::{Revisit, find_revisit};
use crate::register::dense_constraints::{RECENT_KEYFRAMES, RecentKeyframes};
use crate::register::initialization::initialize;
use crate::register::registration::{
    GLOBAL_ADJUSTMENT_GROWTH, MAX_JOINTLY_ADJUSTED_FRAMES, MIN_FOCAL_FRAMES, adjust_globally,
    adjust_nearest, estimate_pose, initial_poses, refine_pose, register_keyframes,
    register_remaining_frames,
};
use crate::relocalize::relocalization::{FailedPairs, relocalize_any_of};
use crate::rolling_shutter::readout::{
    MAX_COST_RATIO, correct_observations, correct_observations_in, estimate_rolling_shutter,
    median_frame_interval,
};
use crate::rolling_shutter::rolling_shutter_init::initialize_readout;
use crate::sfm_state::{MAX_READOUT, SfmState};
use crate::track::tracker::{BACKWARD_FRAMES, TrackedFrame, Tracker};
use crate::track::tracks::repeated_frame;
use i2slam_compute::median;
use i2slam_geometry::{Pose, Similarity};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Keyframes among which the first pair of a map is searched.
const INITIALIZATION_WINDOW: usize = 12;
/// Frames after which the readout is looked for.
const READOUT_ESTIMATES: [usize; 6] = [6, 10, 20, 30, 60, 120];
/// Keyframes up to which all are adjusted with every new one by colour alone: paths bend most while
/// they are short.
const MAX_ALWAYS_ADJUSTED_KEYFRAMES: usize = 30;
/// Relative change of the path by a keyframe and its adjustment, below which poses are given by
/// colour alone. Before, translations may be noise: where a camera hardly moved, factors of 2 to 7
/// were seen.
const MAX_SETTLED_CHANGE: f64 = 0.05;
/// Frames up to which another readout starts the map anew: rows were some pixels off.
const MAX_RESTART_FRAMES: usize = 30;

/// Knowledge of the pose of a frame at the time when it came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TrackingStatus {
    /// There is no map yet, or by colour alone none that holds.
    Initializing,
    /// Registered to the map.
    Tracked,
    /// The picture shows nothing of the map.
    Lost,
}

/// The map so far.
#[derive(Clone, Debug)]
pub(crate) struct OnlineMap {
    pub(crate) state: SfmState,
    /// `world_from_camera` of every frame as it was known when the frame came.
    pub(crate) poses: Vec<Option<Pose<f64>>>,
    failed: FailedPairs,
    recent_keyframes: RecentKeyframes,
    /// The last frame, if it is a keyframe by which the map is to be extended.
    pending_keyframe: Option<usize>,
    /// Keyframes at the last adjustment of all of them.
    adjusted_keyframes: usize,
    /// The keyframe that the frames of now move with, and the frames that move with each.
    reference: usize,
    followers: BTreeMap<usize, Vec<usize>>,
    /// True if the focal length is a guess, which is adjusted with all keyframes.
    adjusts_focal: bool,
    /// True once a keyframe hardly changed the path. Measured depth needs no such proof.
    is_settled: bool,
}

impl OnlineMap {
    /// An empty map.
    pub(crate) fn new(state: SfmState, adjusts_focal: bool) -> Self {
        Self {
            state,
            adjusts_focal,
            is_settled: false,
            poses: Vec::new(),
            failed: FailedPairs::default(),
            recent_keyframes: RecentKeyframes::default(),
            pending_keyframe: None,
            adjusted_keyframes: 0,
            reference: 0,
            followers: BTreeMap::new(),
        }
    }

    /// Adds the last frame of the tracker, whose timestamp, depth and picture the state has already.
    pub(crate) fn add_frame(
        &mut self,
        tracker: &mut Tracker,
        tracked: TrackedFrame,
        is_repeat: &[bool],
    ) -> TrackingStatus {
        let frame = self.state.poses.len();
        let is_keyframe = tracked.keyframe.is_some();
        self.state.add_frame(tracked, is_repeat);
        let own = repeated_frame(is_repeat, frame);
        if !self.awaits_camera() {
            let interval = median_frame_interval(&self.state.timestamps).unwrap_or(0.0);
            if !is_repeat[frame] {
                match self.is_started() {
                    true => self.register(frame, interval),
                    false => self.measure_again(frame, interval),
                }
            }
            if is_keyframe {
                self.begin_keyframe(own, tracker, interval);
            }
            self.followers.entry(self.reference).or_default().push(frame);
        }
        let is_known = self.is_settled || self.state.has_depth();
        self.poses.push(self.state.poses[own].filter(|_| is_known));
        self.status()
    }

    /// True where depth was measured and the camera is a guess: depth at a wrong focal length fits no
    /// landmark.
    fn awaits_camera(&self) -> bool {
        self.adjusts_focal && self.state.has_depth()
    }

    /// Starts a map at a keyframe, or prepares the present one to be extended by it.
    fn begin_keyframe(&mut self, frame: usize, tracker: &mut Tracker, interval: f64) {
        if !self.is_started() {
            self.reference = frame;
            self.start();
            return;
        }
        if self.state.poses[frame].is_none() {
            relocalize_any_of(&mut self.state, &[frame], &mut self.failed);
        }
        let is_own = frame + 1 == self.state.poses.len();
        if self.state.poses[frame].is_none() || (is_own && self.is_covered(tracker, interval)) {
            return;
        }
        (self.pending_keyframe, self.reference) = (Some(frame), frame);
    }

    /// Follows old landmarks that the last frame, a keyframe with a pose, shows again; drops it as a
    /// keyframe and returns true where an old one shows its view. By colour alone lengths drift: views
    /// that overlap in part are joined at the end, when loops are closed, and keyframes dropped from
    /// where on recordings are too long for all frames to be adjusted jointly.
    fn is_covered(&mut self, tracker: &mut Tracker, interval: f64) -> bool {
        let frame = self.state.poses.len() - 1;
        let state = &mut self.state;
        let is_left_to_the_end = match state.has_depth() {
            true => state.is_unscaled || state.depth_maps[frame].is_none(),
            false => state.posed_frames().len() <= MAX_JOINTLY_ADJUSTED_FRAMES,
        };
        if is_left_to_the_end {
            return false;
        }
        let Revisit { observations, covered_by } = find_revisit(state, !state.has_depth());
        if observations.is_empty() {
            return false;
        }
        tracker.resume(&observations);
        state.add_observations(observations);
        read_depth_in(state, frame, interval);
        if let Some(refined) = refine_pose(state, frame) {
            state.poses[frame] = Some(refined);
        }
        let Some(keyframe) = covered_by else { return false };
        state.tracks.drop_last_keyframe();
        self.reference = keyframe;
        true
    }

    /// Extends the map by the last frame if it was a keyframe, and looks for the readout where that is
    /// due. It needs no new picture, so that it may run while the next one is tracked.
    pub(crate) fn extend(&mut self) {
        if self.awaits_camera() {
            return;
        }
        let interval = median_frame_interval(&self.state.timestamps).unwrap_or(0.0);
        if let Some(frame) = self.pending_keyframe.take() {
            self.add_keyframe(frame, interval);
        }
        if READOUT_ESTIMATES.contains(&self.state.poses.len()) {
            self.estimate_readout(interval);
        }
    }

    /// True from the first landmarks on.
    pub(crate) fn is_started(&self) -> bool {
        self.adjusted_keyframes > 0
    }

    fn status(&self) -> TrackingStatus {
        match self.poses.last().copied().flatten() {
            Some(_) => TrackingStatus::Tracked,
            None if self.is_settled || (self.is_started() && self.state.has_depth()) => {
                TrackingStatus::Lost
            }
            None => TrackingStatus::Initializing,
        }
    }

    /// Starts a map from the last keyframes, if they allow it.
    fn start(&mut self) {
        let state = &mut self.state;
        let count = state.tracks.keyframes.len();
        if initialize(state, count.saturating_sub(INITIALIZATION_WINDOW)..count).is_err() {
            state.reset();
            return;
        }
        register_keyframes(state, self.adjusts_focal, usize::MAX);
        let posed = state.posed_frames().len();
        adjust_globally(state, self.adjusts_focal && posed >= MIN_FOCAL_FRAMES);
        let posed = state.posed_frames();
        self.adjusted_keyframes = posed.len();
        let recent = posed.iter().skip(posed.len().saturating_sub(RECENT_KEYFRAMES));
        recent.for_each(|frame| self.recent_keyframes.align(state, *frame));
        register_remaining_frames(state);
    }

    /// Registers a frame to the map, first with rows and depth for the predicted velocity.
    fn register(&mut self, frame: usize, interval: f64) {
        self.state.poses[frame] = initial_poses(&self.state, frame).first().copied();
        correct_rows(&mut self.state, frame, interval);
        read_depth_at_prediction(&mut self.state, frame, interval);
        let state = &mut self.state;
        state.poses[frame] = None;
        state.poses[frame] = estimate_pose(state, frame).map(|found| found.world_from_camera);
        self.measure_again(frame, interval);
        if let Some(refined) = refine_pose(&self.state, frame) {
            self.state.poses[frame] = Some(refined);
        }
        // Its velocity is known from both sides now.
        if frame > 0 {
            self.measure_again(frame - 1, interval);
        }
    }

    /// Corrects the rows of a frame and reads its depth for the velocity that is known now.
    fn measure_again(&mut self, frame: usize, interval: f64) {
        correct_rows(&mut self.state, frame, interval);
        read_depth_in(&mut self.state, frame, interval);
    }

    /// Adds the landmarks of a keyframe and adjusts the keyframes around it, or all where the map just
    /// got its unit of length.
    fn add_keyframe(&mut self, frame: usize, interval: f64) {
        for earlier in frame.saturating_sub(BACKWARD_FRAMES)..frame {
            self.measure_again(earlier, interval);
        }
        let state = &mut self.state;
        let is_rescaled = scale_to_readings(state);
        self.recent_keyframes.align(state, frame);
        let before = posed_keyframes(state);
        let adjusts_focal = self.adjusts_focal && before.len() >= MIN_FOCAL_FRAMES;
        let adjusted_at = &mut self.adjusted_keyframes;
        let has_grown = before.len() as f64 >= GLOBAL_ADJUSTMENT_GROWTH * *adjusted_at as f64;
        let is_short = !state.has_depth() && before.len() <= MAX_ALWAYS_ADJUSTED_KEYFRAMES;
        let adjusts_all = is_rescaled || has_grown || is_short;
        state.with_keyframes_alone(|state| {
            state.triangulate_missing_in(frame);
            match adjusts_all {
                true => {
                    *adjusted_at = before.len();
                    adjust_globally(state, adjusts_focal);
                }
                false => adjust_nearest(state, frame),
            }
        });
        move_with_keyframes(state, &before, &self.followers);
        self.settle(&before, interval);
        // Where few are adjusted, the others keep the world.
        if adjusts_all {
            self.keep_world();
        }
    }

    /// Starts the map of few keyframes by colour alone anew from the best pair of all, as long as
    /// keyframes change the path: the pair that was there first may have had too little parallax.
    fn settle(&mut self, before: &[(usize, Pose<f64>)], interval: f64) {
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

    /// Moves the map by colour alone to the world and the unit of length in which poses were given.
    fn keep_world(&mut self) {
        if self.state.has_depth() {
            return;
        }
        let pair =
            |(now, given): (&Option<Pose<f64>>, &Option<Pose<f64>>)| Some(((*now)?, (*given)?));
        let pairs: Vec<PosePair> =
            self.state.poses.iter().zip(&self.poses).filter_map(pair).collect();
        if let Some(back) = align_path(&pairs) {
            self.state.transform(&back);
        }
    }

    /// Looks for the readout, and adjusts the path to it: in the first frames by a map with the one
    /// that explains the rotations best, which has to explain more than the present map; later by the
    /// cost of the map.
    fn estimate_readout(&mut self, interval: f64) {
        let timestamps = Arc::clone(&self.state.timestamps);
        if self.is_started() && self.state.poses.len() > MAX_RESTART_FRAMES {
            let before = posed_keyframes(&self.state);
            self.state.with_keyframes_alone(|state| {
                estimate_rolling_shutter(state, &timestamps, false);
                adjust_globally(state, false);
            });
            move_with_keyframes(&mut self.state, &before, &self.followers);
            self.keep_world();
            return;
        }
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
        let before = posed_keyframes(state);
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

fn correct_rows(state: &mut SfmState, frame: usize, interval: f64) {
    let timestamps = Arc::clone(&state.timestamps);
    let readout = state.readout * interval;
    correct_observations_in(state, frame, &timestamps, (readout, interval));
}

/// Finds the readout that explains the rotations best, and corrects the rows of all observations.
fn initialize_rows(state: &mut SfmState, timestamps: &[f64]) {
    let (camera, progress) = (state.camera, state.progress.clone());
    state.readout = initialize_readout(&mut state.tracks, &camera, timestamps, &progress);
}

/// Keyframes with a pose, in order.
fn posed_keyframes(state: &SfmState) -> Vec<(usize, Pose<f64>)> {
    state.tracks.keyframes.iter().filter_map(|f| Some((*f, state.poses[*f]?))).collect()
}

/// Moves every frame with the keyframe that it follows, given where those were.
fn move_with_keyframes(
    state: &mut SfmState,
    before: &[(usize, Pose<f64>)],
    followers: &BTreeMap<usize, Vec<usize>>,
) {
    for (keyframe, was) in before {
        let Some(now) = state.poses[*keyframe].filter(|now| now != was) else { continue };
        let moved = now * was.inverse();
        for frame in followers.get(keyframe).into_iter().flatten().filter(|f| *f != keyframe) {
            if let Some(pose) = &mut state.poses[*frame] {
                *pose = moved * *pose;
            }
        }
    }
}

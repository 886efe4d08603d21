//! Map and path so far, to which every frame is added when it comes.
//!
//! A frame is registered to the landmarks of the keyframes before it, from where constant velocity
//! takes it; a keyframe brings new landmarks, and the keyframes around it are adjusted. Frames
//! between keyframes move with the one before them.

use super::frame_update::TrackingStatus;
use crate::depth::readings::{read_depth_at_prediction, read_depth_in};
use crate::depth::scale::scale_to_readings;
use crate::loops::loop_closure::close_last_loop;
use crate::multiview::pnp::PnpSolution;
use crate::online::local_map::{LocalMap, track_local_map};
use crate::online::path_alignment::{PosePair, align_path};
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
    ReadoutSearch, correct_observations_in, median_frame_interval,
};
use crate::sfm_state::SfmState;
use crate::track::tracker::{BACKWARD_FRAMES, TrackedFrame, Tracker};
use crate::track::tracks::{Observation, repeated_frame};
use i2slam_geometry::Pose;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Keyframes among which the first pair of a map is searched.
pub(super) const INITIALIZATION_WINDOW: usize = 12;
/// Frames after which the readout is looked for.
const READOUT_ESTIMATES: [usize; 10] = [6, 10, 20, 30, 45, 60, 75, 90, 105, 120];
/// Keyframes up to which all are adjusted with every new one by colour alone: paths bend most while
/// they are short.
const MAX_ALWAYS_ADJUSTED_KEYFRAMES: usize = 30;
/// Inliers of a frame's pose below which landmarks of the last keyframes are searched in it.
const MIN_TRACKED_INLIERS: usize = 50;
/// Keyframes after a loop before another is looked for: each takes an adjustment of all keyframes, and
/// what follows sees the same place.
const LOOP_PAUSE: usize = 8;

/// The map so far.
#[derive(Clone, Debug)]
pub(crate) struct OnlineMap {
    pub(crate) state: SfmState,
    /// `world_from_camera` of every frame as it was known when the frame came.
    pub(crate) poses: Vec<Option<Pose<f64>>>,
    failed: FailedPairs,
    pub(super) recent_keyframes: RecentKeyframes,
    /// The last frame, if it is a keyframe by which the map is to be extended.
    pending_keyframe: Option<usize>,
    /// Keyframes at the last adjustment of all of them.
    adjusted_keyframes: usize,
    /// The keyframe that the frames of now move with, and the frames that move with each.
    reference: usize,
    pub(super) followers: BTreeMap<usize, Vec<usize>>,
    /// True if the focal length is a guess, which is adjusted with all keyframes.
    adjusts_focal: bool,
    /// True once a keyframe hardly changed the path. Measured depth needs no such proof.
    pub(super) is_settled: bool,
    /// True if places that are seen again are joined, and once one was.
    pub(crate) closes_loops: bool,
    has_closed_loop: bool,
    /// Keyframes until a loop is looked for again.
    loop_pause: usize,
    pub(super) readout_search: Option<ReadoutSearch>,
    /// Track and frame of the observations by which places were joined.
    joining: Vec<(usize, usize)>,
}

impl OnlineMap {
    /// An empty map.
    pub(crate) fn new(state: SfmState, adjusts_focal: bool) -> Self {
        Self {
            state,
            adjusts_focal,
            is_settled: false,
            closes_loops: true,
            has_closed_loop: false,
            loop_pause: 0,
            readout_search: None,
            joining: Vec::new(),
            poses: Vec::new(),
            failed: FailedPairs::default(),
            recent_keyframes: RecentKeyframes::default(),
            pending_keyframe: None,
            adjusted_keyframes: 0,
            reference: 0,
            followers: BTreeMap::new(),
        }
    }

    /// The map, and the pose of every frame as it was known when the frame came.
    pub(crate) fn into_state_and_poses(self) -> (SfmState, Vec<Option<Pose<f64>>>) {
        (self.state, self.poses)
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
                    true => self.register(frame, tracker, interval),
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

    /// Joins the last frame, a keyframe with a pose, to old landmarks that it shows again. They are
    /// followed from there on, and where an old keyframe shows its view, it is dropped as a keyframe and
    /// true returned; neither where the path [is found anew](Self::is_found_anew_in_the_end).
    ///
    /// By colour alone lengths drift until a loop is closed: before, views that overlap in part are not
    /// joined by their poses.
    fn is_covered(&mut self, tracker: &mut Tracker, interval: f64) -> bool {
        let frame = self.state.poses.len() - 1;
        let is_found_anew = self.is_found_anew_in_the_end();
        let state = &mut self.state;
        let lengths_drift = !state.has_depth() && !self.has_closed_loop;
        let is_left_to_the_end = match state.has_depth() {
            true => state.is_unscaled || state.depth_maps[frame].is_none(),
            false => is_found_anew && lengths_drift,
        };
        if is_left_to_the_end {
            return false;
        }
        let Revisit { observations, covered_by } = find_revisit(state, lengths_drift);
        if observations.is_empty() {
            return false;
        }
        if !is_found_anew {
            tracker.resume(&observations);
        }
        self.join(observations);
        let state = &mut self.state;
        read_depth_in(state, frame, interval);
        if let Some(refined) = refine_pose(state, frame) {
            state.poses[frame] = Some(refined);
        }
        let Some(keyframe) = covered_by.filter(|_| !is_found_anew) else { return false };
        state.tracks.drop_last_keyframe();
        self.reference = keyframe;
        true
    }

    /// True for a path by colour alone, of so few frames that all are adjusted jointly in the end: it is
    /// made of the tracks alone then, and its loops are closed anew.
    fn is_found_anew_in_the_end(&self) -> bool {
        !self.state.has_depth() && self.state.posed_frames().len() <= MAX_JOINTLY_ADJUSTED_FRAMES
    }

    /// Adds observations of old landmarks.
    fn join(&mut self, observations: Vec<(usize, Observation)>) {
        let is_new = |(track, o): &&(usize, Observation)| {
            self.state.tracks.tracks[*track].observation_in(o.frame).is_none()
        };
        self.joining.extend(observations.iter().filter(is_new).map(|(track, o)| (*track, o.frame)));
        self.state.add_observations(observations);
    }

    /// Removes the observations of old landmarks from tracks of which the path is found anew.
    pub(crate) fn forget_joined_places(&mut self) {
        if self.is_found_anew_in_the_end() {
            self.forget_joined_from(0);
        }
    }

    /// Removes the joining observations from a number of them on.
    fn forget_joined_from(&mut self, known: usize) {
        for (track, frame) in self.joining.drain(known..) {
            self.state.remove_observation(track, frame);
        }
    }

    /// Extends the map by the last frame if it was a keyframe, and looks for the readout where that is
    /// due; returns whether a loop was closed. It needs no new picture, so that it may run while the
    /// next one is tracked.
    pub(crate) fn extend(&mut self) -> bool {
        if self.awaits_camera() {
            return false;
        }
        let interval = median_frame_interval(&self.state.timestamps).unwrap_or(0.0);
        let mut is_loop_closed = false;
        if let Some(frame) = self.pending_keyframe.take() {
            self.add_keyframe(frame, interval);
            is_loop_closed = self.close_loop();
        }
        if READOUT_ESTIMATES.contains(&self.state.poses.len()) {
            self.estimate_readout(interval);
        }
        self.continue_readout_search();
        is_loop_closed
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
    pub(super) fn start(&mut self) {
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
    fn register(&mut self, frame: usize, tracker: &mut Tracker, interval: f64) {
        self.state.poses[frame] = initial_poses(&self.state, frame).first().copied();
        correct_rows(&mut self.state, frame, interval);
        read_depth_at_prediction(&mut self.state, frame, interval);
        let state = &mut self.state;
        state.poses[frame] = None;
        match estimate_pose(state, frame) {
            Some(found) if found.inliers >= MIN_TRACKED_INLIERS => {
                state.poses[frame] = Some(found.world_from_camera);
            }
            found => self.register_locally(frame, found, tracker, interval),
        }
        self.measure_again(frame, interval);
        if let Some(refined) = refine_pose(&self.state, frame) {
            self.state.poses[frame] = Some(refined);
        }
        // Its velocity is known from both sides now.
        if frame > 0 {
            self.measure_again(frame - 1, interval);
        }
    }

    /// Registers the last frame by landmarks of the last keyframes, where more of them agree with a pose than
    /// with that of the points that were followed, and follows those.
    fn register_locally(
        &mut self,
        frame: usize,
        followed: Option<PnpSolution>,
        tracker: &mut Tracker,
        interval: f64,
    ) {
        let map = LocalMap { state: &self.state, tracker, frame, interval };
        let start = followed.map(|followed| followed.world_from_camera);
        let found = track_local_map(&map, start);
        self.state.poses[frame] = start;
        let least = followed.map_or(0, |followed| followed.inliers);
        let Some((pose, found)) = found.filter(|(_, found)| found.len() > least) else { return };
        self.state.poses[frame] = Some(pose);
        correct_rows(&mut self.state, frame, interval);
        let astray = self.state.tracks_off_pose(frame, &pose);
        tracker.follow_found(&found, &astray);
        for track in found.iter().map(|f| &f.point.track).chain(&astray) {
            self.state.remove_observation(*track, frame);
        }
        let observed = found.iter().map(|f| (f.point.track, f.observation)).collect();
        self.state.add_observations(observed);
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
        let before = state.posed_keyframes();
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

    /// Joins the last keyframe to a place that it sees again, and adjusts all keyframes; returns
    /// whether there was one. Where the adjustment rejects most of what joins the places, they only look
    /// alike: the map stays as it was.
    fn close_loop(&mut self) -> bool {
        let has_lengths = match self.state.has_depth() {
            true => !self.state.is_unscaled,
            false => self.is_settled,
        };
        if !self.closes_loops || !has_lengths {
            return false;
        }
        self.loop_pause = self.loop_pause.saturating_sub(1);
        if self.loop_pause > 0 {
            return false;
        }
        let as_it_was = (self.state.camera, self.state.poses.clone(), self.state.landmarks.clone());
        let observations = close_last_loop(&mut self.state, &self.followers);
        if observations.is_empty() {
            return false;
        }
        self.loop_pause = LOOP_PAUSE;
        let joined: Vec<(usize, usize)> =
            observations.iter().map(|(track, o)| (*track, o.frame)).collect();
        let known_before = self.joining.len();
        self.join(observations);
        let before = self.state.posed_keyframes();
        let adjusts_focal = self.adjusts_focal;
        self.state.with_keyframes_alone(|state| adjust_globally(state, adjusts_focal));
        let tracks = &self.state.tracks.tracks;
        let is_kept = |(track, frame): &&(usize, usize)| {
            tracks[*track].observation_in(*frame).is_some_and(|o| !o.is_outlier)
        };
        if 2 * joined.iter().filter(is_kept).count() < joined.len() {
            self.forget_joined_from(known_before);
            (self.state.camera, self.state.poses, self.state.landmarks) = as_it_was;
            return false;
        }
        self.has_closed_loop = true;
        self.adjusted_keyframes = before.len();
        move_with_keyframes(&mut self.state, &before, &self.followers);
        self.keep_world();
        true
    }

    /// Moves the map by colour alone to the world and the unit of length in which poses were given.
    pub(super) fn keep_world(&mut self) {
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
}

fn correct_rows(state: &mut SfmState, frame: usize, interval: f64) {
    let timestamps = Arc::clone(&state.timestamps);
    let readout = state.readout * interval;
    correct_observations_in(state, frame, &timestamps, (readout, interval));
}

/// Moves every frame with the keyframe that it follows, given where those were.
pub(super) fn move_with_keyframes(
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

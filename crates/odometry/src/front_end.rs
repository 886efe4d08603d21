//! The odometry pipeline: pictures, with or without depth, in; reconstruction out.

use crate::depth::calibration::calibrate_depth;
use crate::depth::depth_map::DepthPicture;
use crate::depth::readings::read_depth;
use crate::diagnosis::findings::diagnose;
use crate::diagnosis::pictures::PictureChecks;
use crate::error::{OdometryError, PictureError};
use crate::features::collection::PhotoCollection;
use crate::intrinsics::focal_length::{Intrinsics, search_focal_length};
use crate::intrinsics::observability::drop_unobservable_distortion;
use crate::loops::loop_closure::close_loops;
use crate::map_building::build_map;
use crate::online::frame_update::FrameUpdate;
use crate::online::online_map::OnlineMap;
use crate::progress::{Progress, Stage};
use crate::register::approximate_poses::{
    in_unit_of_path, place_unsupported, register_near, take_given_poses,
};
use crate::register::dense_constraints::add_dense_constraints;
use crate::register::known_path::KnownPath;
use crate::register::photographs::with_matches;
use crate::register::position_refinement::refine_positions;
use crate::register::registration::{adjust_all_frames, adjust_path, adjust_remaining_frames};
use crate::result::{Reconstruction, build_reconstruction, reconstruction_so_far};
use crate::rolling_shutter::readout::{
    MIN_READOUT_FRAMES, estimate_rolling_shutter, median_frame_interval,
};
use crate::rolling_shutter::rolling_shutter_init::initialize_readout;
use crate::segmentation::moving_tracks::leave_out_moving_objects;
use crate::sfm_state::SfmState;
use crate::track::tracker::Tracker;
use crate::track::tracks::{Tracks, repeated_frame};
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_storage::ScratchStore;
use std::sync::Arc;

/// Smallest number of pictures.
pub const MIN_FRAMES: usize = 4;
/// Relative change of cost and focal length at convergence, and most global adjustments.
const CONVERGED_CHANGE: f64 = 1e-3;
const MAX_ADJUSTMENT_ROUNDS: usize = 5;
/// Searches for offset and delay of depth pictures.
const DEPTH_CALIBRATION_ROUNDS: usize = 3;
/// Time between a depth picture and its colour picture up to which it is used, a frame interval
/// where that is longer [s]: it is read for the velocity of the camera, which hands change within.
const MAX_DEPTH_DELAY: f64 = 0.1;
/// Share of the frames that must be posed, or else the path is a given one, if there is one.
pub const MIN_POSED_SHARE: f64 = 0.6;
/// Shorter side of a picture, at least [px].
pub const MIN_SIDE: usize = 48;

/// Monocular visual odometry: [`push`](Self::push) all pictures, then [`finish`](Self::finish).
#[derive(Clone, Debug)]
pub struct FrontEnd {
    intrinsics: Intrinsics,
    tracker: Tracker,
    picture_checks: PictureChecks,
    photographs: PhotoCollection,
    map: OnlineMap,
    /// Pictures and depth of all frames.
    scratch: Arc<ScratchStore>,
    /// True if the last picture that repeats no other is held out.
    is_held_out: bool,
}

impl FrontEnd {
    /// A front end for pictures of one camera.
    pub fn new(intrinsics: Intrinsics) -> Self {
        let (tracker, picture_checks) = (Tracker::default(), PictureChecks::default());
        let state = SfmState::new(*intrinsics.camera(), Tracks::default());
        let map = OnlineMap::new(state, !matches!(intrinsics, Intrinsics::Known(_)));
        let (photographs, scratch) = (PhotoCollection::default(), ScratchStore::in_memory());
        Self { intrinsics, tracker, picture_checks, photographs, map, scratch, is_held_out: false }
    }

    /// Disables loop closure, before the first picture.
    pub fn without_loop_closure(mut self) -> Self {
        self.map.closes_loops = false;
        self
    }

    /// Bounds the memory of pictures and depth of all frames, before the first of them: memory then
    /// grows by the tracks of points and by keyframes alone. The result stays the same, byte for byte;
    /// [`finish`](Self::finish) fails where a picture cannot be read back.
    pub fn with_scratch(self, scratch: Arc<ScratchStore>) -> Self {
        Self { scratch, ..self }
    }

    /// Tracks points into the next picture, and registers it to the map so far: planes R, G, B in
    /// [0, 1], or one plane of brightness; timestamp [s]; measured depth of the same size, if there is
    /// one. Its pose is known at once with depth. By colour alone it is from the moment on when a
    /// keyframe has changed the path by less than 5 % of its extent; a guessed camera counts until
    /// [`finish`](Self::finish) has found it. With depth and a guessed camera no pose is known before.
    ///
    /// Depth taken more than a tenth of a second and more than a frame interval from its picture is
    /// left out, and told ([`DepthNotInTime`](crate::Warning::DepthNotInTime)).
    ///
    /// # Errors
    ///
    /// A picture that does not fit is refused; the state stays as it was.
    pub fn push(
        &mut self,
        picture: &Image<f32>,
        timestamp: f64,
        depth: Option<&DepthPicture<'_>>,
    ) -> Result<FrameUpdate, PictureError> {
        self.push_frame((picture, false), timestamp, depth)
    }

    /// [`push`](Self::push) of a picture that is held out of the map to be made: it becomes a keyframe only as
    /// the first one, after a cut, or where one has been due for three pictures. A picture that repeats the one
    /// before is held out as that is.
    ///
    /// # Errors
    ///
    /// As [`push`](Self::push).
    pub fn push_held_out(
        &mut self,
        picture: &Image<f32>,
        timestamp: f64,
        depth: Option<&DepthPicture<'_>>,
    ) -> Result<FrameUpdate, PictureError> {
        self.push_frame((picture, true), timestamp, depth)
    }

    fn push_frame(
        &mut self,
        (picture, is_held_out): (&Image<f32>, bool),
        timestamp: f64,
        depth: Option<&DepthPicture<'_>>,
    ) -> Result<FrameUpdate, PictureError> {
        let camera = self.intrinsics.camera();
        let expected = [camera.width, camera.height];
        PictureError::check(picture, expected, MIN_SIDE)?;
        let last = self.map.state.timestamps.last().copied().unwrap_or(f64::NEG_INFINITY);
        if !timestamp.is_finite() || timestamp <= last {
            return Err(PictureError::Stamp { timestamp, last });
        }
        depth.map_or(Ok(()), |depth| PictureError::check_depth(depth, expected))?;
        self.picture_checks.add(picture);
        if !self.picture_checks.is_repeat[self.map.state.poses.len()] {
            self.is_held_out = is_held_out;
        }
        let is_held_out = self.is_held_out;
        let depth = depth.filter(|depth| self.is_in_time(depth.timestamp - timestamp));
        // Points are followed without the map, and the map grows by pictures that were tracked already.
        let (tracked, is_loop_closed) =
            rayon::join(|| self.tracker.track(picture, is_held_out), || self.map.extend());
        self.map.state.add_input(picture, timestamp, depth, &self.scratch);
        let (frame, is_cut) = (self.map.state.poses.len(), tracked.is_cut);
        let is_own = !self.picture_checks.is_repeat[frame] && !self.picture_checks.is_blank[frame];
        if let Some(now) = self.tracker.last_picture().filter(|_| is_own) {
            let points = [tracked.observed.len(), tracked.seen_before];
            self.photographs.add(frame, now, points);
        }
        let is_repeat = &self.picture_checks.is_repeat;
        let status = self.map.add_frame(&mut self.tracker, tracked, is_repeat);
        let pose = self.map.poses.last().copied().flatten();
        let is_keyframe = self.map.state.tracks.keyframes.last() == Some(&frame);
        Ok(FrameUpdate { frame, pose, status, is_cut, is_keyframe, is_loop_closed })
    }

    /// True if a depth picture taken `later` than its colour picture [s] is used.
    fn is_in_time(&mut self, later: f64) -> bool {
        let interval = || median_frame_interval(&self.map.state.timestamps);
        let delay = later.abs();
        let is_in_time =
            delay <= MAX_DEPTH_DELAY || interval().is_some_and(|interval| delay <= interval);
        self.picture_checks.add_depth(delay, is_in_time);
        is_in_time
    }

    /// True if the pictures so far are photographs rather than frames of a film.
    pub fn is_unordered(&self) -> bool {
        self.photographs.is_unordered()
    }

    /// Camera with which the last poses were found: the one given, or what keyframes have made of a guess
    /// so far. [`finish`](Self::finish) finds it from all pictures.
    pub fn camera(&self) -> Camera<f64> {
        self.map.state.camera
    }

    /// The path so far, in the world and the unit of length of [`FrameUpdate::pose`], with the
    /// landmarks of one keyframe, given by its frame. Frames between keyframes have a pose, too; none
    /// has a deviation.
    pub fn path_so_far(&self, keyframe: Option<usize>) -> Reconstruction {
        let found = reconstruction_so_far(&self.map.state, keyframe);
        Reconstruction { online_poses: self.map.poses.clone(), ..found }
    }

    /// Reconstructs the camera path from all pictures so far.
    ///
    /// # Errors
    ///
    /// The reason why there is no path; [`OdometryError::Cancelled`] after cancellation.
    pub fn finish(self, progress: Progress) -> Result<Reconstruction, OdometryError> {
        self.finish_near(&[], progress)
    }

    /// Reconstructs the camera path from all pictures so far, and from `approximate` poses of the accepted
    /// ones, `world_from_camera` in any world and unit. Those of photographs are adjusted, as far as their
    /// pictures show that they are not exact. The path of a film is found without; where too few of its frames
    /// can be posed so, it is the given one. A guessed focal length of photographs stays then.
    ///
    /// # Errors
    ///
    /// As [`finish`](Self::finish).
    pub fn finish_near(
        mut self,
        approximate: &[Option<Pose<f64>>],
        progress: Progress,
    ) -> Result<Reconstruction, OdometryError> {
        self.map.extend();
        self.map.forget_joined_places();
        let timestamps = Arc::clone(&self.map.state.timestamps);
        let frames = timestamps.len();
        let given = in_unit_of_path(approximate, frames);
        if frames < MIN_FRAMES {
            return Err(OdometryError::TooFewFrames { frames, needed: MIN_FRAMES });
        }
        let is_repeat = self.picture_checks.is_repeat.clone();
        let own_pictures = is_repeat.iter().filter(|repeat| !**repeat).count();
        if own_pictures < MIN_FRAMES && !self.map.state.has_depth() {
            return Err(OdometryError::StillCamera { motion: 0.0 });
        }
        let adjust_focal = !matches!(self.intrinsics, Intrinsics::Known(_));
        let Self { intrinsics, tracker, picture_checks, photographs, map, scratch, .. } = self;
        drop(tracker);
        let closes_loops = map.closes_loops;
        let (online, online_poses) = map.into_state_and_poses();
        let known = KnownPath::of(&online);
        let online = SfmState { progress: progress.clone(), ..online };
        // Measured depth tells poses of pictures that share few points, too.
        let posed = online.posed_frames().len() as f64;
        let is_tracked = online.has_depth() && posed >= MIN_POSED_SHARE * frames as f64;
        let is_unordered = photographs.is_unordered() && !is_tracked;
        let mut state = match is_unordered {
            true => photographs_state(online, &photographs, &intrinsics),
            false => initial_state(online, &intrinsics),
        };
        let found = match (is_unordered, given.as_slice()) {
            (true, []) => {
                state = with_matches(state, &photographs, &[]);
                estimate_path(&mut state, None, adjust_focal).map(|()| PathSource::Tracks)
            }
            (true, given) => {
                let (registered, stay) = register_near(state, &photographs, given);
                state = registered;
                Ok(if stay { PathSource::Given } else { PathSource::Tracks })
            }
            (false, given) => estimate_path_or_take(&mut state, Some(&known), given, adjust_focal),
        };
        // A cancelled search may look like any other failure.
        if progress.is_cancelled() {
            return Err(OdometryError::Cancelled);
        }
        let source = found?;
        let are_given = source == PathSource::Given;
        let mut distortion_dropped = false;
        if !are_given {
            distortion_dropped = refine_path(&mut state, closes_loops, adjust_focal);
            if is_unordered && !given.is_empty() {
                place_unsupported(&mut state, &given);
            }
        }
        if progress.is_cancelled() {
            return Err(OdometryError::Cancelled);
        }
        if let Some(reason) = scratch.failure() {
            return Err(OdometryError::Scratch { reason });
        }
        let readout = state.readout * median_frame_interval(&timestamps).unwrap_or(0.0);
        let (found, wrong) = ((readout, distortion_dropped), diagnose(&state, &picture_checks));
        for frame in 0..frames {
            state.poses[frame] = state.poses[repeated_frame(&is_repeat, frame)];
        }
        let built = build_reconstruction(state, &timestamps, &intrinsics, found, &is_repeat);
        let built = Reconstruction { online_poses, has_given_poses: are_given, ..built };
        let built = match source {
            PathSource::Known => built.with_little_parallax(),
            PathSource::Tracks | PathSource::Given => built,
        };
        Ok(wrong.applied_to(built))
    }
}

/// Adjusts a path until it has converged, with what pictures tell of depth, readout and places seen again;
/// true if lens distortion was not observable, and dropped.
fn refine_path(state: &mut SfmState, closes_loops: bool, adjust_focal: bool) -> bool {
    // This rests on motion between neighbours in time.
    if state.photographs.is_none() {
        register_depth_pictures(state, adjust_focal);
        correct_rolling_shutter(state, adjust_focal);
        if closes_loops {
            close_loops(state, adjust_focal);
        }
    }
    state.progress.report(Stage::BundleAdjustment, 0, 0);
    adjust_until_converged(state, adjust_focal);
    if state.photographs.is_some() && !state.progress.is_cancelled() {
        refine_positions(state);
        adjust_until_converged(state, adjust_focal);
    }
    let distortion_dropped = drop_unobservable_distortion(state);
    add_dense_constraints(state);
    adjust_remaining_frames(state, adjust_focal);
    distortion_dropped
}

/// Finds the readout of the rows, and adjusts all frames to it.
fn correct_rolling_shutter(state: &mut SfmState, adjust_focal: bool) {
    let had_initial_readout = state.readout != 0.0;
    estimate_rolling_shutter(state, adjust_focal);
    if state.readout != 0.0 || had_initial_readout {
        adjust_all_frames(state, adjust_focal);
    }
    // The first readout used velocities of a path fitted to uncorrected rows: estimate it again.
    if state.readout != 0.0 {
        estimate_rolling_shutter(state, adjust_focal);
        adjust_all_frames(state, adjust_focal);
    }
}

/// Finds offset and delay of the depth pictures, and adjusts all frames to what is read then. What
/// unregistered depth did to the landmarks is undone by a second round.
fn register_depth_pictures(state: &mut SfmState, adjust_focal: bool) {
    for _ in 0..DEPTH_CALIBRATION_ROUNDS {
        if state.progress.is_cancelled() || !calibrate_depth(state) {
            return;
        }
        adjust_path(state, adjust_focal);
    }
}

/// The state that adjustment begins with: the map so far where there is one with depth, or else its
/// tracks alone, with the observations of places that were known again, without those of large moving
/// objects; a map that holds some is bent by them.
fn initial_state(mut online: SfmState, intrinsics: &Intrinsics) -> SfmState {
    online.shrink_to_fit();
    let is_metric = online.is_metric();
    let mut tracks = std::mem::take(&mut online.tracks).with_two_keyframes();
    // Observations are too many to be held twice.
    let known = if is_metric { tracks.estimates() } else { Vec::new() };
    tracks.drop_estimates();
    let mut state = SfmState {
        timestamps: Arc::clone(&online.timestamps),
        depth_maps: Arc::clone(&online.depth_maps),
        pictures: Arc::clone(&online.pictures),
        progress: online.progress.clone(),
        estimates_distortion: matches!(intrinsics, Intrinsics::GuessWithDistortion(_)),
        ..SfmState::new(*intrinsics.camera(), tracks)
    };
    read_depth(&mut state);
    let by_frame = Arc::clone(&state.by_frame);
    correct_rows(&mut state, &by_frame);
    if leave_out_moving_objects(&mut state) {
        let by_frame = Arc::clone(&state.by_frame);
        correct_rows(&mut state, &by_frame);
    } else if is_metric {
        let mut tracks = state.tracks;
        tracks.set_estimates(known);
        state = SfmState { tracks, relative_poses: Arc::default(), ..online };
        if state.readout == 0.0 {
            correct_rows(&mut state, &by_frame);
        }
    }
    state
}

/// The state that adjustment of photographs begins with: tracks, and every photograph as a keyframe.
fn photographs_state(
    online: SfmState,
    photographs: &PhotoCollection,
    intrinsics: &Intrinsics,
) -> SfmState {
    let mut tracks = online.tracks.with_keyframes(photographs.images());
    tracks.drop_estimates();
    SfmState {
        timestamps: online.timestamps,
        depth_maps: online.depth_maps,
        progress: online.progress,
        estimates_distortion: matches!(intrinsics, Intrinsics::GuessWithDistortion(_)),
        ..SfmState::new(*intrinsics.camera(), tracks)
    }
}

/// Corrects the rows of all observations for the readout that explains the rotations best; with the
/// tracks of every frame, in order. A whole film of too few frames tells none.
fn correct_rows(state: &mut SfmState, by_frame: &[Vec<usize>]) {
    if !state.estimates_distortion && state.tracks.frames >= MIN_READOUT_FRAMES {
        let (tracks, timestamps) = (&mut state.tracks, &state.timestamps);
        state.readout =
            initialize_readout((tracks, by_frame), &state.camera, timestamps, &state.progress);
    }
}

/// Beginning of the path of a film.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PathSource {
    /// Its tracks.
    Tracks,
    /// The path that was known when its last frame came, as no two keyframes have enough parallax.
    Known,
    /// Given poses, which stay.
    Given,
}

/// Focal length and the map; `known` is a path that may fit better.
fn estimate_path(
    state: &mut SfmState,
    known: Option<&KnownPath>,
    adjust_focal: bool,
) -> Result<(), OdometryError> {
    if adjust_focal {
        search_focal_length(state)?;
    }
    build_map(state, known, adjust_focal)
}

/// Estimates the path of a film, or takes the given one, if there is one, where too few frames are found. Depth
/// that was measured is of use in its own unit alone. Where no two keyframes begin a map, the `known` path may.
fn estimate_path_or_take(
    state: &mut SfmState,
    known: Option<&KnownPath>,
    given: &[Option<Pose<f64>>],
    adjust_focal: bool,
) -> Result<PathSource, OdometryError> {
    let found = estimate_path(state, known, adjust_focal);
    let posed = if found.is_ok() { state.posed_frames().len() } else { 0 };
    let is_enough = posed as f64 >= MIN_POSED_SHARE * given.len() as f64;
    if !given.is_empty() && !is_enough && !state.has_depth() && !state.progress.is_cancelled() {
        state.drop_readout();
        take_given_poses(state, given);
        return Ok(PathSource::Given);
    }
    let Err(error) = found else { return Ok(PathSource::Tracks) };
    let lacks_parallax =
        matches!(error, OdometryError::RotationOnly { .. } | OdometryError::NoConsistentMotion);
    if lacks_parallax && known.is_some_and(|known| known.begin(state, adjust_focal)) {
        build_map(state, None, adjust_focal)?;
        return Ok(PathSource::Known);
    }
    Err(error)
}

/// Adjusts the path until cost and focal length converge: slow bends hardly change one cost.
fn adjust_until_converged(state: &mut SfmState, adjust_focal: bool) {
    let mut before = (f64::INFINITY, state.camera.fx);
    for _ in 0..MAX_ADJUSTMENT_ROUNDS {
        if state.progress.is_cancelled() {
            return;
        }
        let now = (adjust_path(state, adjust_focal), state.camera.fx);
        let changes = [now.0 / before.0, now.1 / before.1].map(|ratio| ratio.ln().abs());
        if changes.iter().all(|change| *change < CONVERGED_CHANGE) {
            break;
        }
        before = now;
    }
}

#[cfg(test)]
mod tests;

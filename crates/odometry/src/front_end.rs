//! Pictures in, camera path out.

use crate::error::{OdometryError, PictureError};
use crate::intrinsics::focal_length::{Intrinsics, find_focal};
use crate::intrinsics::observability::give_up_doubtful_lens;
use crate::loops::loop_closure::{close_loops, join_neighbours};
use crate::progress::Progress;
use crate::register::initialization::{start, start_within};
use crate::register::registration::{adjust_all, grow, pose_rest, refine};
use crate::relocalize::relocalization::{Tried, relocalise};
use crate::result::{Reconstruction, assemble};
use crate::rolling_shutter::readout::{correct_rolling_shutter, interval};
use crate::rolling_shutter::rolling_shutter_init::straighten;
use crate::sfm_state::Scene;
use crate::track::tracker::{FrameReport, Tracker};
use i2slam_geometry::Image;

/// Pictures without which nothing is tried.
pub const MIN_FRAMES: usize = 4;
/// What changes by less than this share is settled; all is adjusted so often at most.
const SETTLED: f64 = 1e-3;
const MAX_ROUNDS: usize = 5;
/// Least side of a picture [px].
pub const MIN_SIDE: usize = 48;

/// A monocular front end: [`push`](Self::push) every picture in order, then
/// [`finish`](Self::finish).
#[derive(Clone, Debug)]
pub struct FrontEnd {
    intrinsics: Intrinsics,
    tracker: Tracker,
    timestamps: Vec<f64>,
    close_loops: bool,
}

impl FrontEnd {
    /// A front end for pictures of one pinhole camera.
    pub fn new(intrinsics: Intrinsics) -> Self {
        let (tracker, timestamps) = (Tracker::default(), Vec::new());
        Self { intrinsics, tracker, timestamps, close_loops: true }
    }

    /// The same, without looking for places that are seen again after their points were lost.
    pub fn without_loop_closure(self) -> Self {
        Self { close_loops: false, ..self }
    }

    /// Follows points into the next picture: planes R, G, B in [0, 1], or one plane of
    /// brightness; stamp [s].
    ///
    /// # Errors
    ///
    /// A picture that does not fit is refused and counts as if it had not come.
    pub fn push(
        &mut self,
        picture: &Image<f32>,
        timestamp: f64,
    ) -> Result<FrameReport, PictureError> {
        let camera = self.intrinsics.camera();
        let (width, height) = (picture.width, picture.height);
        if (width, height) != (camera.width, camera.height) {
            let (expected_width, expected_height) = (camera.width, camera.height);
            return Err(PictureError::Size { width, height, expected_width, expected_height });
        }
        if width.min(height) < MIN_SIDE {
            return Err(PictureError::TooSmall { width, height, least: MIN_SIDE });
        }
        let (channels, values) = (picture.channels, picture.data.len());
        if !matches!(channels, 1 | 3) || values != width * height * channels {
            return Err(PictureError::Planes { channels, values });
        }
        let last = self.timestamps.last().copied().unwrap_or(f64::NEG_INFINITY);
        if !timestamp.is_finite() || timestamp <= last {
            return Err(PictureError::Stamp { timestamp, last });
        }
        self.timestamps.push(timestamp);
        Ok(self.tracker.follow(picture))
    }

    /// Finds the path of the camera.
    ///
    /// # Errors
    ///
    /// Why there is none.
    pub fn finish(self) -> Result<Reconstruction, OdometryError> {
        self.finish_with_progress(Progress::default())
    }

    /// The same while somebody watches.
    ///
    /// # Errors
    ///
    /// Why there is none; [`OdometryError::Cancelled`] where `progress` ended it.
    pub fn finish_with_progress(self, progress: Progress) -> Result<Reconstruction, OdometryError> {
        let frames = self.timestamps.len();
        if frames < MIN_FRAMES {
            return Err(OdometryError::TooFewFrames { frames, needed: MIN_FRAMES });
        }
        let tracks = self.tracker.finish().with_two_keyframes();
        let adjust_focal = !matches!(self.intrinsics, Intrinsics::Known(_));
        let mut scene = Scene::new(*self.intrinsics.camera(), tracks);
        scene.progress = progress.clone();
        scene.finds_lens = matches!(self.intrinsics, Intrinsics::GuessWithDistortion(_));
        let found = find_path(&mut scene, adjust_focal, &self.timestamps);
        // What was left half done may look like any other failure.
        if progress.is_cancelled() {
            return Err(OdometryError::Cancelled);
        }
        found?;
        let was_straightened = scene.readout != 0.0;
        correct_rolling_shutter(&mut scene, &self.timestamps, adjust_focal);
        if scene.readout != 0.0 || was_straightened {
            refine(&mut scene, adjust_focal);
        }
        if scene.readout != 0.0 {
            correct_rolling_shutter(&mut scene, &self.timestamps, adjust_focal);
            refine(&mut scene, adjust_focal);
        }
        if self.close_loops {
            close_loops(&mut scene, adjust_focal);
        }
        settle(&mut scene, adjust_focal);
        let lens_is_doubtful = give_up_doubtful_lens(&mut scene);
        if progress.is_cancelled() {
            return Err(OdometryError::Cancelled);
        }
        let readout = scene.readout * interval(&self.timestamps).unwrap_or(0.0);
        let found = (readout, lens_is_doubtful);
        Ok(assemble(scene, &self.timestamps, &self.intrinsics, found))
    }
}

/// Camera, poses and landmarks, of rows as they seem to have been read.
fn find_path(
    scene: &mut Scene,
    adjust_focal: bool,
    timestamps: &[f64],
) -> Result<(), OdometryError> {
    if !scene.finds_lens {
        scene.readout = straighten(&mut scene.tracks, &scene.camera, timestamps, &scene.progress);
    }
    if adjust_focal {
        find_focal(scene)?;
    }
    map(scene, adjust_focal)
}

/// Adjusts everything until cost and focal length stay where they are: a path that bends as a whole
/// hardly changes what is seen, and neither does a focal length beside rows that were read in turn.
fn settle(scene: &mut Scene, adjust_focal: bool) {
    let mut before = (f64::INFINITY, scene.camera.fx);
    for _ in 0..MAX_ROUNDS {
        if scene.progress.is_cancelled() {
            return;
        }
        let now = (refine(scene, adjust_focal), scene.camera.fx);
        let changes = [now.0 / before.0, now.1 / before.1].map(|ratio| ratio.ln().abs());
        if changes.iter().all(|change| *change < SETTLED) {
            break;
        }
        before = now;
    }
}

/// Poses and landmarks from tracks alone.
fn map(scene: &mut Scene, adjust_focal: bool) -> Result<(), OdometryError> {
    start(scene)?;
    let mut was_lost = spread(scene, adjust_focal);
    if let Some((other, other_was_lost)) = larger_part(scene, adjust_focal) {
        (*scene, was_lost) = (other, other_was_lost);
    }
    adjust_all(scene, adjust_focal);
    pose_rest(scene);
    refine(scene, adjust_focal);
    if was_lost {
        join_neighbours(scene, adjust_focal);
    }
    Ok(())
}

/// Poses all keyframes that can be reached or recognised; returns whether some had been lost.
fn spread(scene: &mut Scene, adjust_focal: bool) -> bool {
    let (mut tried, mut was_lost) = (Tried::default(), false);
    loop {
        grow(scene, adjust_focal, usize::MAX);
        if relocalise(scene, &mut tried).is_empty() {
            return was_lost;
        }
        was_lost = true;
        scene.add_landmarks();
    }
}

/// The scene from another start, where keyframes in a row that were not reached stand for more
/// frames than those that were, if more are reached from there; and whether some had been lost.
fn larger_part(scene: &Scene, adjust_focal: bool) -> Option<(Scene, bool)> {
    let is_posed = |place: usize| scene.poses[scene.tracks.keyframes[place]].is_some();
    let places: Vec<usize> = (0..scene.tracks.keyframes.len()).collect();
    let runs = places.chunk_by(|a, b| is_posed(*a) == is_posed(*b)).filter(|r| !is_posed(r[0]));
    let length = |run: &[usize]| run.iter().map(|place| stands_for(scene, *place)).sum::<usize>();
    let reached = reached(scene);
    let longest = runs.max_by_key(|run| length(run)).filter(|run| length(run) > reached)?;
    let mut other = scene.clone();
    other.forget();
    start_within(&mut other, longest[0]..longest[longest.len() - 1] + 1).ok()?;
    let was_lost = spread(&mut other, adjust_focal);
    (self::reached(&other) > reached).then_some((other, was_lost))
}

/// Number of frames from a keyframe, given by its place among them, to the next one.
fn stands_for(scene: &Scene, place: usize) -> usize {
    let keyframes = &scene.tracks.keyframes;
    keyframes.get(place + 1).copied().unwrap_or(scene.poses.len()) - keyframes[place]
}

/// Number of frames that keyframes with a pose stand for.
fn reached(scene: &Scene) -> usize {
    let keyframes = scene.tracks.keyframes.iter().enumerate();
    let posed = keyframes.filter(|(_, frame)| scene.poses[**frame].is_some());
    posed.map(|(place, _)| stands_for(scene, place)).sum()
}

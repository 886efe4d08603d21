//! Pictures of a sequence that the front end was given.

use super::super::PictureError;
use super::{MEDIAN_DEPTH, MonocularError, MonocularSource, in_usual_unit};
use crate::config::HoldOut;
use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Pose};
use i2slam_odometry::{
    DepthPicture, FrameUpdate, FrontEnd, Intrinsics, OdometryError, Progress as OdometryProgress,
    Reconstruction, Stage,
};
use i2slam_storage::ScratchStore;
use std::sync::Arc;

/// Positions of pictures that a front end was given.
#[derive(Default)]
pub(crate) struct GivenPictures {
    /// Position in the sequence of every picture that was accepted.
    pub(super) positions: Vec<usize>,
    /// Others: position, reason.
    pub(crate) refused: Vec<(usize, PictureError)>,
    /// Keyframes among the accepted ones.
    pub(crate) keyframes: usize,
}

impl GivenPictures {
    /// Gives the picture of every position to `push`, which tells whether it became a keyframe, until
    /// `progress` is cancelled.
    pub(crate) fn give(
        count: usize,
        progress: &OdometryProgress,
        mut push: impl FnMut(usize) -> Result<bool, PictureError>,
    ) -> Self {
        let mut given = Self::default();
        for position in (0..count).take_while(|_| !progress.is_cancelled()) {
            given.add(position, push(position));
            let stage = Stage::Tracking { keyframes: given.keyframes };
            progress.report(stage, position + 1, count);
        }
        given
    }

    /// Adds a position, and whether its picture became a keyframe or why it was refused.
    pub(crate) fn add(&mut self, position: usize, pushed: Result<bool, PictureError>) {
        match pushed {
            Ok(is_keyframe) => {
                self.positions.push(position);
                self.keyframes += usize::from(is_keyframe);
            }
            Err(why) => self.refused.push((position, why)),
        }
    }
}

/// Visual odometry that has tracked pictures, and finds their path when there are no more.
pub(crate) struct TrackedPictures {
    front_end: FrontEnd,
    hold_out: HoldOut,
    pub(crate) given: GivenPictures,
}

impl TrackedPictures {
    /// None so far.
    pub(crate) fn new(intrinsics: Intrinsics, hold_out: HoldOut) -> Self {
        Self { front_end: FrontEnd::new(intrinsics), hold_out, given: GivenPictures::default() }
    }

    /// Bounds the memory of pictures of past frames.
    #[must_use]
    pub(crate) fn with_scratch(self, scratch: Arc<ScratchStore>) -> Self {
        Self { front_end: self.front_end.with_scratch(scratch), ..self }
    }

    /// Camera with which the last poses were found.
    pub(crate) fn camera(&self) -> Camera<f64> {
        self.front_end.camera()
    }

    /// Tracks `count` pictures, until `progress` is cancelled: `load` reads the one at a position,
    /// `on_tracked` sees what the front end makes of it.
    #[must_use]
    pub(crate) fn track(
        mut self,
        count: usize,
        mut load: impl FnMut(usize) -> Result<Frame, PictureError>,
        progress: &OdometryProgress,
        mut on_tracked: impl FnMut(&FrontEnd, &FrameUpdate, &Frame),
    ) -> Self {
        let given = GivenPictures::give(count, progress, |position| {
            let picture = load(position)?;
            let update = self.track_next(&picture)?;
            on_tracked(&self.front_end, &update, &picture);
            Ok(update.is_keyframe)
        });
        Self { given, ..self }
    }

    /// Tracks the picture at a position. One that does not fit is refused.
    pub(crate) fn push(
        &mut self,
        position: usize,
        picture: &Frame,
        on_tracked: impl FnOnce(&FrontEnd, &FrameUpdate),
    ) {
        let tracked = self.track_next(picture);
        if let Ok(update) = &tracked {
            on_tracked(&self.front_end, update);
        }
        self.given.add(position, tracked.map(|update| update.is_keyframe));
    }

    fn track_next(&mut self, picture: &Frame) -> Result<FrameUpdate, PictureError> {
        let depth = depth_picture(picture);
        let (colour, timestamp) = (&picture.colour, picture.timestamp);
        let update = match self.hold_out.is_held_out(picture.index) {
            true => self.front_end.push_held_out(colour, timestamp, depth.as_ref())?,
            false => self.front_end.push(colour, timestamp, depth.as_ref())?,
        };
        self.hold_out.decide(picture.index);
        Ok(update)
    }

    /// Finds the path of all pictures, that of a film so far once `progress` is cancelled; `load` reads those of
    /// keyframes again, in order.
    pub(crate) fn finish<L>(
        self,
        load: L,
        progress: &OdometryProgress,
    ) -> Result<MonocularSource<L>, MonocularError>
    where
        L: FnMut(usize) -> Result<Frame, PictureError>,
    {
        let so_far = self.path_so_far();
        let (given, found) = self.find_path(&[], progress);
        let found = match (found, so_far) {
            (Err(OdometryError::Cancelled), Some(so_far)) => Ok(so_far),
            (found, _) => found.map(in_usual_unit),
        };
        source(found, given, load)
    }

    /// The path so far of a film, from its first pose on, in metres or half the median depth of that
    /// frame. Poses of photographs, which are registered after the last one, are not known before
    /// without depth.
    fn path_so_far(&self) -> Option<Reconstruction> {
        let found = self.front_end.path_so_far(None);
        let is_metric = found.depth_model.is_some();
        if self.front_end.is_unordered() && !is_metric {
            return None;
        }
        let first = found.poses.iter().position(Option::is_some)?;
        let scale = match is_metric {
            true => 1.0,
            false => MEDIAN_DEPTH / self.front_end.path_so_far(Some(first)).median_depth()?,
        };
        let mut found = found.scaled(scale);
        let world = found.poses[first]?.inverse();
        found.transform(&world);
        Some(found)
    }

    /// Finds the path of all pictures from approximate `poses` by position, if there are any; `load` reads
    /// those of keyframes again, in order.
    pub(crate) fn finish_near<L>(
        self,
        poses: &[Pose<f64>],
        load: L,
        progress: &OdometryProgress,
    ) -> Result<MonocularSource<L>, MonocularError>
    where
        L: FnMut(usize) -> Result<Frame, PictureError>,
    {
        let (given, found) = self.find_path(poses, progress);
        source(found.map(in_usual_unit), given, load)
    }

    fn find_path(
        self,
        poses: &[Pose<f64>],
        progress: &OdometryProgress,
    ) -> (GivenPictures, Result<Reconstruction, OdometryError>) {
        let Self { front_end, given, .. } = self;
        if progress.is_cancelled() {
            return (given, Err(OdometryError::Cancelled));
        }
        let of_accepted = given.positions.iter().map(|place| poses.get(*place).copied());
        let poses: Vec<_> = if poses.is_empty() { Vec::new() } else { of_accepted.collect() };
        let found = front_end.finish_near(&poses, progress.clone());
        (given, found)
    }
}

/// Keyframes of a path through pictures that were given to the front end.
fn source<L: FnMut(usize) -> Result<Frame, PictureError>>(
    found: Result<Reconstruction, OdometryError>,
    given: GivenPictures,
    load: L,
) -> Result<MonocularSource<L>, MonocularError> {
    match found {
        Ok(path) => Ok(MonocularSource::of_path(path, given, load)),
        Err(failure) => Err(MonocularError::NoPath { failure, refused: given.refused }),
    }
}

/// Measured depth of a frame, if there is any.
fn depth_picture(frame: &Frame) -> Option<DepthPicture<'_>> {
    let measured = frame.depth.as_ref()?;
    Some(DepthPicture { depth: &measured.image, timestamp: measured.timestamp })
}

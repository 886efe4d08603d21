//! Keyframes posed by the monocular front end, from pictures alone.

mod tracked_pictures;

use super::delivery::{
    MEDIAN_DEPTH, depth, into_estimated, keyframe_pictures, measured_depth, posed, posed_view,
};
use super::{KeyframeSource, PictureError, PosedKeyframe};
use crate::config::HoldOut;
use i2slam_compute::CancellationToken;
use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Pose, StampedPose, Tangent, Vec3};
use i2slam_odometry::{
    DenseDepthEstimator, KeyframePictures, MAX_KEYFRAME_DISTANCE, MAX_PHOTOGRAPH_DISTANCE,
    MIN_POSED_SHARE, PoseDeviation, Reconstruction, align_path, photograph_motions,
};
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use thiserror::Error;

pub(crate) use tracked_pictures::{GivenPictures, TrackedPictures};

pub use i2slam_odometry::{
    Intrinsics, OdometryError, Progress as OdometryProgress,
    Reconstruction as OdometryReconstruction, Stage, Warning as OdometryWarning,
};

/// Failure to find the camera path.
#[derive(Debug, Error)]
pub enum MonocularError {
    /// No camera path was found.
    #[error("{failure}{}", first_refusal(.refused))]
    NoPath {
        /// Reason.
        failure: OdometryError,
        /// Unusable pictures: position in the sequence, reason.
        refused: Vec<(usize, PictureError)>,
    },
}

fn first_refusal(refused: &[(usize, PictureError)]) -> String {
    refused.first().map_or_else(String::new, |(index, why)| {
        format!(" ({} pictures could not be used, the first, {index}: {why})", refused.len())
    })
}

/// Keyframes of pictures, posed by [`FrontEnd`], in metres where depth was measured; else half the median
/// landmark depth is the unit of length.
pub struct MonocularSource<L> {
    reconstruction: Reconstruction,
    dense: Option<DenseDepthEstimator>,
    reader: PictureReader<L>,
    /// Position in the sequence of every picture that the front end accepted.
    positions: Vec<usize>,
    refused: Vec<(usize, PictureError)>,
    /// Motions of photographs during their exposures, where these were asked for.
    motions: Vec<Option<Tangent<f64>>>,
    /// Numbers of the keyframes that are still to be delivered.
    coming: VecDeque<usize>,
    between: FramesBetween,
}

/// Reads the picture at a position in the sequence.
pub(crate) type BoxedLoader = Box<dyn FnMut(usize) -> Result<Frame, PictureError> + Send>;

/// Posed frames between keyframes that are still to be delivered, and what reads their pictures.
#[derive(Default)]
struct FramesBetween {
    frames: VecDeque<usize>,
    /// Those of them that are delivered as keyframes.
    fitted: BTreeSet<usize>,
    load: Option<BoxedLoader>,
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> MonocularSource<L> {
    /// Finds the camera path through `count` pictures. `load` reads the picture at a position: all in
    /// order, then those of the keyframes again in order. `progress` reports and may cancel.
    ///
    /// # Errors
    ///
    /// Why no path was found; [`OdometryError::Cancelled`] where `progress` ended it. Pictures that cannot
    /// be read are [left out](Self::refused).
    pub fn find(
        intrinsics: Intrinsics,
        count: usize,
        load: L,
        progress: &OdometryProgress,
    ) -> Result<Self, MonocularError> {
        Self::find_near((intrinsics, &[]), count, load, progress)
    }

    /// Finds the camera path as [`find`](Self::find) does, from approximate `poses` of all positions, if there
    /// are any.
    ///
    /// # Errors
    ///
    /// As [`find`](Self::find).
    pub fn find_near(
        (intrinsics, poses): (Intrinsics, &[Pose<f64>]),
        count: usize,
        mut load: L,
        progress: &OdometryProgress,
    ) -> Result<Self, MonocularError> {
        TrackedPictures::new(intrinsics, HoldOut::default())
            .track(count, &mut load, progress, |_, _, _| {})
            .finish_near(poses, load, progress)
    }

    /// Keyframes of a path through pictures that were given to the front end.
    pub(crate) fn of_path(reconstruction: Reconstruction, given: GivenPictures, load: L) -> Self {
        let GivenPictures { positions, refused, .. } = given;
        let positions_of_keyframes = keyframe_positions(&reconstruction, &positions);
        let reader = PictureReader::new(positions_of_keyframes, load, reconstruction.is_unordered);
        let coming = (0..reconstruction.keyframes.len()).collect();
        let (dense, motions, between) = (None, Vec::new(), FramesBetween::default());
        Self { reconstruction, dense, reader, positions, refused, motions, coming, between }
    }

    /// Replaces the pictures by those of another size [px] without lens distortion, as camera and
    /// landmarks are. The front end gains from larger pictures than mapping uses.
    #[must_use]
    pub fn with_pictures<R>(self, (width, height): (usize, usize), load: R) -> MonocularSource<R>
    where
        R: FnMut(usize) -> Result<Frame, PictureError>,
    {
        let Self { reconstruction, dense, positions, refused, motions, coming, between, .. } = self;
        let reconstruction = reconstruction.resized(width, height);
        let positions_of_keyframes = keyframe_positions(&reconstruction, &positions);
        let reader = PictureReader::new(positions_of_keyframes, load, reconstruction.is_unordered);
        MonocularSource {
            reconstruction,
            dense,
            reader,
            positions,
            refused,
            motions,
            coming,
            between,
        }
    }

    /// Moves the path as a whole as near as possible to given poses by position, in their unit of length, with
    /// measured depth in metres. `None` where fewer than [`MIN_POSED_SHARE`] of them are found.
    pub(crate) fn near(mut self, given: &[Pose<f64>]) -> Option<Self> {
        let found = self.reconstruction;
        let pair =
            |(place, pose): (&usize, &Option<Pose<f64>>)| Some(((*pose)?, *given.get(*place)?));
        let pairs: Vec<_> = self.positions.iter().zip(&found.poses).filter_map(pair).collect();
        if (pairs.len() as f64) < MIN_POSED_SHARE * given.len() as f64 {
            return None;
        }
        let by = align_path(&pairs)?;
        let scale = if found.depth_model.is_some() { 1.0 } else { by.scale };
        let sum = pairs.iter().fold(Vec3::zero(), |sum, (pose, _)| sum + pose.translation);
        let middle = sum * (pairs.len() as f64).recip();
        let shift = by.apply(middle) - by.rotation.rotate(middle) * scale;
        self.reconstruction = found.scaled(scale);
        self.reconstruction.transform(&Pose::new(by.rotation, shift));
        Some(self)
    }

    /// Delivers dense depth instead of landmarks alone, until `cancellation` is cancelled.
    #[must_use]
    pub fn with_dense_depth(mut self, cancellation: CancellationToken) -> Self {
        let views = self.reconstruction.keyframes.iter().map(posed_view).collect();
        let dense = DenseDepthEstimator::new(self.reconstruction.camera, views)
            .with_depth_model(self.reconstruction.depth_model.clone())
            .with_cancellation(cancellation);
        self.dense = Some(match self.reconstruction.is_unordered {
            true => dense.with_any_order(),
            false => dense,
        });
        self
    }

    /// Estimates depth of the first photographs, as many as confirm that of the first one at most, so that each
    /// takes about as long as another when they are delivered. `on_estimated` is told how many are done, and
    /// whether to go on.
    #[must_use]
    pub(crate) fn with_depth_prepared(
        mut self,
        on_estimated: impl Fn(usize, usize) -> bool,
    ) -> Self {
        let Self { reconstruction: found, reader, dense, .. } = &mut self;
        let Some(dense) = dense.as_mut().filter(|_| found.is_unordered) else { return self };
        let count = found.keyframes.len().min(MAX_PHOTOGRAPH_DISTANCE + 1);
        for number in 0..count {
            if !on_estimated(number, count) {
                break;
            }
            dense.prepare(number, &mut |k| pictures_of(found, reader, k));
        }
        self
    }

    /// Delivers photographs with their motions during the exposure. Frames of a film are delivered without:
    /// their motion is predicted from the frames around them.
    #[must_use]
    pub fn with_photograph_motions(mut self, cancellation: &CancellationToken) -> Self {
        let Self { reconstruction: found, reader, motions, .. } = &mut self;
        if found.is_unordered {
            let mut load = |number: usize| Some(reader.read_apart(number)?.colour);
            *motions = photograph_motions(&found.camera, &found.keyframes, &mut load, cancellation);
        }
        self
    }

    /// Delivers the posed frames between keyframes, too, each with its own measured depth averaged
    /// with that of keyframes; `load` reads the picture at a position, apart from keyframes.
    #[must_use]
    pub fn with_frames_between<R>(mut self, load: R) -> Self
    where
        R: FnMut(usize) -> Result<Frame, PictureError> + Send + 'static,
    {
        self.between.frames = self.frames_between().collect();
        self.between.load = Some(Box::new(load));
        self
    }

    /// Delivers frames of a film between keyframes as keyframes, too, until there are `most`, those alone whose
    /// position `is_usable`. With measured depth they are among the [frames between](Self::with_frames_between);
    /// by colour alone they have dense depth as all keyframes. To be called before others are asked for.
    #[must_use]
    pub(crate) fn with_fitted_frames(
        mut self,
        most: usize,
        is_usable: impl Fn(usize) -> bool,
    ) -> Self {
        let is_usable = |frame: usize| self.positions.get(frame).is_some_and(|at| is_usable(*at));
        let fitted = self.reconstruction.frames_between_keyframes(most, is_usable);
        if self.reconstruction.depth_model.is_some() {
            self.between.fitted = fitted;
        } else {
            self.reconstruction = self.reconstruction.with_keyframes(&fitted);
            self.reader.positions = keyframe_positions(&self.reconstruction, &self.positions);
            self.coming = (0..self.reconstruction.keyframes.len()).collect();
        }
        self
    }

    /// Leaves out frames of the [reconstruction](Self::reconstruction) that a map has already.
    #[must_use]
    pub(crate) fn without_frames(mut self, frames: &BTreeSet<usize>) -> Self {
        let keyframes = &self.reconstruction.keyframes;
        self.coming.retain(|number| !frames.contains(&keyframes[*number].index));
        self.between.frames.retain(|frame| !frames.contains(frame));
        self
    }

    /// Number of frames that are still to be delivered.
    pub fn remaining(&self) -> usize {
        self.coming.len() + self.between.frames.len()
    }

    /// Posed frames of the reconstruction that are no keyframes, in order.
    fn frames_between(&self) -> impl Iterator<Item = usize> {
        let found = &self.reconstruction;
        let is_keyframe = |frame: usize| found.keyframes.iter().any(|k| k.index == frame);
        (0..found.poses.len()).filter(move |f| found.poses[*f].is_some() && !is_keyframe(*f))
    }

    /// Posed frames that are not delivered as keyframes, in order, without depth, from the pictures of `load`.
    pub fn non_keyframes<R: FnMut(usize) -> Result<Frame, PictureError>>(
        &self,
        mut load: R,
    ) -> impl ExactSizeIterator<Item = Result<PosedKeyframe, PictureError>> + use<L, R> {
        let found = &self.reconstruction;
        let frames: Vec<(usize, Pose<f64>)> = self
            .frames_between()
            .filter(|frame| !self.between.fitted.contains(frame))
            .filter_map(|frame| Some((*self.positions.get(frame)?, found.poses[frame]?)))
            .collect();
        frames.into_iter().map(move |(position, world_from_camera)| {
            Ok(PosedKeyframe::from_frame(load(position)?, world_from_camera))
        })
    }

    /// All posed frames in order: position, time stamp [s], pose.
    pub fn trajectory(&self) -> Vec<(usize, f64, Pose<f64>)> {
        let found = &self.reconstruction;
        let posed = |frame: usize| {
            let (position, stamp) = (*self.positions.get(frame)?, *found.timestamps.get(frame)?);
            Some((position, stamp, found.poses[frame]?))
        };
        (0..found.poses.len()).filter_map(posed).collect()
    }

    /// Poses as they were known when their frames came, seen from the first of them.
    pub fn online_trajectory(&self) -> Vec<StampedPose> {
        let mut path = self.reconstruction.online_trajectory();
        let Some(world) = path.first().map(|first| first.world_from_camera.inverse()) else {
            return path;
        };
        path.iter_mut().for_each(|p| p.world_from_camera = world * p.world_from_camera);
        path
    }

    /// Deviations of poses, by position in the sequence.
    pub fn deviations(&self) -> impl Iterator<Item = (usize, PoseDeviation)> {
        let deviations = self.positions.iter().zip(&self.reconstruction.deviations);
        deviations.filter_map(|(place, deviation)| Some((*place, (*deviation)?)))
    }

    /// The reconstruction of the front end.
    pub fn reconstruction(&self) -> &Reconstruction {
        &self.reconstruction
    }

    /// Position in the sequence of a frame of the [reconstruction](Self::reconstruction).
    pub fn position(&self, frame: usize) -> Option<usize> {
        self.positions.get(frame).copied()
    }

    /// Unusable pictures: position in the sequence, reason.
    pub fn refused(&self) -> &[(usize, PictureError)] {
        &self.refused
    }
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> KeyframeSource for MonocularSource<L> {
    fn is_unordered(&self) -> bool {
        self.reconstruction.is_unordered
    }

    fn camera(&self) -> &Camera<f64> {
        &self.reconstruction.camera
    }

    fn readout(&self) -> f64 {
        self.reconstruction.rolling_shutter_readout
    }

    fn next_keyframe(&mut self) -> Option<Result<PosedKeyframe, PictureError>> {
        let keyframes = &self.reconstruction.keyframes;
        let coming = self.coming.front().map(|number| keyframes[*number].index);
        let between = self.between.frames.front();
        match between.is_some_and(|frame| coming.is_none_or(|index| *frame < index)) {
            true => self.between.frames.pop_front().map(|frame| self.frame_between(frame)),
            false => self.keyframe(),
        }
    }
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> MonocularSource<L> {
    /// The next keyframe.
    fn keyframe(&mut self) -> Option<Result<PosedKeyframe, PictureError>> {
        let (number, found) = (self.coming.pop_front()?, &self.reconstruction);
        let keyframe = &found.keyframes[number];
        let frame = match self.reader.next(number) {
            Ok(picture) => picture,
            Err(why) => return Some(Err(why)),
        };
        let dense = self.dense.as_mut().and_then(|dense| {
            dense.estimate(number, &mut |k| pictures_of(found, &mut self.reader, k))
        });
        let size = (frame.colour.width, frame.colour.height);
        let depth = Some(depth(dense, keyframe, size));
        let exposure_motion = self.motions.get(number).copied().flatten();
        let posed = posed(found, keyframe.index, frame, keyframe.world_from_camera);
        Some(Ok(PosedKeyframe { depth, exposure_motion, ..posed }))
    }

    /// A frame between keyframes.
    fn frame_between(&mut self, index: usize) -> Result<PosedKeyframe, PictureError> {
        let found = &self.reconstruction;
        let place = self.positions.get(index).copied();
        let (Some(place), Some(load), Some(pose)) =
            (place, &mut self.between.load, found.poses[index])
        else {
            return Err("its pose is not known".into());
        };
        let frame = load(place)?;
        let measured = measured_depth(found, index, &frame);
        let next = found.keyframes.partition_point(|keyframe| keyframe.index < index);
        let near = next.min(found.keyframes.len().saturating_sub(1));
        let depth = self.dense.as_mut().zip(measured).and_then(|(dense, measured)| {
            let mut pictures = |k: usize| pictures_of(found, &mut self.reader, k);
            dense.fuse(pose, near, &measured, &mut pictures)
        });
        let depth = depth.map(into_estimated);
        // Gaussians are split by the depth of a keyframe.
        let is_keyframe = depth.is_some() && self.between.fitted.contains(&index);
        let posed = posed(found, index, frame, pose);
        Ok(PosedKeyframe { depth, is_keyframe, fills_depth: false, ..posed })
    }
}

/// Pictures of the keyframe with a number for its dense depth.
fn pictures_of<L: FnMut(usize) -> Result<Frame, PictureError>>(
    found: &Reconstruction,
    reader: &mut PictureReader<L>,
    number: usize,
) -> Option<KeyframePictures> {
    let (frame, keyframe) = (reader.picture(number)?, found.keyframes.get(number)?);
    Some(keyframe_pictures(found, keyframe, frame))
}

/// Lengths in metres where depth was measured, else with half the median landmark depth as unit.
pub(crate) fn in_usual_unit(path: Reconstruction) -> Reconstruction {
    match path.depth_model {
        Some(_) => path,
        None => path.scaled(MEDIAN_DEPTH),
    }
}

fn keyframe_positions(found: &Reconstruction, positions: &[usize]) -> Vec<usize> {
    found.keyframes.iter().filter_map(|keyframe| positions.get(keyframe.index).copied()).collect()
}

/// Keyframes whose pictures stay cached for later ones: the reach of dense depth, in a film and among
/// photographs.
const CACHED: usize = 2 * MAX_KEYFRAME_DISTANCE;
const CACHED_PHOTOGRAPHS: usize = 2 * MAX_PHOTOGRAPH_DISTANCE;

/// Reads the pictures of keyframes in order, once but for [`read_apart`](Self::read_apart): going back in a
/// video decodes it again.
pub(super) struct PictureReader<L> {
    load: L,
    /// Position of each keyframe in the sequence.
    positions: Vec<usize>,
    /// Number of keyframes that stay cached.
    cached: usize,
    /// Number of keyframes read or passed over so far.
    read: usize,
    pictures: BTreeMap<usize, Result<Frame, PictureError>>,
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> PictureReader<L> {
    /// A reader of the keyframes at `positions`, of a film or of photographs; `load` reads the picture at a
    /// position.
    pub(super) fn new(positions: Vec<usize>, load: L, is_unordered: bool) -> Self {
        let cached = if is_unordered { CACHED_PHOTOGRAPHS } else { CACHED };
        Self { load, positions, cached, read: 0, pictures: BTreeMap::new() }
    }

    /// The picture of a keyframe, if readable and still cached.
    pub(super) fn picture(&mut self, keyframe: usize) -> Option<&Frame> {
        self.read_up_to(keyframe);
        self.pictures.get(&keyframe)?.as_ref().ok()
    }

    /// The picture of the next keyframe; drops those out of reach from the cache.
    pub(super) fn next(&mut self, keyframe: usize) -> Result<Frame, PictureError> {
        self.read_up_to(keyframe);
        self.pictures.retain(|k, _| *k + self.cached >= keyframe);
        match self.pictures.get(&keyframe) {
            Some(Ok(picture)) => Ok(picture.clone()),
            _ => {
                self.pictures.remove(&keyframe).unwrap_or_else(|| Err("it was read before".into()))
            }
        }
    }

    /// The picture of a keyframe, if readable, apart from those that are read in order.
    pub(super) fn read_apart(&mut self, keyframe: usize) -> Option<Frame> {
        (self.load)(*self.positions.get(keyframe)?).ok()
    }

    fn read_up_to(&mut self, keyframe: usize) {
        // Those in between are out of reach, and many where most keyframes are not asked for.
        self.read = self.read.max(keyframe.saturating_sub(self.cached));
        while self.read <= keyframe && self.read < self.positions.len() {
            self.pictures.insert(self.read, (self.load)(self.positions[self.read]));
            self.read += 1;
        }
    }
}

#[cfg(test)]
pub(super) mod tests;

//! Keyframes posed by the monocular front end, from pictures alone.

use super::row_rectification::ReadoutMotion;
use super::{EstimatedDepth, KeyframeSource, PictureError, PosedKeyframe};
use i2slam_compute::CancellationToken;
use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Image, Pose, StampedPose};
use i2slam_odometry::{
    DenseDepth, DenseDepthEstimator, DepthPicture, FrontEnd, Keyframe, KeyframePictures,
    MeasuredDepth, PoseDeviation, PosedView, Reconstruction,
};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;
use thiserror::Error;

pub use i2slam_odometry::{
    Intrinsics, OdometryError, Progress as OdometryProgress,
    Reconstruction as OdometryReconstruction, Stage, Warning as OdometryWarning,
};

/// Median landmark depth in the delivered unit of length: that of a room in metres.
const DELIVERED_MEDIAN_DEPTH: f64 = 2.0;

/// Largest relative standard deviation of a delivered landmark depth.
const MAX_DEVIATION: f64 = 0.3;

/// Factor on delivered deviations: the few pixels with depth would outweigh the picture.
const SPARSE_DEVIATION_FACTOR: f64 = 10.0;

/// Least relative deviation of a delivered landmark depth: its own neglects errors of the poses.
const MIN_DEVIATION: f64 = 0.1;

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

/// Keyframes of pictures, posed by [`FrontEnd`]; the unit is half the median landmark depth.
pub struct MonocularSource<L> {
    reconstruction: Reconstruction,
    dense: Option<DenseDepthEstimator>,
    reader: PictureReader<L>,
    /// Position in the sequence of every picture that the front end accepted.
    positions: Vec<usize>,
    refused: Vec<(usize, PictureError)>,
    next: usize,
    between: FramesBetween,
}

/// Reads the picture at a position in the sequence.
type BoxedLoader = Box<dyn FnMut(usize) -> Result<Frame, PictureError> + Send>;

/// Posed frames between keyframes that are still to be delivered, and what reads their pictures.
#[derive(Default)]
struct FramesBetween {
    frames: VecDeque<usize>,
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
        mut load: L,
        progress: &OdometryProgress,
    ) -> Result<Self, MonocularError> {
        let mut front_end = FrontEnd::new(intrinsics);
        let (mut positions, mut refused, mut keyframes) = (Vec::new(), Vec::new(), 0);
        for position in 0..count {
            if progress.is_cancelled() {
                break;
            }
            let pushed = load(position).and_then(|picture| {
                let depth = depth_picture(&picture);
                front_end
                    .push(&picture.colour, picture.timestamp, depth.as_ref())
                    .map_err(PictureError::from)
            });
            match pushed {
                Ok(update) => {
                    positions.push(position);
                    keyframes += usize::from(update.is_keyframe);
                }
                Err(why) => refused.push((position, why)),
            }
            progress.report(Stage::Tracking { keyframes }, position + 1, count);
        }
        let found = match progress.is_cancelled() {
            true => Err(OdometryError::Cancelled),
            false => front_end.finish(progress.clone()),
        };
        match found {
            Ok(reconstruction) => {
                let reader =
                    PictureReader::new(keyframe_positions(&reconstruction, &positions), load);
                let (dense, next, between) = (None, 0, FramesBetween::default());
                Ok(Self { reconstruction, dense, reader, positions, refused, next, between })
            }
            Err(failure) => Err(MonocularError::NoPath { failure, refused }),
        }
    }

    /// Replaces the pictures by those of another size [px] without lens distortion, as camera and
    /// landmarks are. The front end gains from larger pictures than mapping uses.
    #[must_use]
    pub fn with_pictures<R>(self, (width, height): (usize, usize), load: R) -> MonocularSource<R>
    where
        R: FnMut(usize) -> Result<Frame, PictureError>,
    {
        let Self { reconstruction, dense, positions, refused, next, between, .. } = self;
        let reconstruction = reconstruction.resized(width, height);
        let reader = PictureReader::new(keyframe_positions(&reconstruction, &positions), load);
        MonocularSource { reconstruction, dense, reader, positions, refused, next, between }
    }

    /// Delivers dense depth instead of landmarks alone, until `cancellation` is cancelled.
    #[must_use]
    pub fn with_dense_depth(mut self, cancellation: CancellationToken) -> Self {
        let view = |keyframe: &Keyframe| PosedView {
            world_from_camera: keyframe.world_from_camera,
            landmarks: keyframe.depths.iter().map(|d| d.depth).collect(),
        };
        let views = self.reconstruction.keyframes.iter().map(view).collect();
        self.dense = Some(
            DenseDepthEstimator::new(self.reconstruction.camera, views)
                .with_depth_model(self.reconstruction.depth_model.clone())
                .with_cancellation(cancellation),
        );
        self
    }

    /// Delivers the posed frames between keyframes, too, each with its own measured depth averaged
    /// with that of keyframes; `load` reads the picture at a position, apart from keyframes.
    #[must_use]
    pub fn with_frames_between<R>(mut self, load: R) -> Self
    where
        R: FnMut(usize) -> Result<Frame, PictureError> + Send + 'static,
    {
        let frames = self.frames_between().collect();
        self.between = FramesBetween { frames, load: Some(Box::new(load)) };
        self
    }

    /// Number of frames that are still to be delivered.
    pub fn remaining(&self) -> usize {
        self.reconstruction.keyframes.len() - self.next + self.between.frames.len()
    }

    /// Posed frames of the reconstruction that are no keyframes, in order.
    fn frames_between(&self) -> impl Iterator<Item = usize> {
        let found = &self.reconstruction;
        let is_keyframe = |frame: usize| found.keyframes.iter().any(|k| k.index == frame);
        (0..found.poses.len()).filter(move |f| found.poses[*f].is_some() && !is_keyframe(*f))
    }

    /// Posed frames that are no keyframes, in order, without depth, from the pictures of `load`.
    pub fn non_keyframes<R: FnMut(usize) -> Result<Frame, PictureError>>(
        &self,
        mut load: R,
    ) -> impl ExactSizeIterator<Item = Result<PosedKeyframe, PictureError>> + use<L, R> {
        let found = &self.reconstruction;
        let frames: Vec<(usize, Pose<f64>)> = self
            .frames_between()
            .filter_map(|frame| Some((*self.positions.get(frame)?, pose_of(found, frame)?)))
            .collect();
        frames.into_iter().map(move |(position, world_from_camera)| {
            Ok(PosedKeyframe::from_frame(load(position)?, world_from_camera))
        })
    }

    /// All posed frames in order: position, time stamp [s], pose in the delivered unit.
    pub fn trajectory(&self) -> Vec<(usize, f64, Pose<f64>)> {
        let found = &self.reconstruction;
        let posed = |frame: usize| {
            let (position, stamp) = (*self.positions.get(frame)?, *found.timestamps.get(frame)?);
            Some((position, stamp, pose_of(found, frame)?))
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

    /// Deviations of poses: position in the sequence, deviation in the delivered unit.
    pub fn deviations(&self) -> impl Iterator<Item = (usize, PoseDeviation)> {
        let unit = unit(&self.reconstruction);
        self.positions.iter().zip(&self.reconstruction.deviations).filter_map(move |(place, d)| {
            let deviation = (*d)?;
            Some((*place, PoseDeviation { position: unit * deviation.position, ..deviation }))
        })
    }

    /// The reconstruction of the front end, in its own unit of length.
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
    fn camera(&self) -> &Camera<f64> {
        &self.reconstruction.camera
    }

    fn readout(&self) -> f64 {
        self.reconstruction.rolling_shutter_readout
    }

    fn next_keyframe(&mut self) -> Option<Result<PosedKeyframe, PictureError>> {
        let coming = self.reconstruction.keyframes.get(self.next).map(|keyframe| keyframe.index);
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
        let (number, found) = (self.next, &self.reconstruction);
        let keyframe = found.keyframes.get(number)?;
        self.next += 1;
        let frame = match self.reader.next(number) {
            Ok(picture) => picture,
            Err(why) => return Some(Err(why)),
        };
        let dense = self.dense.as_mut().and_then(|dense| {
            dense.estimate(number, &mut |k| keyframe_pictures(found, &mut self.reader, k))
        });
        let size = (frame.colour.width, frame.colour.height);
        let depth = Some(depth(dense, keyframe, size, unit(found)));
        let posed = posed(found, keyframe.index, frame, keyframe.world_from_camera);
        Some(Ok(PosedKeyframe { depth, ..posed }))
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
        let near = self.next.min(found.keyframes.len().saturating_sub(1));
        let depth = self.dense.as_mut().zip(measured).and_then(|(dense, measured)| {
            let mut pictures = |k: usize| keyframe_pictures(found, &mut self.reader, k);
            dense.fuse(pose, near, &measured, &mut pictures)
        });
        let depth = depth.map(|depth| dense_depth(depth, unit(found)));
        let posed = posed(found, index, frame, pose);
        Ok(PosedKeyframe { depth, is_keyframe: false, ..posed })
    }
}

/// A frame of the reconstruction with its neighbours, in the delivered unit of length.
fn posed(found: &Reconstruction, index: usize, frame: Frame, pose: Pose<f64>) -> PosedKeyframe {
    PosedKeyframe {
        timestamp: found.timestamps[index],
        before: index.checked_sub(1).and_then(|index| stamped(found, index)),
        after: stamped(found, index + 1),
        ..PosedKeyframe::from_frame(frame, scaled(pose, unit(found)))
    }
}

/// Pictures of a keyframe for its dense depth, all rows exposed with the middle one.
fn keyframe_pictures<L: FnMut(usize) -> Result<Frame, PictureError>>(
    found: &Reconstruction,
    reader: &mut PictureReader<L>,
    number: usize,
) -> Option<KeyframePictures> {
    let (frame, keyframe) = (reader.picture(number)?, found.keyframes.get(number)?);
    let colour = match ReadoutMotion::of_keyframe(found, keyframe) {
        Some(motion) => Arc::new(motion.rectified(&found.camera, &frame.colour)),
        None => Arc::clone(&frame.colour),
    };
    Some(KeyframePictures { colour, depth: measured_depth(found, keyframe.index, frame) })
}

/// Measured depth of a frame of the reconstruction.
fn measured_depth(found: &Reconstruction, index: usize, frame: &Frame) -> Option<MeasuredDepth> {
    frame.depth.as_ref().map(|measured| MeasuredDepth {
        depth: Arc::clone(&measured.image),
        depth_from_colour: found.depth_from_colour(index, measured.timestamp),
    })
}

/// Measured depth of a frame, if there is any.
fn depth_picture(frame: &Frame) -> Option<DepthPicture<'_>> {
    let measured = frame.depth.as_ref()?;
    Some(DepthPicture { depth: &measured.image, timestamp: measured.timestamp })
}

fn keyframe_positions(found: &Reconstruction, positions: &[usize]) -> Vec<usize> {
    found.keyframes.iter().filter_map(|keyframe| positions.get(keyframe.index).copied()).collect()
}

/// The front end's unit of length in the delivered one: metres stay.
fn unit(found: &Reconstruction) -> f64 {
    if found.depth_model.is_some() { 1.0 } else { DELIVERED_MEDIAN_DEPTH }
}

/// A pose in the delivered unit of length.
fn scaled(pose: Pose<f64>, unit: f64) -> Pose<f64> {
    Pose { translation: pose.translation * unit, ..pose }
}

/// Pose of a frame in the delivered unit; `None` if lost.
fn pose_of(found: &Reconstruction, frame: usize) -> Option<Pose<f64>> {
    found.poses.get(frame)?.map(|pose| scaled(pose, unit(found)))
}

/// Time stamp and pose of a frame.
fn stamped(found: &Reconstruction, frame: usize) -> Option<(f64, Pose<f64>)> {
    Some((*found.timestamps.get(frame)?, pose_of(found, frame)?))
}

/// Dense depth of a keyframe, or landmarks completed by it where it covers at most half the picture.
fn depth(
    dense: Option<DenseDepth>,
    keyframe: &Keyframe,
    (width, height): (usize, usize),
    unit: f64,
) -> EstimatedDepth {
    let mut out = sparse_depth(keyframe, (width, height), unit);
    let Some(dense) = dense.map(|dense| dense_depth(dense, unit)) else { return out };
    if 2 * dense.depth.data.iter().filter(|z| **z > 0.0).count() > width * height {
        return dense;
    }
    for (pixel, z) in dense.depth.data.iter().enumerate().filter(|(_, z)| **z > 0.0) {
        out.depth.data[pixel] = *z;
        if let (Some(to), Some(from)) = (&mut out.variance, &dense.variance) {
            to.data[pixel] = from.data[pixel];
        }
    }
    out
}

/// Dense depth in the delivered unit of length.
fn dense_depth(found: DenseDepth, unit: f64) -> EstimatedDepth {
    let DenseDepth { mut depth, mut variance } = found;
    let scale = unit as f32;
    depth.data.iter_mut().for_each(|d| *d *= scale);
    variance.data.iter_mut().for_each(|v| *v *= scale * scale);
    EstimatedDepth { depth, variance: Some(variance) }
}

/// Landmark depths of a keyframe as images, zero elsewhere; the nearest landmark per pixel.
fn sparse_depth(keyframe: &Keyframe, (width, height): (usize, usize), unit: f64) -> EstimatedDepth {
    let (mut depth, mut variance) = (Image::new(width, height, 1), Image::new(width, height, 1));
    for point in &keyframe.depths {
        let [u, v] = point.at;
        let inside = u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
        if inside && point.variance.sqrt() <= MAX_DEVIATION * point.depth {
            let pixel = v as usize * width + u as usize;
            let (here, known) = ((unit * point.depth) as f32, depth.data[pixel]);
            if known > 0.0 && known <= here {
                continue;
            }
            depth.data[pixel] = here;
            let deviation = point.variance.sqrt().hypot(MIN_DEVIATION * point.depth);
            variance.data[pixel] = (SPARSE_DEVIATION_FACTOR * unit * deviation).powi(2) as f32;
        }
    }
    EstimatedDepth { depth, variance: Some(variance) }
}

/// Keyframes whose pictures stay cached for later ones: the reach of dense depth.
const CACHED: usize = 16;

/// Reads the pictures of keyframes once and in order: going back in a video decodes it again.
pub(super) struct PictureReader<L> {
    load: L,
    /// Position of each keyframe in the sequence.
    positions: Vec<usize>,
    /// Number of keyframes read so far.
    read: usize,
    pictures: BTreeMap<usize, Result<Frame, PictureError>>,
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> PictureReader<L> {
    /// A reader of the keyframes at `positions`; `load` reads the picture at a position.
    pub(super) fn new(positions: Vec<usize>, load: L) -> Self {
        Self { load, positions, read: 0, pictures: BTreeMap::new() }
    }

    /// The picture of a keyframe, if readable and still cached.
    pub(super) fn picture(&mut self, keyframe: usize) -> Option<&Frame> {
        self.read_up_to(keyframe);
        self.pictures.get(&keyframe)?.as_ref().ok()
    }

    /// The picture of the next keyframe; drops those out of reach from the cache.
    pub(super) fn next(&mut self, keyframe: usize) -> Result<Frame, PictureError> {
        self.read_up_to(keyframe);
        self.pictures.retain(|k, _| *k + CACHED >= keyframe);
        match self.pictures.get(&keyframe) {
            Some(Ok(picture)) => Ok(picture.clone()),
            _ => {
                self.pictures.remove(&keyframe).unwrap_or_else(|| Err("it was read before".into()))
            }
        }
    }

    fn read_up_to(&mut self, keyframe: usize) {
        while self.read <= keyframe && self.read < self.positions.len() {
            self.pictures.insert(self.read, (self.load)(self.positions[self.read]));
            self.read += 1;
        }
    }
}

#[cfg(test)]
pub(super) mod tests;

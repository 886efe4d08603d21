//! Keyframes posed by the monocular front end, from pictures alone.

use super::row_rectification::ReadoutMotion;
use super::{EstimatedDepth, KeyframeSource, PictureError, PosedKeyframe};
use i2slam_compute::CancellationToken;
use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_odometry::{
    DenseDepth, DenseDepthEstimator, DepthPicture, FrontEnd, Keyframe, KeyframePictures,
    MeasuredDepth, PoseDeviation, PosedView, Reconstruction,
};
use std::collections::BTreeMap;
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
                Ok(report) => {
                    positions.push(position);
                    keyframes += usize::from(report.is_keyframe);
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
                Ok(Self { reconstruction, dense: None, reader, positions, refused, next: 0 })
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
        let Self { reconstruction, dense, positions, refused, next, .. } = self;
        let reconstruction = reconstruction.resized(width, height);
        let reader = PictureReader::new(keyframe_positions(&reconstruction, &positions), load);
        MonocularSource { reconstruction, dense, reader, positions, refused, next }
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

    /// Posed frames that are no keyframes, in order, without depth, from the pictures of `load`.
    pub fn non_keyframes<R: FnMut(usize) -> Result<Frame, PictureError>>(
        &self,
        mut load: R,
    ) -> impl ExactSizeIterator<Item = Result<PosedKeyframe, PictureError>> + use<L, R> {
        let found = &self.reconstruction;
        let is_keyframe = |frame: usize| found.keyframes.iter().any(|k| k.index == frame);
        let frames: Vec<(usize, Pose<f64>)> = (0..found.poses.len())
            .filter(|frame| !is_keyframe(*frame))
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
        let (number, found) = (self.next, &self.reconstruction);
        let keyframe = found.keyframes.get(number)?;
        self.next += 1;
        let Frame { index, colour, .. } = match self.reader.next(number) {
            Ok(picture) => picture,
            Err(why) => return Some(Err(why)),
        };
        let dense = self.dense.as_mut().and_then(|dense| {
            let mut picture = |k: usize| {
                let (frame, keyframe) = (self.reader.picture(k)?, found.keyframes.get(k)?);
                let colour = match ReadoutMotion::of_keyframe(found, keyframe) {
                    Some(motion) => Arc::new(motion.rectified(&found.camera, &frame.colour)),
                    None => Arc::clone(&frame.colour),
                };
                let depth = frame.depth.as_ref().map(|measured| MeasuredDepth {
                    depth: Arc::clone(&measured.image),
                    depth_from_colour: found.depth_from_colour(keyframe.index, measured.timestamp),
                });
                Some(KeyframePictures { colour, depth })
            };
            dense.estimate(number, &mut picture)
        });
        Some(Ok(PosedKeyframe {
            index,
            timestamp: keyframe.timestamp,
            before: keyframe.index.checked_sub(1).and_then(|index| stamped(found, index)),
            after: stamped(found, keyframe.index + 1),
            depth: Some(depth(dense, keyframe, (colour.width, colour.height), unit(found))),
            colour,
            world_from_camera: scaled(keyframe.world_from_camera, unit(found)),
        }))
    }
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

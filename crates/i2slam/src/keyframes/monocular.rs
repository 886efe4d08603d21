//! Keyframes that our own monocular front end finds poses for, from the pictures alone.

use super::picture_reader::Reader;
use super::row_rectification::RowMotion;
use super::{EstimatedDepth, KeyframeSource, PictureError, PosedKeyframe};
use i2slam_compute::CancellationToken;
use i2slam_dataset::Frame;
use i2slam_geometry::{Camera, Image, Pose};
use i2slam_odometry::{
    DenseDepth, DenseDepthEstimator, FrameStatus, FrontEnd, Keyframe, PosedView, Reconstruction,
};
use std::sync::Arc;
use thiserror::Error;

pub use i2slam_odometry::{
    Intrinsics, OdometryError, Progress as OdometryProgress,
    Reconstruction as OdometryReconstruction, Stage, Warning as OdometryWarning,
};

/// Median depth of the landmarks in the unit of length that is delivered: about that of a room in
/// metres, for which the settings of maps are made.
const MEDIAN_DEPTH: f64 = 2.0;

/// A depth counts if its standard deviation is at most this share of it.
const TRUSTED: f64 = 0.3;

/// Factor of the deviations that are delivered: the depth loss is a mean over the few pixels that
/// have a depth, which would outweigh the picture.
const SPARSE: f64 = 10.0;

/// Least standard deviation of a depth as a share of it: that of the landmarks leaves the poses
/// out, and a pixel shows more than a point.
const MIN_DEVIATION: f64 = 0.1;

/// Why there are no keyframes.
#[derive(Debug, Error)]
pub enum MonocularError {
    /// No path of the camera was found.
    #[error("{failure}{}", first_refusal(.refused))]
    NoPath {
        /// Why.
        failure: OdometryError,
        /// Pictures that could not be used: place in the sequence, reason.
        refused: Vec<(usize, PictureError)>,
    },
}

fn first_refusal(refused: &[(usize, PictureError)]) -> String {
    refused.first().map_or_else(String::new, |(index, why)| {
        format!(" ({} pictures could not be used, the first, {index}: {why})", refused.len())
    })
}

/// Keyframes of a sequence of pictures, posed by [`FrontEnd`]; the unit of length is arbitrary,
/// half the median depth of the landmarks.
pub struct MonocularSource<L> {
    reconstruction: Reconstruction,
    dense: Option<DenseDepthEstimator>,
    reader: Reader<L>,
    /// Place in the sequence of every picture that the front end accepted.
    places: Vec<usize>,
    refused: Vec<(usize, PictureError)>,
    next: usize,
}

impl<L: FnMut(usize) -> Result<Frame, PictureError>> MonocularSource<L> {
    /// Looks for the path of the camera through `count` pictures. `load` gives the picture at a
    /// place; it is asked for all of them in order, and then for those of the keyframes again, in
    /// order. `progress` is told how far it is, and may end it.
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
        let (mut places, mut refused, mut keyframes) = (Vec::new(), Vec::new(), 0);
        for place in 0..count {
            if progress.is_cancelled() {
                break;
            }
            let pushed = load(place).and_then(|picture| {
                front_end.push(&picture.colour, picture.timestamp).map_err(PictureError::from)
            });
            match pushed {
                Ok(report) => {
                    places.push(place);
                    keyframes += usize::from(report.is_keyframe);
                }
                Err(why) => refused.push((place, why)),
            }
            progress.report(Stage::Tracking { keyframes }, place + 1, count);
        }
        let found = match progress.is_cancelled() {
            true => Err(OdometryError::Cancelled),
            false => front_end.finish_with_progress(progress.clone()),
        };
        match found {
            Ok(reconstruction) => {
                let reader = Reader::new(places_of(&reconstruction, &places), load);
                Ok(Self { reconstruction, dense: None, reader, places, refused, next: 0 })
            }
            Err(failure) => Err(MonocularError::NoPath { failure, refused }),
        }
    }

    /// The same with other pictures of the same places, of `size` [px]: the front end gains by
    /// larger ones than a map is made of. Of a lens that was found, those that are freed of it, as
    /// the camera and the landmarks are.
    #[must_use]
    pub fn with_pictures<R>(self, (width, height): (usize, usize), load: R) -> MonocularSource<R>
    where
        R: FnMut(usize) -> Result<Frame, PictureError>,
    {
        let Self { reconstruction, dense, places, refused, next, .. } = self;
        let reconstruction = reconstruction.resized(width, height);
        let reader = Reader::new(places_of(&reconstruction, &places), load);
        MonocularSource { reconstruction, dense, reader, places, refused, next }
    }

    /// The same with the depth of most pixels of a keyframe, in place of that of its landmarks
    /// alone, until `cancellation` is cancelled.
    #[must_use]
    pub fn with_dense_depth(mut self, cancellation: CancellationToken) -> Self {
        let view = |keyframe: &Keyframe| PosedView {
            world_from_camera: keyframe.world_from_camera,
            landmarks: keyframe.depths.iter().map(|d| d.depth).collect(),
        };
        let views = self.reconstruction.keyframes.iter().map(view).collect();
        self.dense = Some(
            DenseDepthEstimator::new(self.reconstruction.camera, views)
                .with_cancellation(cancellation),
        );
        self
    }

    /// The frames that have a pose and are no keyframes, in order, without depth; `load` gives the
    /// picture at a place.
    pub fn between<R: FnMut(usize) -> Result<Frame, PictureError>>(
        &self,
        mut load: R,
    ) -> impl ExactSizeIterator<Item = Result<PosedKeyframe, PictureError>> + use<L, R> {
        let found = &self.reconstruction;
        let is_keyframe = |frame: usize| found.keyframes.iter().any(|k| k.index == frame);
        let frames: Vec<(usize, Pose<f64>)> = (0..found.frames.len())
            .filter(|frame| !is_keyframe(*frame))
            .filter_map(|frame| Some((*self.places.get(frame)?, pose_of(found, frame)?)))
            .collect();
        frames.into_iter().map(move |(place, world_from_camera)| {
            Ok(PosedKeyframe::from_frame(load(place)?, world_from_camera))
        })
    }

    /// The frames that have a pose, in order, without their pictures: place in the sequence, stamp
    /// [s], pose as it is delivered with keyframes.
    pub fn path(&self) -> Vec<(usize, f64, Pose<f64>)> {
        let found = &self.reconstruction;
        let posed = |frame: usize| {
            let (place, stamp) = (*self.places.get(frame)?, *found.timestamps.get(frame)?);
            Some((place, stamp, pose_of(found, frame)?))
        };
        (0..found.frames.len()).filter_map(posed).collect()
    }

    /// The whole path, and what there is to warn of.
    pub fn reconstruction(&self) -> &Reconstruction {
        &self.reconstruction
    }

    /// Where in the sequence a frame of the [reconstruction](Self::reconstruction) is.
    pub fn place(&self, frame: usize) -> Option<usize> {
        self.places.get(frame).copied()
    }

    /// Pictures that could not be used: place in the sequence, reason.
    pub fn refused(&self) -> &[(usize, PictureError)] {
        &self.refused
    }

    /// Number of keyframes, taken or not.
    pub fn len(&self) -> usize {
        self.reconstruction.keyframes.len()
    }

    /// Whether there is no keyframe.
    pub fn is_empty(&self) -> bool {
        self.reconstruction.keyframes.is_empty()
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
                let colour = &self.reader.picture(k)?.colour;
                Some(match RowMotion::of(found, found.keyframes.get(k)?) {
                    Some(rows) => Arc::new(rows.undone(&found.camera, colour)),
                    None => Arc::clone(colour),
                })
            };
            dense.estimate(number, &mut picture)
        });
        Some(Ok(PosedKeyframe {
            index,
            timestamp: keyframe.timestamp,
            before: keyframe.index.checked_sub(1).and_then(|index| stamped(found, index)),
            after: stamped(found, keyframe.index + 1),
            depth: Some(depth(dense, keyframe, colour.width, colour.height)),
            colour,
            world_from_camera: scaled(keyframe.world_from_camera),
        }))
    }
}

/// Where in the sequence each keyframe is.
fn places_of(found: &Reconstruction, places: &[usize]) -> Vec<usize> {
    found.keyframes.iter().filter_map(|keyframe| places.get(keyframe.index).copied()).collect()
}

/// A pose in the unit of length that is delivered.
fn scaled(pose: Pose<f64>) -> Pose<f64> {
    Pose { translation: pose.translation * MEDIAN_DEPTH, ..pose }
}

/// The pose of a frame, if it has one.
fn pose_of(found: &Reconstruction, frame: usize) -> Option<Pose<f64>> {
    match found.frames.get(frame)? {
        FrameStatus::Posed { world_from_camera, .. } => Some(scaled(*world_from_camera)),
        FrameStatus::Lost => None,
    }
}

/// Stamp and pose of a frame.
fn stamped(found: &Reconstruction, frame: usize) -> Option<(f64, Pose<f64>)> {
    Some((*found.timestamps.get(frame)?, pose_of(found, frame)?))
}

/// What is known of a keyframe's depth: dense depth, with the landmarks where it is missing in more
/// than half the picture.
fn depth(
    dense: Option<DenseDepth>,
    keyframe: &Keyframe,
    width: usize,
    height: usize,
) -> EstimatedDepth {
    let mut out = sparse_depth(keyframe, width, height);
    let Some(dense) = dense.map(dense_depth) else { return out };
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

/// Dense depth in the unit of length that is delivered.
fn dense_depth(found: DenseDepth) -> EstimatedDepth {
    let DenseDepth { mut depth, mut variance } = found;
    let scale = MEDIAN_DEPTH as f32;
    depth.data.iter_mut().for_each(|d| *d *= scale);
    variance.data.iter_mut().for_each(|v| *v *= scale * scale);
    EstimatedDepth { depth, variance: Some(variance) }
}

/// The landmarks of a keyframe as images, zero between them; of several in one pixel the nearest,
/// which hides the others.
fn sparse_depth(keyframe: &Keyframe, width: usize, height: usize) -> EstimatedDepth {
    let (mut depth, mut variance) = (Image::new(width, height, 1), Image::new(width, height, 1));
    for point in &keyframe.depths {
        let [u, v] = point.at;
        let inside = u >= 0.0 && v >= 0.0 && u < width as f64 && v < height as f64;
        if inside && point.variance.sqrt() <= TRUSTED * point.depth {
            let pixel = v as usize * width + u as usize;
            let (here, known) = ((MEDIAN_DEPTH * point.depth) as f32, depth.data[pixel]);
            if known > 0.0 && known <= here {
                continue;
            }
            depth.data[pixel] = here;
            let deviation = point.variance.sqrt().hypot(MIN_DEVIATION * point.depth);
            variance.data[pixel] = (SPARSE * MEDIAN_DEPTH * deviation).powi(2) as f32;
        }
    }
    EstimatedDepth { depth, variance: Some(variance) }
}

#[cfg(test)]
pub(super) mod tests;

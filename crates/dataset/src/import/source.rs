//! From the place of a keyframe to its picture, depth and variance.

use super::inverse_depth::InverseDepth;
use super::pictures::ArrayPictures;
use super::sparse::SparseDepth;
use super::variance::VariancePictures;
use super::{Depth, Options};
use crate::{DatasetError, Sequence};
use i2slam_geometry::{Camera, Image, Pose};
use std::sync::Arc;

/// A keyframe before its picture is read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframePose {
    /// Place of the picture in the associated stream of its sequence, or in the imported file.
    pub index: usize,
    /// Time stamp of the picture [s].
    pub timestamp: f64,
    /// Pose of the nearest stamp in the files, not interpolated to the picture's; OpenCV's camera
    /// axes, in the unit of the files.
    pub world_from_camera: Pose<f64>,
    /// Place in the source of the pictures.
    pub(super) position: usize,
    /// Place in the imported files.
    pub(super) record: usize,
}

/// A keyframe, ready to use.
#[derive(Clone, Debug, PartialEq)]
pub struct Keyframe {
    /// Place of the picture in the associated stream of its sequence, or in the imported file.
    pub index: usize,
    /// Time stamp of the picture [s].
    pub timestamp: f64,
    /// 3 planes R, G, B in `[0, 1]`, as recorded (display space).
    pub colour: Arc<Image<f32>>,
    /// Pose of the nearest stamp in the files, not interpolated to the picture's; OpenCV's camera
    /// axes, in the unit of the files.
    pub world_from_camera: Pose<f64>,
    /// 1 plane, depth along the optical axis in the unit of the poses, 0 where there is none.
    pub depth: Option<Image<f32>>,
    /// 1 plane, variance of the depth in that unit squared, above 0 where there is depth.
    pub variance: Option<Image<f32>>,
}

/// A depth and its variance as they are kept, in single precision; `None` unless both are finite
/// and above 0 there.
pub(super) fn measured(depth: f64, variance: Option<f64>) -> Option<(f32, Option<f32>)> {
    let kept = |value: f64| Some(value as f32).filter(|value| value.is_finite() && *value > 0.0);
    match variance {
        None => Some((kept(depth)?, None)),
        Some(variance) => Some((kept(depth)?, Some(kept(variance)?))),
    }
}

/// Where pictures and depths come from.
#[derive(Clone, Debug)]
pub(super) struct Source {
    pub(super) pictures: Pictures,
    pub(super) depth: DepthSource,
}

/// Where pictures come from.
#[derive(Clone, Debug)]
pub(super) enum Pictures {
    Sequence(Box<Sequence>),
    Arrays(Box<ArrayPictures>),
}

/// Where depth comes from.
#[derive(Clone, Debug)]
pub(super) enum DepthSource {
    None,
    /// The depth pictures of the sequence, perhaps with pictures of their variance.
    Pictures(Option<VariancePictures>),
    Inverse(Box<InverseDepth>),
    Sparse(Box<SparseDepth>),
}

impl DepthSource {
    /// The depth pictures of the sequence.
    pub(super) fn pictures(options: &Options) -> Result<Self, DatasetError> {
        let variance = options.variance.as_deref().map(VariancePictures::open).transpose()?;
        Ok(Self::Pictures(variance))
    }

    /// The same if they are asked for, else none.
    pub(super) fn pictures_if_wanted(options: &Options) -> Result<Self, DatasetError> {
        match options.depth {
            Depth::Pictures => Self::pictures(options),
            Depth::None | Depth::Imported => Ok(Self::None),
        }
    }
}

impl Source {
    pub(super) fn camera(&self) -> Camera<f64> {
        match &self.pictures {
            Pictures::Sequence(sequence) => sequence.camera,
            Pictures::Arrays(pictures) => pictures.camera(),
        }
    }

    pub(super) fn at_least(&self, side: usize) -> Self {
        let pictures = match &self.pictures {
            Pictures::Sequence(sequence) => Pictures::Sequence(Box::new(sequence.at_least(side))),
            arrays @ Pictures::Arrays(_) => arrays.clone(),
        };
        Self { pictures, depth: self.depth.clone() }
    }

    pub(super) fn camera_source(&self) -> String {
        match &self.pictures {
            Pictures::Sequence(sequence) => sequence.camera_source.clone(),
            Pictures::Arrays(pictures) => pictures.source.clone(),
        }
    }

    pub(super) fn frame_rate(&self) -> f64 {
        match &self.pictures {
            Pictures::Sequence(sequence) => sequence.frame_rate,
            Pictures::Arrays(pictures) => pictures.frame_rate,
        }
    }

    pub(super) fn has_depth(&self) -> bool {
        !matches!(self.depth, DepthSource::None)
    }

    pub(super) fn has_variance(&self) -> bool {
        match &self.depth {
            DepthSource::None => false,
            DepthSource::Pictures(variance) => variance.is_some(),
            DepthSource::Inverse(depth) => depth.variance.is_some(),
            DepthSource::Sparse(_) => true,
        }
    }

    pub(super) fn sequence(&self) -> Option<&Sequence> {
        match &self.pictures {
            Pictures::Sequence(sequence) => Some(sequence),
            Pictures::Arrays(_) => None,
        }
    }

    /// The keyframe that sees most of the points that one sees; `None` where depth is not of
    /// points.
    pub(super) fn shares_most(&self, keyframes: &[KeyframePose], place: usize) -> Option<usize> {
        let DepthSource::Sparse(points) = &self.depth else { return None };
        let records: Vec<usize> = keyframes.iter().map(|keyframe| keyframe.record).collect();
        points.shares_most(&records, place)
    }

    /// Reads the picture of a keyframe and its depth.
    pub(super) fn load(&self, pose: &KeyframePose) -> Result<Keyframe, DatasetError> {
        let (colour, measured) = match &self.pictures {
            Pictures::Sequence(sequence) => {
                let frame = sequence.load(pose.position)?;
                (frame.colour, Some(Arc::unwrap_or_clone(frame.depth)))
            }
            Pictures::Arrays(pictures) => (Arc::new(pictures.load(pose.position)?), None),
        };
        let (depth, variance) = match (&self.depth, measured) {
            (DepthSource::Pictures(variance), Some(mut depth)) => {
                let sequence = self.sequence().zip(variance.as_ref());
                let variance = sequence
                    .map(|(sequence, variance)| variance.load(sequence, pose, &mut depth))
                    .transpose()?;
                (Some(depth), variance)
            }
            (DepthSource::Inverse(maps), _) => {
                let (depth, variance) = maps.at(pose.record, &self.camera())?;
                (Some(depth), variance)
            }
            (DepthSource::Sparse(points), _) => {
                let (depth, variance) = points.at(pose, &self.camera());
                (Some(depth), Some(variance))
            }
            (DepthSource::None | DepthSource::Pictures(_), _) => (None, None),
        };
        let (mut depth, mut variance) = (depth, variance);
        if let Some(covered) = self.sequence().and_then(|sequence| sequence.covered.as_ref()) {
            // Colour beyond the recorded picture repeats its edge, and belongs to no depth.
            for map in depth.iter_mut().chain(variance.iter_mut()) {
                let values = map.data.iter_mut().zip(&covered.data);
                values.filter(|(_, covered)| !**covered).for_each(|(value, _)| *value = 0.0);
            }
        }
        Ok(Keyframe {
            index: pose.index,
            timestamp: pose.timestamp,
            colour,
            world_from_camera: pose.world_from_camera,
            depth,
            variance,
        })
    }
}

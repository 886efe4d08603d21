//! Keyframes and the sources of their images and depth.

use super::depth_variance::VarianceImages;
use super::inverse_depth::InverseDepth;
use super::sparse_depth::SparseDepth;
use super::{ImportDepth, ImportOptions};
use crate::camera::Distortion;
use crate::formats::npy::NpyArray;
use crate::image::{RecordingCameras, Resampler};
use crate::sequence::{DEFAULT_FRAME_RATE, delivered_size};
use crate::{DatasetError, Sequence};
use i2slam_geometry::{Camera, Image, Pose};
use std::sync::Arc;

/// A keyframe whose image is not yet read.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct KeyframePose {
    /// Index of the image in the associated stream of its sequence, or in the imported file.
    pub index: usize,
    /// Time stamp of the image [s].
    pub timestamp: f64,
    /// Pose at the nearest time stamp in the files, not interpolated; OpenCV's camera axes, in the
    /// unit of the files.
    pub world_from_camera: Pose<f64>,
    /// Index in the source of the images.
    pub(super) position: usize,
    /// Index in the imported files.
    pub(super) record: usize,
}

/// A keyframe with its image, ready to use.
#[derive(Clone, Debug, PartialEq)]
pub struct Keyframe {
    /// Index of the image in the associated stream of its sequence, or in the imported file.
    pub index: usize,
    /// Time stamp of the image [s].
    pub timestamp: f64,
    /// 3 planes R, G, B in `[0, 1]`, as recorded (display space).
    pub colour: Arc<Image<f32>>,
    /// Pose at the nearest time stamp in the files, not interpolated; OpenCV's camera axes, in the
    /// unit of the files.
    pub world_from_camera: Pose<f64>,
    /// 1 plane, depth along the optical axis in the unit of the poses, 0 where there is none.
    pub depth: Option<Image<f32>>,
    /// 1 plane, variance of the depth in that unit squared, above 0 where there is depth.
    pub variance: Option<Image<f32>>,
}

/// Depth and variance in single precision; `None` unless both are finite and positive there.
pub(super) fn as_valid_f32(depth: f64, variance: Option<f64>) -> Option<(f32, Option<f32>)> {
    let kept = |value: f64| Some(value as f32).filter(|value| value.is_finite() && *value > 0.0);
    match variance {
        None => Some((kept(depth)?, None)),
        Some(variance) => Some((kept(depth)?, Some(kept(variance)?))),
    }
}

/// Sources of images and depth.
#[derive(Clone, Debug)]
pub(super) struct KeyframeSource {
    pub(super) images: ImageSource,
    pub(super) depth: DepthSource,
}

/// Source of images.
#[derive(Clone, Debug)]
pub(super) enum ImageSource {
    Sequence(Box<Sequence>),
    Arrays(Box<ArrayImages>),
}

/// Source of depth.
#[derive(Clone, Debug)]
pub(super) enum DepthSource {
    None,
    /// Depth images of the sequence, optionally with images of their variance.
    Images(Option<VarianceImages>),
    Inverse(Box<InverseDepth>),
    Sparse(Box<SparseDepth>),
}

impl DepthSource {
    /// Depth images of the sequence.
    pub(super) fn images(options: &ImportOptions) -> Result<Self, DatasetError> {
        let variance = options.variance.as_deref().map(VarianceImages::open).transpose()?;
        Ok(Self::Images(variance))
    }

    /// Depth images of the sequence if the options ask for them, else none.
    pub(super) fn images_if_requested(options: &ImportOptions) -> Result<Self, DatasetError> {
        match options.depth {
            ImportDepth::Pictures => Self::images(options),
            ImportDepth::None | ImportDepth::Imported => Ok(Self::None),
        }
    }
}

impl KeyframeSource {
    pub(super) fn camera(&self) -> Camera<f64> {
        match &self.images {
            ImageSource::Sequence(sequence) => sequence.camera,
            ImageSource::Arrays(images) => images.camera(),
        }
    }

    pub(super) fn at_least(&self, side: usize) -> Self {
        let mut enlarged = self.clone();
        if let ImageSource::Sequence(sequence) = &mut enlarged.images {
            **sequence = sequence.at_least(side);
        }
        enlarged
    }

    pub(super) fn camera_source(&self) -> String {
        match &self.images {
            ImageSource::Sequence(sequence) => sequence.camera_source.clone(),
            ImageSource::Arrays(images) => images.source.clone(),
        }
    }

    pub(super) fn frame_rate(&self) -> f64 {
        match &self.images {
            ImageSource::Sequence(sequence) => sequence.frame_rate,
            ImageSource::Arrays(_) => DEFAULT_FRAME_RATE,
        }
    }

    pub(super) fn has_depth(&self) -> bool {
        !matches!(self.depth, DepthSource::None)
    }

    pub(super) fn has_variance(&self) -> bool {
        match &self.depth {
            DepthSource::None => false,
            DepthSource::Images(variance) => variance.is_some(),
            DepthSource::Inverse(depth) => depth.variance.is_some(),
            DepthSource::Sparse(_) => true,
        }
    }

    pub(super) fn has_sparse_depth(&self) -> bool {
        matches!(self.depth, DepthSource::Sparse(_))
    }

    pub(super) fn sequence(&self) -> Option<&Sequence> {
        match &self.images {
            ImageSource::Sequence(sequence) => Some(sequence),
            ImageSource::Arrays(_) => None,
        }
    }

    /// The keyframe that shares most points with another; `None` if depth is not sparse.
    pub(super) fn most_covisible(&self, keyframes: &[KeyframePose], index: usize) -> Option<usize> {
        let DepthSource::Sparse(points) = &self.depth else { return None };
        let records: Vec<usize> = keyframes.iter().map(|keyframe| keyframe.record).collect();
        points.most_covisible(&records, index)
    }

    /// Reads the image and depth of a keyframe.
    pub(super) fn load(&self, pose: &KeyframePose) -> Result<Keyframe, DatasetError> {
        let (colour, image_depth) = match &self.images {
            ImageSource::Sequence(sequence) => {
                let frame = sequence.load(pose.position)?;
                (frame.colour, frame.depth.map(|depth| Arc::unwrap_or_clone(depth.image)))
            }
            ImageSource::Arrays(images) => (Arc::new(images.load(pose.position)?), None),
        };
        let (depth, variance) = match (&self.depth, image_depth) {
            (DepthSource::Images(variance), Some(mut depth)) => {
                let sequence = self.sequence().zip(variance.as_ref());
                let variance = sequence
                    .map(|(sequence, variance)| variance.load(sequence, pose, &mut depth))
                    .transpose()?;
                (Some(depth), variance)
            }
            (DepthSource::Inverse(maps), _) => {
                let (depth, variance) = maps.resample(pose.record, &self.camera())?;
                (Some(depth), variance)
            }
            (DepthSource::Sparse(points), _) => {
                let (depth, variance) = points.rasterise(pose, &self.camera());
                (Some(depth), Some(variance))
            }
            (DepthSource::None | DepthSource::Images(_), _) => (None, None),
        };
        let (mut depth, mut variance) = (depth, variance);
        if let Some(valid_mask) = self.sequence().and_then(|sequence| sequence.valid_mask.as_ref())
        {
            // Colour beyond the recorded image repeats its edge, so depth there would be wrong.
            for map in depth.iter_mut().chain(variance.iter_mut()) {
                let values = map.data.iter_mut().zip(&valid_mask.data);
                values.filter(|(_, is_valid)| !**is_valid).for_each(|(value, _)| *value = 0.0);
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

/// Images in an array of bytes, `[frames, 3, height, width]` or `[frames, height, width, 3]`.
#[derive(Clone, Debug)]
pub(super) struct ArrayImages {
    images: NpyArray,
    /// Whether channels are R, G, B rather than B, G, R.
    is_rgb: bool,
    resampler: Resampler,
    pub(super) source: String,
}

impl ArrayImages {
    pub(super) fn new(
        images: NpyArray,
        camera: Camera<f64>,
        source: String,
        is_rgb: bool,
        options: &ImportOptions,
    ) -> Result<Self, DatasetError> {
        let cameras = RecordingCameras { colour: camera, depth: camera, grid: camera };
        let delivered = delivered_size(&camera, &options.open)?;
        let lens = Distortion::default();
        let resampler = Resampler::new(&cameras, &lens, options.open.crop_border, delivered);
        Ok(Self { images, is_rgb, resampler, source })
    }

    /// Camera of the delivered images.
    pub(super) fn camera(&self) -> Camera<f64> {
        self.resampler.camera
    }

    /// Reads and resamples an image: R, G, B in `[0, 1]`.
    pub(super) fn load(&self, index: usize) -> Result<Image<f32>, DatasetError> {
        let values = self.images.slice(index)?;
        let (planar, height, width) = match self.images.shape[1..] {
            [3, height, width] => (true, height, width),
            [height, width, _] => (false, height, width),
            _ => (true, 0, 0),
        };
        let pixels = width * height;
        let image = Image::from_fn(width, height, 3, |channel, column, row| {
            let channel = if self.is_rgb { channel } else { 2 - channel };
            let pixel = row * width + column;
            let at = if planar { channel * pixels + pixel } else { 3 * pixel + channel };
            (values[at] / 255.0) as f32
        });
        Ok(self.resampler.colour(&image))
    }
}

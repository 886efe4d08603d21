//! Pictures that lie in an array.

use super::Options;
use super::npy::Array;
use crate::DatasetError;
use crate::distortion::Distortion;
use crate::resample::{Recorded, Resampler};
use crate::sizes::delivered_size;
use i2slam_geometry::{Camera, Image};

/// Pictures `[frames, 3, height, width]` or `[frames, height, width, 3]` of bytes.
#[derive(Clone, Debug)]
pub(super) struct ArrayPictures {
    images: Array,
    /// Channels are R, G, B; else B, G, R.
    is_rgb: bool,
    resampler: Resampler,
    pub(super) source: String,
    pub(super) frame_rate: f64,
}

impl ArrayPictures {
    pub(super) fn new(
        images: Array,
        camera: Camera<f64>,
        source: String,
        frame_rate: f64,
        is_rgb: bool,
        options: &Options,
    ) -> Result<Self, DatasetError> {
        let recorded = Recorded { colour: camera, depth: camera, grid: camera };
        let delivered = delivered_size(&camera, &options.open)?;
        let lens = Distortion::default();
        let resampler = Resampler::new(&recorded, &lens, options.open.crop_border, delivered);
        Ok(Self { images, is_rgb, resampler, source, frame_rate })
    }

    /// The camera of the delivered pictures.
    pub(super) fn camera(&self) -> Camera<f64> {
        self.resampler.camera
    }

    /// A picture as it is delivered, R, G, B in `[0, 1]`.
    pub(super) fn load(&self, place: usize) -> Result<Image<f32>, DatasetError> {
        let values = self.images.slice(place)?;
        let (planar, height, width) = match self.images.shape[1..] {
            [3, height, width] => (true, height, width),
            [height, width, _] => (false, height, width),
            _ => (true, 0, 0),
        };
        let mut picture = Image::new(width, height, 3);
        let pixels = picture.pixels();
        for channel in 0..3 {
            let from = if self.is_rgb { channel } else { 2 - channel };
            for (pixel, value) in picture.plane_mut(channel).iter_mut().enumerate() {
                let at = if planar { from * pixels + pixel } else { 3 * pixel + from };
                *value = (values[at] / 255.0) as f32;
            }
        }
        Ok(self.resampler.colour(&picture))
    }
}

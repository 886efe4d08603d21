//! Keyframe pictures kept small for relocalization and loop closure.

use crate::track::global_translation::overlap_correlation;
use crate::track::pyramid::Pyramid;
use i2slam_geometry::Image;
use std::sync::Arc;

/// Pixels of the kept picture: the finest pyramid level with at most so many.
const MAX_PIXELS: usize = 160_000;
/// Columns and rows of a thumbnail.
const COLUMNS: usize = 16;
const ROWS: usize = 12;
/// Largest shift at which thumbnails are compared [thumbnail px].
const MAX_THUMBNAIL_SHIFT: isize = 2;
/// Contrast bound of `overlap_correlation`: flatter thumbnails correlate with nothing.
const MIN_SPREAD: f32 = 1e-6;

/// A keyframe's picture in 8 bits per pixel, with a thumbnail.
#[derive(Clone, Debug)]
pub(crate) struct KeyframeImage {
    /// Index of the frame.
    pub(crate) frame: usize,
    width: usize,
    height: usize,
    brightness: Vec<u8>,
    /// Factor from positions in the kept picture to those in the full one.
    pub(crate) scale: f64,
    thumbnail: Image<f32>,
}

impl KeyframeImage {
    /// Keeps the picture of a frame.
    pub(crate) fn new(pyramid: &Pyramid, frame: usize) -> Self {
        let small = |image: &Image<f32>| image.width * image.height <= MAX_PIXELS;
        let last = pyramid.levels.len() - 1;
        let level = pyramid.levels.iter().position(small).unwrap_or(last);
        let image = &pyramid.levels[level];
        let brightness =
            image.data.iter().map(|v| (255.0 * v.clamp(0.0, 1.0)).round() as u8).collect();
        let thumbnail = pyramid.coarsest().0.resized_by_area(COLUMNS, ROWS);
        let scale = (1_usize << level) as f64;
        Self { frame, width: image.width, height: image.height, brightness, scale, thumbnail }
    }

    /// The picture as that of another frame, which repeats it.
    pub(crate) fn of_frame(image: &Arc<Self>, frame: usize) -> Arc<Self> {
        match image.frame == frame {
            true => Arc::clone(image),
            false => Arc::new(Self { frame, ..Self::clone(image) }),
        }
    }

    /// The kept picture as a pyramid.
    pub(crate) fn pyramid(&self) -> Pyramid {
        Pyramid::new(&self.picture())
    }

    /// The kept picture.
    pub(crate) fn picture(&self) -> Image<f32> {
        let mut image = Image::new(self.width, self.height, 1);
        for (value, byte) in image.data.iter_mut().zip(&self.brightness) {
            *value = f32::from(*byte) / 255.0;
        }
        image
    }

    /// Correlation of the thumbnails at the best shift.
    pub(crate) fn thumbnail_correlation(&self, other: &Self) -> f32 {
        let moves = (-MAX_THUMBNAIL_SHIFT..=MAX_THUMBNAIL_SHIFT)
            .flat_map(|dy| (-MAX_THUMBNAIL_SHIFT..=MAX_THUMBNAIL_SHIFT).map(move |dx| (dx, dy)));
        let at = |by| overlap_correlation(&self.thumbnail, &other.thumbnail, by, MIN_SPREAD);
        moves.map(at).fold(-1.0, f32::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn keyframe_image(dx: f32, gain: f32) -> KeyframeImage {
        let image = Image::from_fn(160, 120, 1, |_, column, row| {
            let (x, y) = (column as f32 - dx, row as f32);
            gain * (0.5 + 0.2 * (0.05 * x).sin() + 0.2 * (0.07 * y + 0.03 * x).cos())
        });
        KeyframeImage::new(&Pyramid::new(&image), 0)
    }

    #[test]
    fn a_moved_picture_in_another_light_is_alike_and_another_one_is_not() {
        let first = keyframe_image(0.0, 1.0);
        assert!(first.thumbnail_correlation(&keyframe_image(12.0, 0.6)) > 0.97);
        assert!(first.thumbnail_correlation(&keyframe_image(60.0, 1.0)) < 0.8);
        assert_eq!(first.scale, 1.0);
        let flat = KeyframeImage::new(&Pyramid::new(&Image::new(160, 120, 1)), 0);
        assert_eq!(first.thumbnail_correlation(&flat), 0.0);
    }
}

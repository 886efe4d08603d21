//! Pictures as they are kept for dense alignment.

use super::depth_map::halvings;
use super::scratch::{ScratchFile, StoredImage};
use crate::alignment::halved_by_mean;
use i2slam_geometry::Image;
use std::sync::Arc;

/// A picture of eight bits, halved until it is small enough to be kept.
#[derive(Clone, Debug)]
pub(crate) struct StoredPicture(StoredImage<u8>);

impl StoredPicture {
    pub(crate) fn new(picture: &Image<f32>) -> Self {
        let mut small = None;
        for _ in 0..halvings(picture.width, picture.height) {
            small = Some(halved_by_mean(small.as_ref().unwrap_or(picture)));
        }
        let small = small.as_ref().unwrap_or(picture);
        let data = small.data.iter().map(|v| (255.0 * v).round() as u8).collect();
        let (width, height, channels) = (small.width, small.height, small.channels);
        Self(StoredImage::new(Image { width, height, channels, data }))
    }

    /// Values in [0, 1].
    pub(crate) fn picture(&self) -> Image<f32> {
        let stored = self.0.image();
        let data = stored.data.iter().map(|v| f32::from(*v) / 255.0).collect();
        let (width, height, channels) = (stored.width, stored.height, stored.channels);
        Image { width, height, channels, data }
    }

    /// Moves the picture to a file.
    pub(crate) fn move_to(&mut self, file: &Arc<ScratchFile>) {
        self.0.move_to(file);
    }
}

//! Pictures as they are kept for dense alignment.

use super::depth_map::halvings;
use crate::alignment::halved_by_mean;
use i2slam_geometry::Image;

/// A picture of eight bits, halved until it is small enough to be kept.
#[derive(Clone, Debug)]
pub(crate) struct StoredPicture(Image<u8>);

impl StoredPicture {
    pub(crate) fn new(picture: &Image<f32>) -> Self {
        let mut small = None;
        for _ in 0..halvings(picture.width, picture.height) {
            small = Some(halved_by_mean(small.as_ref().unwrap_or(picture)));
        }
        let small = small.as_ref().unwrap_or(picture);
        let data = small.data.iter().map(|v| (255.0 * v).round() as u8).collect();
        let (width, height, channels) = (small.width, small.height, small.channels);
        Self(Image { width, height, channels, data })
    }

    /// Values in [0, 1].
    pub(crate) fn picture(&self) -> Image<f32> {
        let Image { width, height, channels, data } = &self.0;
        let data = data.iter().map(|v| f32::from(*v) / 255.0).collect();
        Image { width: *width, height: *height, channels: *channels, data }
    }
}

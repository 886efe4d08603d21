//! Pictures as they are kept for dense alignment, and depth as it is read again.

use super::depth_map::halvings;
use crate::alignment::halved_by_mean;
use i2slam_geometry::Image;
use i2slam_storage::{ScratchStore, Storable, Stored, append_floats, floats};
use std::sync::Arc;

/// A picture of eight bits, halved until it is small enough to be kept.
#[derive(Clone, Debug)]
pub(crate) struct StoredPicture(Stored<ByteImage>);

struct ByteImage(Image<u8>);

/// A depth picture that may be in a file.
pub(crate) struct DepthImage(pub(crate) Image<f32>);

impl StoredPicture {
    pub(crate) fn new(picture: &Image<f32>, scratch: &Arc<ScratchStore>) -> Self {
        let mut small = None;
        for _ in 0..halvings(picture.width, picture.height) {
            small = Some(halved_by_mean(small.as_ref().unwrap_or(picture)));
        }
        let small = small.as_ref().unwrap_or(picture);
        let data = small.data.iter().map(|v| (255.0 * v).round() as u8).collect();
        let (width, height, channels) = (small.width, small.height, small.channels);
        Self(scratch.insert(ByteImage(Image { width, height, channels, data })))
    }

    /// Values in [0, 1].
    pub(crate) fn picture(&self) -> Image<f32> {
        let stored = &self.0.get().0;
        let data = stored.data.iter().map(|v| f32::from(*v) / 255.0).collect();
        let (width, height, channels) = (stored.width, stored.height, stored.channels);
        Image { width, height, channels, data }
    }
}

/// Width, height and channels.
type Shape = [usize; 3];

fn shape<T>(image: &Image<T>) -> Shape {
    [image.width, image.height, image.channels]
}

fn image<T>([width, height, channels]: Shape, data: Vec<T>) -> Image<T> {
    Image { width, height, channels, data }
}

impl Storable for ByteImage {
    type Shape = Shape;

    fn shape(&self) -> Shape {
        shape(&self.0)
    }

    fn memory(&self) -> usize {
        self.0.data.len()
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        bytes.extend(&self.0.data);
    }

    fn read(shape: &Shape, bytes: &[u8]) -> Self {
        Self(image(*shape, bytes.to_vec()))
    }
}

impl Storable for DepthImage {
    type Shape = Shape;

    fn shape(&self) -> Shape {
        shape(&self.0)
    }

    fn memory(&self) -> usize {
        size_of_val(&*self.0.data)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        append_floats(bytes, &self.0.data);
    }

    fn read(shape: &Shape, bytes: &[u8]) -> Self {
        Self(image(*shape, floats(bytes)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn pictures_come_back_byte_for_byte() {
        let folder = TemporaryFolder::new("stored-pictures");
        let scratch = ScratchStore::new(0, folder.join(""));
        let depth = Image::from_fn(7, 5, 1, |_, c, r| 0.1 + c as f32 / (1.0 + r as f32));
        let colour = Image::from_fn(7, 5, 3, |k, c, r| (70 * k + 7 * c + r) as u8);
        let stored =
            (scratch.insert(DepthImage(depth.clone())), scratch.insert(ByteImage(colour.clone())));
        assert_eq!(scratch.file_bytes(), 4 * 35 + 105);
        assert_eq!(stored.0.get().0, depth);
        assert_eq!(stored.1.get().0, colour);
    }
}

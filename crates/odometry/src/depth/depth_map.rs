//! Depth pictures as they are kept, and their readings between pixels.

use super::stored_picture::DepthImage;
use crate::alignment::{halved_depth, is_one_surface};
use i2slam_geometry::Image;
use i2slam_storage::{ScratchStore, Stored};
use std::sync::Arc;

/// Longer side up to which pictures are kept whole; larger ones are halved [px].
const MAX_SIDE: usize = 480;

/// A depth picture of the size of its colour picture.
#[derive(Clone, Copy, Debug)]
pub struct DepthPicture<'a> {
    /// Depth along the optical axis [m], one plane; 0 where there is no reading.
    pub depth: &'a Image<f32>,
    /// Timestamp [s].
    pub timestamp: f64,
}

/// Depth of a frame, halved until it is small enough to be kept.
#[derive(Clone, Debug)]
pub(crate) struct DepthMap {
    /// Depth [m], 0 where there is no reading.
    depth: Stored<DepthImage>,
    /// Pixels of the picture from one reading to the next.
    step: usize,
    /// [s]
    pub(crate) timestamp: f64,
}

/// Times that a picture is halved before it is kept.
pub(crate) fn halvings(width: usize, height: usize) -> u32 {
    width.max(height).div_ceil(MAX_SIDE).next_power_of_two().ilog2()
}

impl DepthMap {
    pub(crate) fn new(picture: &DepthPicture<'_>, scratch: &Arc<ScratchStore>) -> Self {
        let halvings = halvings(picture.depth.width, picture.depth.height);
        let mut depth = picture.depth.clone();
        (0..halvings).for_each(|_| depth = halved_depth(&depth));
        let depth = scratch.insert(DepthImage(depth));
        Self { depth, step: 1 << halvings, timestamp: picture.timestamp }
    }

    /// True if any pixel has a reading.
    pub(crate) fn has_readings(&self) -> bool {
        self.depth.get().0.data.iter().any(|z| *z > 0.0 && z.is_finite())
    }

    /// Drops the readings of blocks of the picture.
    pub(crate) fn clear(&mut self, blocks: &Image<bool>) {
        let mut depth = self.depth.get().0.clone();
        let (width, height) = (depth.width, depth.height);
        for (i, value) in depth.data.iter_mut().enumerate() {
            let (column, row) = (i % width, i / width);
            if blocks.at(0, column * blocks.width / width, row * blocks.height / height) {
                *value = 0.0;
            }
        }
        self.depth = self.depth.insert_beside(DepthImage(depth));
    }

    /// The readings, read where they are not in memory.
    pub(crate) fn readings(&self) -> DepthReadings {
        DepthReadings { depth: self.depth.get(), step: self.step }
    }
}

/// Readings of a frame in memory.
pub(crate) struct DepthReadings {
    depth: Arc<DepthImage>,
    step: usize,
}

impl DepthReadings {
    /// Depth [m], 0 where there is no reading.
    pub(crate) fn depth(&self) -> &Image<f32> {
        &self.depth.0
    }

    /// Inverse depth at a position of the picture [px], interpolated between four readings of one
    /// surface; `None` without.
    pub(crate) fn inverse_at(&self, at: [f64; 2]) -> Option<f64> {
        interpolated_depth(self.depth(), at.map(|v| v / self.step as f64)).map(f64::recip)
    }
}

/// Depth at a position [px], by inverse depth between four readings of one surface, which is exact
/// on planes; `None` without.
pub(super) fn interpolated_depth(depth: &Image<f32>, at: [f64; 2]) -> Option<f64> {
    let [x, y] = at.map(|v| v - 0.5);
    let (column, row) = (x.floor() as usize, y.floor() as usize);
    if x < 0.0 || y < 0.0 || column + 1 >= depth.width || row + 1 >= depth.height {
        return None;
    }
    let reading = |c: usize, r: usize| depth.at(0, column + c, row + r);
    let all = [reading(0, 0), reading(1, 0), reading(0, 1), reading(1, 1)];
    if !is_one_surface(all) {
        return None;
    }
    let [a, b, c, d] = all.map(|z| f64::from(z).recip());
    let (u, v) = (x - x.floor(), y - y.floor());
    Some(((1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * c + u * d)).recip())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Inverse depth is linear in the picture on a plane: interpolation is exact, at any size.
    #[test]
    fn a_plane_is_read_exactly_and_an_edge_not_at_all() {
        for width in [320_usize, 640, 1280] {
            let plane = |u: f64, v: f64| 0.4 + 1e-4 * u - 2e-4 * v;
            let depth = Image::from_fn(width, 240, 1, |_, c, r| {
                let near = if c >= 200 { 3.0 } else { 1.0 };
                (1.0 / (near * plane(c as f64 + 0.5, r as f64 + 0.5))) as f32
            });
            let map = DepthMap::new(
                &DepthPicture { depth: &depth, timestamp: 0.0 },
                &ScratchStore::in_memory(),
            );
            let map = map.readings();
            let found = map.inverse_at([50.3, 70.9]).expect("a surface");
            assert!((found - plane(50.3, 70.9)).abs() < 1e-6, "{width}: {found}");
            assert_eq!(map.inverse_at([200.0, 70.9]), None);
            assert_eq!(map.inverse_at([-1.0, 3.0]), None);
            assert_eq!(map.inverse_at([width as f64, 3.0]), None);
        }
    }
}

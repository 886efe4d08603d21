//! Random pictures for tests.

use i2slam_geometry::Image;

/// Numbers in `[-1, 1]`.
pub(crate) fn values(seed: u64, count: usize) -> Vec<f32> {
    i2slam_check::noise(seed, count).iter().map(|&v| v as f32).collect()
}

/// Three planes in `[0, 1]`.
pub(crate) fn picture(seed: u64, width: usize, height: usize) -> Image<f32> {
    planes(seed, width, height, 3)
}

/// One plane in `[0, 1]`.
pub(crate) fn grey(seed: u64, width: usize, height: usize) -> Image<f32> {
    planes(seed, width, height, 1)
}

fn planes(seed: u64, width: usize, height: usize, channels: usize) -> Image<f32> {
    let data = values(seed, width * height * channels).iter().map(|v| 0.5 + 0.5 * v).collect();
    Image { width, height, channels, data }
}

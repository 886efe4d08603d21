//! Pyramids of pictures and of depth: each level half the size of the one before.

use super::residual::is_one_surface;
use i2slam_geometry::{Camera, Image};

/// Intrinsics at exactly half the scale, also where an odd last row or column is dropped.
pub fn halved_camera(camera: &Camera<f32>, picture: &Image<f32>) -> Camera<f32> {
    Camera {
        width: picture.width,
        height: picture.height,
        fx: 0.5 * camera.fx,
        fy: 0.5 * camera.fy,
        cx: 0.5 * camera.cx,
        cy: 0.5 * camera.cy,
    }
}

/// A picture of half the size, by the mean of 2 × 2 pixels; an odd last row or column is dropped.
pub fn halved_by_mean(image: &Image<f32>) -> Image<f32> {
    halved(image, |block| block.iter().sum::<f32>() * 0.25)
}

/// The harmonic mean of a block that lies on one surface, otherwise no reading: an average over an
/// edge would be on neither surface.
pub fn halved_depth(depth: &Image<f32>) -> Image<f32> {
    halved(depth, |block| match is_one_surface(block) {
        true => 4.0 / block.iter().map(|d| 1.0 / d).sum::<f32>(),
        false => 0.0,
    })
}

/// Reduces blocks of 2 × 2 pixels; an odd last row or column is dropped.
fn halved(image: &Image<f32>, reduce: impl Fn([f32; 4]) -> f32) -> Image<f32> {
    let (width, height) = ((image.width / 2).max(1), (image.height / 2).max(1));
    let right = |c: usize| (2 * c + 1).min(image.width - 1);
    let below = |r: usize| (2 * r + 1).min(image.height - 1);
    Image::from_fn(width, height, image.channels, |channel, column, row| {
        reduce([
            image.at(channel, 2 * column, 2 * row),
            image.at(channel, right(column), 2 * row),
            image.at(channel, 2 * column, below(row)),
            image.at(channel, right(column), below(row)),
        ])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn depth_is_not_averaged_over_edges() {
        let image = |data| Image { width: 2, height: 2, channels: 1, data };
        assert_eq!(halved_depth(&image(vec![1.0, 1.0, 2.0, 2.0])).data, vec![0.0]);
        assert_eq!(halved_depth(&image(vec![1.0, 1.0, 0.0, 1.0])).data, vec![0.0]);
        let middle = halved_depth(&image(vec![1.0, 1.02, 1.0, 1.02])).data[0];
        assert!((middle - 2.04 / 2.02).abs() < 1e-6);
    }
}

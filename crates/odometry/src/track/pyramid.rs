//! Image pyramid of brightness.

use i2slam_geometry::Image;

/// Shorter side of the coarsest level, at least [px].
const COARSEST_SIDE: usize = 24;

/// Brightness of a picture, each level half as large as the one before. With pixel centres at half
/// integers a position on level `l` is that on level 0 divided by `2^l`.
#[derive(Clone, Debug)]
pub(crate) struct Pyramid {
    pub(crate) levels: Vec<Image<f32>>,
}

impl Pyramid {
    /// The pyramid of a picture with channels R, G, B, or of one with a single channel.
    pub(crate) fn new(picture: &Image<f32>) -> Self {
        let mut levels = vec![brightness(picture)];
        while let Some(last) = levels.last() {
            if (last.width / 2).min(last.height / 2) < COARSEST_SIDE {
                break;
            }
            let next = downsample(last);
            levels.push(next);
        }
        Self { levels }
    }

    /// The full-size level.
    pub(crate) fn finest(&self) -> &Image<f32> {
        &self.levels[0]
    }

    /// The smallest level, and the factor from its positions to those of the finest.
    pub(crate) fn coarsest(&self) -> (&Image<f32>, f32) {
        let last = self.levels.len() - 1;
        (&self.levels[last], (1_usize << last) as f32)
    }
}

/// Luma (Rec. 601) of an encoded picture; values that are not finite count as black.
fn brightness(picture: &Image<f32>) -> Image<f32> {
    let mut out = Image::new(picture.width, picture.height, 1);
    let weights: &[f32] = if picture.channels >= 3 { &[0.299, 0.587, 0.114] } else { &[1.0] };
    for (channel, weight) in weights.iter().enumerate() {
        for (sum, value) in out.data.iter_mut().zip(picture.plane(channel)) {
            *sum += weight * if value.is_finite() { *value } else { 0.0 };
        }
    }
    out
}

/// Every second pixel after the filter [1 3 3 1] / 8, centred between two pixels.
fn downsample(image: &Image<f32>) -> Image<f32> {
    let (width, height) = (image.width / 2, image.height / 2);
    let mut rows = Image::new(width, image.height, 1);
    for (from, to) in image.data.chunks_exact(image.width).zip(rows.data.chunks_exact_mut(width)) {
        for (column, value) in to.iter_mut().enumerate() {
            *value = binomial_filter(2 * column, image.width, |i| from[i]);
        }
    }
    let mut out = Image::new(width, height, 1);
    for row in 0..height {
        for column in 0..width {
            out.data[row * width + column] =
                binomial_filter(2 * row, image.height, |i| rows.data[i * width + column]);
        }
    }
    out
}

fn binomial_filter(first: usize, size: usize, value: impl Fn(usize) -> f32) -> f32 {
    let (before, after) = (first.saturating_sub(1), (first + 2).min(size - 1));
    0.125 * (value(before) + value(after)) + 0.375 * (value(first) + value(first + 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slope_keeps_its_place_on_every_level() {
        let picture = Image::from_fn(128, 96, 1, |_, column, _| column as f32 + 0.5);
        let pyramid = Pyramid::new(&picture);
        assert_eq!(pyramid.levels.len(), 3);
        let coarse = pyramid.coarsest();
        assert_eq!(coarse.1, 4.0);
        // Away from the border the value is the position, whatever the level.
        assert!((coarse.0.at(0, 16, 10) - 16.5 * 4.0).abs() < 1e-3);
    }
}

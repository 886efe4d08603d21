//! Pixel grids: planar images of any number of channels.

use crate::Real;

/// A planar image: `data[(channel * height + row) * width + column]`.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Image<T> {
    /// Width [px].
    pub width: usize,
    /// Height [px].
    pub height: usize,
    /// Number of planes.
    pub channels: usize,
    /// The planes, one after another, rows from top to bottom.
    pub data: Vec<T>,
}

impl<T: Copy + Default> Image<T> {
    /// An image filled with the type's default (zero).
    pub fn new(width: usize, height: usize, channels: usize) -> Self {
        Self { width, height, channels, data: vec![T::default(); width * height * channels] }
    }

    /// An image of `value(channel, column, row)`.
    pub fn from_fn(
        width: usize,
        height: usize,
        channels: usize,
        mut value: impl FnMut(usize, usize, usize) -> T,
    ) -> Self {
        let pixels = width * height;
        let data = (0..channels * pixels).map(|i| value(i / pixels, i % width, i % pixels / width));
        Self { width, height, channels, data: data.collect() }
    }

    /// Number of pixels of one plane.
    pub fn pixels(&self) -> usize {
        self.width * self.height
    }

    /// One plane.
    pub fn plane(&self, channel: usize) -> &[T] {
        let n = self.pixels();
        &self.data[channel * n..(channel + 1) * n]
    }

    /// One plane, to write.
    pub fn plane_mut(&mut self, channel: usize) -> &mut [T] {
        let n = self.pixels();
        &mut self.data[channel * n..(channel + 1) * n]
    }

    /// The value at (`channel`, `column`, `row`).
    pub fn at(&self, channel: usize, column: usize, row: usize) -> T {
        self.data[(channel * self.height + row) * self.width + column]
    }

    /// Resize to `width x height x channels`, keeping the allocation, and fill with zero.
    pub fn reset(&mut self, width: usize, height: usize, channels: usize) {
        (self.width, self.height, self.channels) = (width, height, channels);
        self.data.clear();
        self.data.resize(width * height * channels, T::default());
    }

    /// Writes the image without `margin` pixels on every side to `out`, whose allocation is
    /// reused.
    pub fn crop_into(&self, margin: usize, out: &mut Self) {
        let (width, height) =
            (self.width.saturating_sub(2 * margin), self.height.saturating_sub(2 * margin));
        out.reshape(width, height, self.channels);
        for (i, row) in out.data.chunks_exact_mut(width.max(1)).enumerate() {
            let from = (i / height * self.height + i % height + margin) * self.width + margin;
            row.copy_from_slice(&self.data[from..from + width]);
        }
    }

    /// Writes the image with `margin` pixels of zero more on every side to `out`, whose
    /// allocation is reused: the transpose of [`crop_into`](Self::crop_into).
    pub fn embed_into(&self, margin: usize, out: &mut Self) {
        out.reset(self.width + 2 * margin, self.height + 2 * margin, self.channels);
        for (i, row) in self.data.chunks_exact(self.width.max(1)).enumerate() {
            let to = (i / self.height * out.height + i % self.height + margin) * out.width + margin;
            out.data[to..to + self.width].copy_from_slice(row);
        }
    }

    /// As [`reset`](Self::reset), without filling an image that has the shape already.
    pub fn reshape(&mut self, width: usize, height: usize, channels: usize) {
        if (self.width, self.height, self.channels) != (width, height, channels) {
            self.reset(width, height, channels);
        }
    }
}

impl<T: Real> Image<T> {
    /// The image reduced by the average over blocks (`width` and `height` need not divide).
    pub fn resized_by_area(&self, width: usize, height: usize) -> Self {
        let spans = |from: usize, to: usize| -> Vec<(usize, usize, f64, f64)> {
            let step = from as f64 / to as f64;
            (0..to)
                .map(|i| {
                    let (a, b) = (i as f64 * step, (i as f64 + 1.0) * step);
                    (a as usize, (b.ceil() as usize).min(from), a, b)
                })
                .collect()
        };
        let (columns, rows) = (spans(self.width, width), spans(self.height, height));
        Self::from_fn(width, height, self.channels, |channel, column, row| {
            let ((c0, c1, ca, cb), (r0, r1, ra, rb)) = (columns[column], rows[row]);
            let (mut sum, mut weight) = (0.0, 0.0);
            for r in r0..r1 {
                let wr = (rb.min(r as f64 + 1.0) - ra.max(r as f64)).max(0.0);
                for c in c0..c1 {
                    let w = wr * (cb.min(c as f64 + 1.0) - ca.max(c as f64)).max(0.0);
                    sum += w * self.at(channel, c, r).to_f64();
                    weight += w;
                }
            }
            T::of(sum / weight)
        })
    }

    /// The image sampled at the nearest pixel: for depth, where averages invent surfaces.
    pub fn resized_by_nearest(&self, width: usize, height: usize) -> Self {
        let nearest = |i: usize, from: usize, to: usize| {
            ((i as f64 + 0.5) * from as f64 / to as f64) as usize
        };
        Self::from_fn(width, height, self.channels, |channel, column, row| {
            self.at(channel, nearest(column, self.width, width), nearest(row, self.height, height))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn area_resize_keeps_the_mean() {
        let image = Image::from_fn(7, 5, 2, |channel, column, row| {
            let i = (channel * 5 + row) * 7 + column;
            (i * i % 13) as f64
        });
        let small = image.resized_by_area(3, 2);
        let mean = |i: &Image<f64>| i.data.iter().sum::<f64>() / i.data.len() as f64;
        assert!((mean(&image) - mean(&small)).abs() < 1e-12);
    }

    #[test]
    fn a_margin_is_embedded_and_cropped_again() {
        let data = (0..24).map(f64::from).collect();
        let image = Image { width: 4, height: 3, channels: 2, data };
        let (mut wide, mut back) = (Image::new(1, 1, 1), Image::default());
        image.embed_into(2, &mut wide);
        assert_eq!((wide.width, wide.height, wide.channels), (8, 7, 2));
        assert_eq!((wide.at(1, 5, 4), wide.at(1, 5, 5)), (image.at(1, 3, 2), 0.0));
        wide.crop_into(2, &mut back);
        assert_eq!(back, image);
        wide.crop_into(4, &mut back);
        assert!(back.data.is_empty());
    }

    #[test]
    fn halving_averages_two_by_two() {
        let image = Image { width: 2, height: 2, channels: 1, data: vec![1.0, 2.0, 3.0, 6.0] };
        assert_eq!(image.resized_by_area(1, 1).data, vec![3.0]);
    }
}

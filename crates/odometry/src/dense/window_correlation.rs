//! Zero-mean normalised correlation of windows, for all pixels at once by box filters.

use i2slam_geometry::Image;

/// Variance of noise in a window of an 8-bit picture: windows with less contrast match nothing.
const WINDOW_NOISE_VARIANCE: f32 = 5e-5;

/// A picture with mean and deviation of the window around every pixel.
pub(super) struct WindowStatistics {
    pub(super) image: Image<f32>,
    means: Vec<f32>,
    /// `1 / √(variance + noise)`.
    sharpness: Vec<f32>,
    half: usize,
}

impl WindowStatistics {
    /// Windows of `2 half + 1` pixels a side.
    pub(super) fn new(image: Image<f32>, half: usize) -> Self {
        let (width, height) = (image.width, image.height);
        let squares: Vec<f32> = image.data.iter().map(|v| v * v).collect();
        let means = window_means(&image.data, width, height, half);
        let squares = window_means(&squares, width, height, half);
        let sharpness = means.iter().zip(squares).map(|(m, s)| inverse_spread(*m, s)).collect();
        Self { image, means, sharpness, half }
    }

    /// Costs `1 - correlation` with the windows of another picture of the same size, in [0, 1];
    /// flat windows cost 1.
    pub(super) fn costs(&self, other: &[f32]) -> Vec<f32> {
        let (width, height) = (self.image.width, self.image.height);
        let squares: Vec<f32> = other.iter().map(|v| v * v).collect();
        let products: Vec<f32> = other.iter().zip(&self.image.data).map(|(a, b)| a * b).collect();
        let [means, squares, products] =
            [other, &squares, &products].map(|plane| window_means(plane, width, height, self.half));
        (0..width * height)
            .map(|i| {
                let covariance = products[i] - self.means[i] * means[i];
                let spread = self.sharpness[i] * inverse_spread(means[i], squares[i]);
                (1.0 - covariance * spread).clamp(0.0, 1.0)
            })
            .collect()
    }
}

fn inverse_spread(mean: f32, mean_square: f32) -> f32 {
    ((mean_square - mean * mean).max(0.0) + WINDOW_NOISE_VARIANCE).sqrt().recip()
}

/// Window means; the border value is repeated beyond the border.
fn window_means(plane: &[f32], width: usize, height: usize, half: usize) -> Vec<f32> {
    let side = 2 * half + 1;
    let mut rows = vec![0.0; plane.len()];
    for (from, to) in plane.chunks_exact(width).zip(rows.chunks_exact_mut(width)) {
        let padded = |i: usize| from[i.saturating_sub(half).min(width - 1)];
        for (column, sum) in to.iter_mut().enumerate() {
            let inside = column >= half && column + half < width;
            *sum = match inside {
                true => from[column - half..=column + half].iter().sum(),
                false => (column..column + side).map(padded).sum(),
            };
        }
    }
    let scale = 1.0 / (side * side) as f32;
    let mut out = vec![0.0; plane.len()];
    for (row, to) in out.chunks_exact_mut(width).enumerate() {
        for k in row..row + side {
            let from = k.saturating_sub(half).min(height - 1) * width;
            to.iter_mut().zip(&rows[from..from + width]).for_each(|(sum, value)| *sum += value);
        }
        to.iter_mut().for_each(|sum| *sum *= scale);
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(of: impl Fn(f32, f32) -> f32) -> Image<f32> {
        let mut out = Image::new(24, 18, 1);
        for (i, value) in out.data.iter_mut().enumerate() {
            *value = of((i % 24) as f32, (i / 24) as f32);
        }
        out
    }

    #[test]
    fn gain_and_bias_change_nothing_and_flat_windows_say_nothing() {
        let wave = |x: f32, y: f32| 0.5 + 0.3 * (0.9 * x).sin() * (0.7 * y).cos();
        let windows = WindowStatistics::new(picture(wave), 2);
        let brighter = picture(|x, y| 0.1 + 0.6 * wave(x, y));
        assert!(windows.costs(&brighter.data).iter().all(|c| *c < 0.02));
        let shifted = picture(|x, y| wave(x + 2.0, y));
        assert!(windows.costs(&shifted.data).iter().sum::<f32>() > 0.5 * 24.0 * 18.0);
        assert!(windows.costs(&picture(|_, _| 0.4).data).iter().all(|c| *c > 0.9));
    }

    #[test]
    fn means_repeat_the_border() {
        let plane = picture(|x, _| x);
        let means = window_means(&plane.data, 24, 18, 2);
        assert!((means[0] - 0.6).abs() < 1e-5 && (means[5 * 24 + 10] - 10.0).abs() < 1e-5);
    }
}

//! The image term: `(1 - s) L1 + s (1 - SSIM)`, its value and its derivative by the picture.

use super::window::filter;
use i2slam_geometry::{Image, Real};
use rayon::prelude::*;

/// SSIM's constants for pictures in `[0, 1]` (Wang et al. 2004).
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// The observed picture with the window means that SSIM needs at every step.
#[derive(Clone, Debug)]
pub(crate) struct SsimReference<T = f32> {
    mean: Vec<Vec<T>>,
    second: Vec<Vec<T>>,
}

impl<T: Real> SsimReference<T> {
    pub(crate) fn new(observed: &Image<T>) -> Self {
        let planes: Vec<_> = (0..observed.channels).map(|c| observed.plane(c)).collect();
        let square = |p: &&[T]| p.iter().map(|&v| v * v).collect::<Vec<_>>();
        Self {
            mean: planes.iter().map(|p| filter(p, observed.width)).collect(),
            second: planes.iter().map(|p| filter(&square(p), observed.width)).collect(),
        }
    }
}

/// Mean over pixels and channels of `(1 - share) |C - Ĉ| + share (1 - SSIM)`, times `weight`;
/// the derivative is written to `d_picture`. Returns the unweighted L1 beside the weighted sum.
pub(crate) fn image_loss<T: Real>(
    picture: &Image<T>,
    observed: &Image<T>,
    reference: &SsimReference<T>,
    share: f32,
    weight: f32,
    d_picture: &mut Image<T>,
) -> (f64, f64) {
    d_picture.reset(picture.width, picture.height, picture.channels);
    let count = picture.data.len() as f64;
    let (share, weight) = (f64::from(share), f64::from(weight));
    let parts: Vec<(f64, f64)> = d_picture
        .data
        .par_chunks_mut(picture.pixels())
        .enumerate()
        .map(|(channel, gradient)| {
            let (x, y) = (picture.plane(channel), observed.plane(channel));
            let l1 = absolute(x, y, T::of(weight * (1.0 - share) / count), gradient);
            let scale = T::of(-weight * share / count);
            let similarity = if share > 0.0 {
                let (mean, second) = (&reference.mean[channel], &reference.second[channel]);
                structural(x, y, mean, second, picture.width, scale, gradient)
            } else {
                x.len() as f64
            };
            (l1, x.len() as f64 - similarity)
        })
        .collect();
    let (l1, dissimilarity) = parts.iter().fold((0.0, 0.0), |s, p| (s.0 + p.0, s.1 + p.1));
    let (l1, dissimilarity) = (l1 / count, dissimilarity / count);
    (weight * ((1.0 - share) * l1 + share * dissimilarity), l1)
}

/// `Σ |x - y|`; adds `scale · sign(x - y)` to the gradient.
fn absolute<T: Real>(x: &[T], y: &[T], scale: T, gradient: &mut [T]) -> f64 {
    let mut sum = 0.0;
    for ((&x, &y), g) in x.iter().zip(y).zip(gradient) {
        let d = x - y;
        sum += d.abs().to_f64();
        if d != T::zero() {
            *g += scale * d.signum();
        }
    }
    sum
}

/// `Σ SSIM(x, y)` over pixels; adds `scale · ∂Σ/∂x` to the gradient.
///
/// With `A1 = 2 μx μy + C1`, `A2 = 2 σxy + C2`, `B1 = μx² + μy² + C1`, `B2 = σx² + σy² + C2`,
/// `S = A1 A2 / (B1 B2)` and window `G`, the pull-back of `G x`, `G x²` and `G xy` is
/// `G(∂S/∂μx) + 2 x G(∂S/∂σx²) + y G(∂S/∂σxy)`, where `∂S/∂μx` includes its way through
/// `σx² = G x² - μx²` and `σxy = G xy - μx μy`.
fn structural<T: Real>(
    x: &[T],
    y: &[T],
    mean_y: &[T],
    second_y: &[T],
    width: usize,
    scale: T,
    gradient: &mut [T],
) -> f64 {
    let (c1, c2, two) = (T::of(C1), T::of(C2), T::of(2.0));
    let mean_x = filter(x, width);
    let second_x = filter(&x.iter().map(|&v| v * v).collect::<Vec<_>>(), width);
    let cross = filter(&x.iter().zip(y).map(|(&x, &y)| x * y).collect::<Vec<_>>(), width);
    let (mut by_mean, mut by_second, mut by_cross) = (mean_x, second_x, cross);
    let mut sum = 0.0;
    for i in 0..x.len() {
        let (mx, my) = (by_mean[i], mean_y[i]);
        let a1 = two * mx * my + c1;
        let a2 = two * (by_cross[i] - mx * my) + c2;
        let b1 = mx * mx + my * my + c1;
        let b2 = by_second[i] - mx * mx + second_y[i] - my * my + c2;
        let s = a1 * a2 / (b1 * b2);
        sum += s.to_f64();
        by_second[i] = -s / b2;
        by_cross[i] = two * a1 / (b1 * b2);
        by_mean[i] =
            two * (my * a2 / (b1 * b2) - mx * s / b1) - two * mx * by_second[i] - my * by_cross[i];
    }
    let planes = [by_mean, by_second, by_cross].map(|p| filter(&p, width));
    for i in 0..x.len() {
        gradient[i] += scale * (planes[0][i] + two * x[i] * planes[1][i] + y[i] * planes[2][i]);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::assert_gradient;

    fn picture(seed: u64) -> Image<f64> {
        let data = i2slam_check::noise(seed, 16 * 14 * 3);
        let data = data.iter().map(|v| 0.5 + 0.4 * v).collect();
        Image { width: 16, height: 14, channels: 3, data }
    }

    fn loss(x: &Image<f64>, y: &Image<f64>, share: f32) -> (f64, Image<f64>) {
        let mut gradient = Image::default();
        let value = image_loss(x, y, &SsimReference::new(y), share, 0.5, &mut gradient).0;
        (value, gradient)
    }

    #[test]
    fn equal_pictures_cost_nothing() {
        assert!(loss(&picture(1), &picture(1), 0.2).0.abs() < 1e-12);
    }

    #[test]
    fn the_derivative_agrees_with_differences() {
        let (x, y) = (picture(1), picture(2));
        for share in [0.0, 0.2, 1.0] {
            let gradient = loss(&x, &y, share).1;
            assert_gradient("image loss", &x.data, &gradient.data, 1e-5, 1e-6, |data| {
                loss(&Image { data: data.to_vec(), ..x.clone() }, &y, share).0
            });
        }
    }
}

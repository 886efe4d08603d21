//! Image and depth terms of the objective (eqs. 12 to 14) with their derivatives.

use super::Observation;
use super::ssim::{Ssim, SsimReference};
use i2slam_geometry::{Image, Real};
use rayon::prelude::*;

/// Comparison of a predicted picture with the one taken: `weight` times the mean over pixels and channels
/// of `(1 - ssim_share) ρ(C - Ĉ) + ssim_share (1 - SSIM)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImageLoss {
    /// `ρ`.
    pub pixel: PixelLoss,
    /// Share of the structural dissimilarity.
    pub ssim_share: f32,
    /// Weight against other terms.
    pub weight: f32,
}

/// Loss of a single pixel and channel whose picture values differ by `e`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelLoss {
    /// `|e|` (SplaTAM).
    Absolute,
    /// `(δ²/ε) (√(1 + (e/δ)²) - 1)` (Charbonnier; pseudo-Huber): a square up to `δ` = 0.1, without a kink
    /// where pictures agree and with a slope that grows with the error, and linear beyond. At `ε` = 0.02 its
    /// slope is that of the absolute difference, far beyond `δ` five times that.
    PseudoHuber,
}

/// `δ` and `ε` of [`PixelLoss::PseudoHuber`].
const LINEAR_FROM: f64 = 0.1;
const UNIT_SLOPE_AT: f64 = 0.02;

impl PixelLoss {
    /// Loss of a difference, and its derivative.
    fn value_and_slope<T: Real>(self, difference: T) -> (T, T) {
        match self {
            Self::Absolute if difference == T::zero() => (T::zero(), T::zero()),
            Self::Absolute => (difference.abs(), difference.signum()),
            Self::PseudoHuber => {
                let ratio = difference * T::of(1.0 / LINEAR_FROM);
                let root = (T::one() + ratio * ratio).sqrt();
                let slope = difference * T::of(1.0 / UNIT_SLOPE_AT) / root;
                // root - 1 without cancellation.
                let square = difference * difference * T::of(1.0 / UNIT_SLOPE_AT);
                (square / (root + T::one()), slope)
            }
        }
    }
}

/// The [`ImageLoss`], and the mean of `|C - Ĉ|` alone. Writes the derivative of the first to `d_picture`.
pub(crate) fn image_loss<T: Real>(
    picture: &Image<T>,
    observed: &Image<T>,
    reference: &SsimReference<T>,
    loss: ImageLoss,
    ssim: &mut Ssim<T>,
    d_picture: &mut Image<T>,
) -> (f64, f64) {
    d_picture.reset(picture.width, picture.height, picture.channels);
    let count = picture.data.len() as f64;
    let (share, weight) = (f64::from(loss.ssim_share), f64::from(loss.weight));
    let scale = T::of(weight * (1.0 - share) / count);
    let (data, gradient) = ((&picture.data[..], &observed.data[..]), &mut d_picture.data);
    let [pixels, l1] = pixel_losses(loss.pixel, data, scale, gradient).map(|sum| sum / count);
    let mut dissimilarity = 0.0;
    if share > 0.0 {
        let (scale, gradient) = (T::of(-weight * share / count), &mut d_picture.data);
        let sum = ssim.pull_back(picture, observed, reference, scale, gradient);
        dissimilarity = (count - sum) / count;
    }
    (weight * ((1.0 - share) * pixels + share * dissimilarity), l1)
}

/// Parts of the sum of differences; fixed, so that the sum does not depend on the number of threads.
const PARTS: usize = 8;

/// `Σ ρ(x - y)` and `Σ |x - y|`; adds `scale` times the derivative of the first to the gradient.
fn pixel_losses<T: Real>(
    loss: PixelLoss,
    (x, y): (&[T], &[T]),
    scale: T,
    gradient: &mut [T],
) -> [f64; 2] {
    let part = x.len().div_ceil(PARTS).max(1);
    let mut sums = [[0.0; 2]; PARTS];
    let work = x.par_chunks(part).zip(y.par_chunks(part)).zip(gradient.par_chunks_mut(part));
    work.zip(&mut sums).for_each(|(((x, y), gradient), sums)| {
        for ((&x, &y), g) in x.iter().zip(y).zip(gradient) {
            let (value, slope) = loss.value_and_slope(x - y);
            sums[0] += value.to_f64();
            sums[1] += (x - y).abs().to_f64();
            *g += scale * slope;
        }
    });
    std::array::from_fn(|k| sums.iter().map(|sums| sums[k]).sum())
}

/// `Σ w |d - d̂|` over the pixels of `mask`, weighted by [`Observation::depth_weight`] (eq. 14).
pub(super) fn depth_error(rendered: &Image<f32>, observation: &Observation, mask: &[bool]) -> f64 {
    let width = rendered.width.max(1);
    let rows = rendered.data.par_chunks(width).zip(observation.depth.data.par_chunks(width));
    let sums: Vec<f64> = rows
        .zip(mask.par_chunks(width))
        .enumerate()
        .map(|(row, ((r, o), m))| {
            let pixels = r.iter().zip(o).zip(m).enumerate().filter(|(_, (_, m))| **m);
            let weight = |column: usize| f64::from(observation.depth_weight(row * width + column));
            pixels.map(|(c, ((r, o), _))| weight(c) * f64::from((r - o).abs())).sum()
        })
        .collect();
    sums.iter().sum()
}

/// Pixels of a parallel task, at least.
const MIN_TASK_PIXELS: usize = 8192;

/// Writes the derivative of `weight` times [`depth_error`] to `d_depth`.
pub(super) fn depth_gradient(
    rendered: &Image<f32>,
    observation: &Observation,
    mask: &[bool],
    weight: f32,
    d_depth: &mut Image<f32>,
) {
    d_depth.reshape(rendered.width, rendered.height, 1);
    let pixels = d_depth.data.par_iter_mut().enumerate().with_min_len(MIN_TASK_PIXELS);
    pixels.for_each(|(i, g)| {
        let difference = rendered.data[i] - observation.depth.data[i];
        *g = match mask[i] && difference != 0.0 {
            true => (weight * observation.depth_weight(i)).copysign(difference),
            false => 0.0,
        };
    });
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

    fn loss(
        x: &Image<f64>,
        y: &Image<f64>,
        pixel: PixelLoss,
        ssim_share: f32,
    ) -> (f64, Image<f64>) {
        let mut gradient = Image::default();
        let (reference, mut ssim) = (SsimReference::new(y), Ssim::default());
        let loss = ImageLoss { pixel, ssim_share, weight: 0.5 };
        let value = image_loss(x, y, &reference, loss, &mut ssim, &mut gradient).0;
        (value, gradient)
    }

    #[test]
    fn equal_pictures_have_no_loss() {
        for pixel in [PixelLoss::Absolute, PixelLoss::PseudoHuber] {
            assert!(loss(&picture(1), &picture(1), pixel, 0.2).0.abs() < 1e-12);
        }
    }

    #[test]
    fn the_derivative_agrees_with_differences() {
        let (x, y) = (picture(1), picture(2));
        for pixel in [PixelLoss::Absolute, PixelLoss::PseudoHuber] {
            for share in [0.0, 0.2, 1.0] {
                let gradient = loss(&x, &y, pixel, share).1;
                assert_gradient("image loss", &x.data, &gradient.data, 1e-5, 1e-6, |data| {
                    loss(&Image { data: data.to_vec(), ..x.clone() }, &y, pixel, share).0
                });
            }
        }
    }

    #[test]
    fn a_smooth_loss_is_a_square_near_zero_and_linear_far_away() {
        let of = |difference: f64| PixelLoss::PseudoHuber.value_and_slope(difference);
        assert!((of(1e-4).0 - 0.5 * 1e-8 / UNIT_SLOPE_AT).abs() < 1e-12);
        assert!((of(UNIT_SLOPE_AT).1 - 1.0).abs() < 0.03);
        assert!((of(-100.0).1 + LINEAR_FROM / UNIT_SLOPE_AT).abs() < 1e-4);
        assert_eq!(PixelLoss::Absolute.value_and_slope(0.0_f64), (0.0, 0.0));
    }

    fn row(data: [f32; 3]) -> Image<f32> {
        Image { width: 3, height: 1, channels: 1, data: data.to_vec() }
    }

    /// Loss and derivative, for a weight of 2, of the first and the last pixel.
    fn depth_loss(rendered: [f32; 3], observation: &Observation) -> (f64, Vec<f32>) {
        let (rendered, mask, mut d) = (row(rendered), [true, false, true], Image::default());
        depth_gradient(&rendered, observation, &mask, 2.0, &mut d);
        (depth_error(&rendered, observation, &mask), d.data)
    }

    #[test]
    fn depth_counts_only_masked_pixels() {
        let observation = Observation::new(Image::new(3, 1, 3), row([1.5, 0.0, 2.0]));
        let (error, d) = depth_loss([1.0, 2.0, 3.0], &observation);
        assert!((error - 1.5).abs() < 1e-6);
        assert_eq!(d, vec![-2.0, 0.0, 2.0]);
    }

    /// Deviations of 0.3 and 1.2 % of the depth: full weight, and a quarter.
    #[test]
    fn estimated_depth_counts_by_its_deviation() {
        let (depth, variance) = (row([1.0, 0.0, 2.0]), row([9e-6, 1.0, 5.76e-4]));
        let observation = Observation::estimated(Image::new(3, 1, 3), depth, variance);
        let (error, d) = depth_loss([2.0, 1.0, 4.0], &observation);
        assert!((error - 1.5).abs() < 1e-5);
        assert!((d[0] - 2.0).abs() < 1e-5 && (d[2] - 0.5).abs() < 1e-5);
    }
}

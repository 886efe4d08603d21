//! The image term: `(1 - s) L1 + s (1 - SSIM)`, its value and its derivative by the picture.

use super::window::filter;
use i2slam_geometry::Image;
use rayon::prelude::*;

/// SSIM's constants for pictures in `[0, 1]` (Wang et al. 2004).
const C1: f32 = 0.01 * 0.01;
const C2: f32 = 0.03 * 0.03;

/// The observed picture with the window means that SSIM needs at every step.
#[derive(Clone, Debug)]
pub(crate) struct SsimReference {
    mean: Vec<Vec<f32>>,
    second: Vec<Vec<f32>>,
}

impl SsimReference {
    pub(crate) fn new(observed: &Image<f32>) -> Self {
        let planes: Vec<_> = (0..observed.channels).map(|c| observed.plane(c)).collect();
        let square = |p: &&[f32]| p.iter().map(|v| v * v).collect::<Vec<_>>();
        Self {
            mean: planes.iter().map(|p| filter(p, observed.width)).collect(),
            second: planes.iter().map(|p| filter(&square(p), observed.width)).collect(),
        }
    }
}

/// Mean over pixels and channels of `(1 - share) |C - Ĉ| + share (1 - SSIM)`, times `weight`;
/// the derivative is written to `d_picture`. Returns the unweighted L1 beside the weighted sum.
pub(crate) fn image_loss(
    picture: &Image<f32>,
    observed: &Image<f32>,
    reference: &SsimReference,
    share: f32,
    weight: f32,
    d_picture: &mut Image<f32>,
) -> (f64, f64) {
    d_picture.reset(picture.width, picture.height, picture.channels);
    let count = picture.data.len() as f32;
    let parts: Vec<(f64, f64)> = d_picture
        .data
        .par_chunks_mut(picture.pixels())
        .enumerate()
        .map(|(channel, gradient)| {
            let (x, y) = (picture.plane(channel), observed.plane(channel));
            let l1 = absolute(x, y, weight * (1.0 - share) / count, gradient);
            let scale = -weight * share / count;
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
    let (l1, dissimilarity) = (l1 / f64::from(count), dissimilarity / f64::from(count));
    let share = f64::from(share);
    (f64::from(weight) * ((1.0 - share) * l1 + share * dissimilarity), l1)
}

/// `Σ |x - y|`; adds `scale · sign(x - y)` to the gradient.
fn absolute(x: &[f32], y: &[f32], scale: f32, gradient: &mut [f32]) -> f64 {
    let mut sum = 0.0;
    for ((x, y), g) in x.iter().zip(y).zip(gradient) {
        let d = x - y;
        sum += f64::from(d.abs());
        *g += if d == 0.0 { 0.0 } else { scale.copysign(d) };
    }
    sum
}

/// `Σ SSIM(x, y)` over pixels; adds `scale · ∂Σ/∂x` to the gradient.
///
/// With `A1 = 2 μx μy + C1`, `A2 = 2 σxy + C2`, `B1 = μx² + μy² + C1`, `B2 = σx² + σy² + C2`,
/// `S = A1 A2 / (B1 B2)` and window `G`, the pull-back of `G x`, `G x²` and `G xy` is
/// `G(∂S/∂μx) + 2 x G(∂S/∂σx²) + y G(∂S/∂σxy)`, where `∂S/∂μx` includes its way through
/// `σx² = G x² - μx²` and `σxy = G xy - μx μy`.
fn structural(
    x: &[f32],
    y: &[f32],
    mean_y: &[f32],
    second_y: &[f32],
    width: usize,
    scale: f32,
    gradient: &mut [f32],
) -> f64 {
    let mean_x = filter(x, width);
    let second_x = filter(&x.iter().map(|v| v * v).collect::<Vec<_>>(), width);
    let cross = filter(&x.iter().zip(y).map(|(x, y)| x * y).collect::<Vec<_>>(), width);
    let (mut by_mean, mut by_second, mut by_cross) = (mean_x, second_x, cross);
    let mut sum = 0.0;
    for i in 0..x.len() {
        let (mx, my) = (by_mean[i], mean_y[i]);
        let a1 = 2.0 * mx * my + C1;
        let a2 = 2.0 * (by_cross[i] - mx * my) + C2;
        let b1 = mx * mx + my * my + C1;
        let b2 = by_second[i] - mx * mx + second_y[i] - my * my + C2;
        let s = a1 * a2 / (b1 * b2);
        sum += f64::from(s);
        by_second[i] = -s / b2;
        by_cross[i] = 2.0 * a1 / (b1 * b2);
        by_mean[i] =
            2.0 * (my * a2 / (b1 * b2) - mx * s / b1) - 2.0 * mx * by_second[i] - my * by_cross[i];
    }
    let planes = [by_mean, by_second, by_cross].map(|p| filter(&p, width));
    for i in 0..x.len() {
        gradient[i] += scale * (planes[0][i] + 2.0 * x[i] * planes[1][i] + y[i] * planes[2][i]);
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn picture(seed: u64) -> Image<f32> {
        let data = i2slam_check::noise(seed, 16 * 14 * 3);
        let data = data.iter().map(|v| (0.5 + 0.4 * v) as f32).collect();
        Image { width: 16, height: 14, channels: 3, data }
    }

    fn loss(x: &Image<f32>, y: &Image<f32>, share: f32) -> (f64, Image<f32>) {
        let mut gradient = Image::default();
        let value = image_loss(x, y, &SsimReference::new(y), share, 0.5, &mut gradient).0;
        (value, gradient)
    }

    #[test]
    fn equal_pictures_cost_nothing() {
        assert!(loss(&picture(1), &picture(1), 0.2).0.abs() < 1e-6);
    }

    #[test]
    fn the_derivative_agrees_with_differences() {
        let (x, y) = (picture(1), picture(2));
        for share in [0.0, 0.2, 1.0] {
            let gradient = loss(&x, &y, share).1;
            for i in [0, 100, 223, 400, 671] {
                let step = 2e-2;
                let at = |offset: f32| {
                    let mut moved = x.clone();
                    moved.data[i] += offset;
                    loss(&moved, &y, share).0
                };
                let numeric = (at(step) - at(-step)) / (2.0 * f64::from(step));
                let analytic = f64::from(gradient.data[i]);
                let scale = gradient.data.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
                assert!((numeric - analytic).abs() < 2e-2 * f64::from(scale), "{share} {i}");
            }
        }
    }
}

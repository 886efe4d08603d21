//! The image term: `(1 - s) L1 + s (1 - SSIM)`, its value and its derivative by the picture.

pub(crate) use super::ssim::{Similarity, SsimReference};
use i2slam_geometry::{Image, Real};
use rayon::prelude::*;

/// Mean over pixels and channels of `(1 - share) |C - Ĉ| + share (1 - SSIM)`, times `weight`;
/// the derivative is written to `d_picture`. Returns the unweighted L1 beside the weighted sum.
pub(crate) fn image_loss<T: Real>(
    picture: &Image<T>,
    observed: &Image<T>,
    reference: &SsimReference<T>,
    share: f32,
    weight: f32,
    similarity: &mut Similarity<T>,
    d_picture: &mut Image<T>,
) -> (f64, f64) {
    d_picture.reset(picture.width, picture.height, picture.channels);
    let count = picture.data.len() as f64;
    let (share, weight) = (f64::from(share), f64::from(weight));
    let scale = T::of(weight * (1.0 - share) / count);
    let l1 = absolute(&picture.data, &observed.data, scale, &mut d_picture.data) / count;
    let mut dissimilarity = 0.0;
    if share > 0.0 {
        let (scale, gradient) = (T::of(-weight * share / count), &mut d_picture.data);
        let sum = similarity.pull_back(picture, observed, reference, scale, gradient);
        dissimilarity = (count - sum) / count;
    }
    (weight * ((1.0 - share) * l1 + share * dissimilarity), l1)
}

/// Parts of the sum of absolute differences: fixed, so that it does not depend on the number of
/// threads.
const PARTS: usize = 8;

/// `Σ |x - y|`; adds `scale · sign(x - y)` to the gradient.
fn absolute<T: Real>(x: &[T], y: &[T], scale: T, gradient: &mut [T]) -> f64 {
    let part = x.len().div_ceil(PARTS).max(1);
    let mut sums = [0.0; PARTS];
    let work = x.par_chunks(part).zip(y.par_chunks(part)).zip(gradient.par_chunks_mut(part));
    work.zip(&mut sums).for_each(|(((x, y), gradient), sum)| {
        for ((&x, &y), g) in x.iter().zip(y).zip(gradient) {
            let d = x - y;
            *sum += d.abs().to_f64();
            if d != T::zero() {
                *g += scale * d.signum();
            }
        }
    });
    sums.iter().sum()
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
        let value = image_loss(
            x,
            y,
            &SsimReference::new(y),
            share,
            0.5,
            &mut Similarity::default(),
            &mut gradient,
        )
        .0;
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

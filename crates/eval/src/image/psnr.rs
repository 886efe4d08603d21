//! Peak signal-to-noise ratio, peak 1: `PSNR = -10 log10(MSE)` [dB].

use super::{check_mask, check_shapes};
use crate::EvalError;
use i2slam_geometry::Image;

/// PSNR [dB] of one mean square error over all pixels and channels; `+∞` for equal pictures.
pub fn psnr(picture: &Image<f32>, truth: &Image<f32>) -> Result<f64, EvalError> {
    check_shapes(picture, truth)?;
    decibel(squares(&picture.data, &truth.data) / truth.data.len() as f64)
}

/// The mean over channels of each channel's PSNR [dB], as 3DGS and SplaTAM compute it.
/// Never below [`psnr`] (the logarithm is concave).
pub fn psnr_channel_mean(picture: &Image<f32>, truth: &Image<f32>) -> Result<f64, EvalError> {
    check_shapes(picture, truth)?;
    let pixels = truth.pixels() as f64;
    let channel = |c| decibel(squares(picture.plane(c), truth.plane(c)) / pixels);
    let sum = (0..truth.channels).map(channel).sum::<Result<f64, _>>()?;
    Ok(sum / truth.channels as f64)
}

/// PSNR [dB] over the pixels where `mask` (one entry per pixel, row by row) is true.
pub fn psnr_masked(
    picture: &Image<f32>,
    truth: &Image<f32>,
    mask: &[bool],
) -> Result<f64, EvalError> {
    check_shapes(picture, truth)?;
    check_mask(mask, truth)?;
    let inside = mask.iter().filter(|&&m| m).count();
    if inside == 0 {
        return Err(EvalError::TooFew { what: "pixels in the mask", found: 0, needed: 1 });
    }
    let square = |c| masked_squares(picture.plane(c), truth.plane(c), mask);
    let sum: f64 = (0..truth.channels).map(square).sum();
    decibel(sum / (inside * truth.channels) as f64)
}

/// PSNR as MonoGS's evaluation reports it [dB]: one mean square error over the *values* (pixel and
/// channel) where the true picture is above zero. A truth that is black throughout is refused.
pub fn psnr_monogs(picture: &Image<f32>, truth: &Image<f32>) -> Result<f64, EvalError> {
    check_shapes(picture, truth)?;
    let lit: Vec<bool> = truth.data.iter().map(|v| *v > 0.0).collect();
    let count = lit.iter().filter(|l| **l).count();
    if count == 0 {
        return Err(EvalError::TooFew { what: "true values above zero", found: 0, needed: 1 });
    }
    decibel(masked_squares(&picture.data, &truth.data, &lit) / count as f64)
}

fn squares(a: &[f32], b: &[f32]) -> f64 {
    a.iter().zip(b).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum()
}

fn masked_squares(a: &[f32], b: &[f32], mask: &[bool]) -> f64 {
    let difference = |(&a, &b): (&f32, &f32)| (f64::from(a) - f64::from(b)).powi(2);
    a.iter().zip(b).zip(mask).filter(|&(_, &m)| m).map(|(pair, _)| difference(pair)).sum()
}

/// `-10 log10(mse)`; a mean square error that is not finite betrays a NaN or infinity.
pub(crate) fn decibel(mse: f64) -> Result<f64, EvalError> {
    if mse.is_finite() {
        Ok(-10.0 * mse.log10())
    } else {
        Err(EvalError::NotFinite { what: "the pictures" })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grey(values: &[f32]) -> Image<f32> {
        Image { width: values.len(), height: 1, channels: 1, data: values.to_vec() }
    }

    fn colour(width: usize, planes: &[&[f32]]) -> Image<f32> {
        Image { width, height: 1, channels: planes.len(), data: planes.concat() }
    }

    #[test]
    fn by_hand() {
        let value = psnr(&grey(&[0.5, 0.6]), &grey(&[0.4, 0.5])).unwrap();
        assert!((value - 20.0).abs() < 1e-5);
        assert_eq!(psnr(&grey(&[0.5]), &grey(&[0.5])).unwrap(), f64::INFINITY);
    }

    #[test]
    fn channel_mean_averages_decibels() {
        let truth = colour(2, &[&[0.0, 0.0], &[0.0, 0.0]]);
        let picture = colour(2, &[&[0.1, 0.1], &[0.01, 0.01]]);
        assert!((psnr_channel_mean(&picture, &truth).unwrap() - 30.0).abs() < 1e-5);
        let whole = -10.0 * (0.5_f64 * (0.01 + 0.0001)).log10();
        assert!((psnr(&picture, &truth).unwrap() - whole).abs() < 1e-5);
    }

    #[test]
    fn masks() {
        let (truth, picture) = (grey(&[0.0; 4]), grey(&[0.1, 0.1, f32::NAN, 0.9]));
        let mask = [true, true, false, false];
        assert!((psnr_masked(&picture, &truth, &mask).unwrap() - 20.0).abs() < 1e-5);
    }

    #[test]
    fn psnr_of_monogs_ignores_black_values_of_the_truth() {
        let (truth, picture) = (grey(&[0.0, 0.5, 0.5]), grey(&[0.9, 0.4, 0.6]));
        assert!((psnr_monogs(&picture, &truth).unwrap() - 20.0).abs() < 1e-5);
        let black = psnr_monogs(&picture, &grey(&[0.0; 3]));
        assert!(matches!(black, Err(EvalError::TooFew { .. })));
    }

    #[test]
    fn poison_is_refused() {
        let truth = grey(&[0.0, 0.1]);
        let poisoned = psnr(&grey(&[f32::NAN, 0.1]), &truth);
        assert!(matches!(poisoned, Err(EvalError::NotFinite { .. })));
        let shape = |r| matches!(r, Err(EvalError::ShapeMismatch { .. }));
        assert!(shape(psnr(&grey(&[0.1]), &truth)));
        assert!(shape(psnr_masked(&truth, &truth, &[true])));
        let torn = Image { data: vec![0.0], ..truth.clone() };
        assert!(shape(psnr(&torn, &truth)));
        let few = |r| matches!(r, Err(EvalError::TooFew { .. }));
        assert!(few(psnr_masked(&truth, &truth, &[false, false])));
        assert!(few(psnr(&grey(&[]), &grey(&[]))));
    }
}

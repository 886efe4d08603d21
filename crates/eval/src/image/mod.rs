//! Picture errors: PSNR, SSIM, MS-SSIM, LPIPS of display-referred pictures in `[0, 1]`.
//!
//! Values outside `[0, 1]` are not clamped: clamp a render first to evaluate it as displayed.

mod lpips;
mod psnr;
mod ssim;

pub use lpips::lpips;
pub use psnr::{psnr, psnr_channel_mean, psnr_masked, psnr_monogs};
pub use ssim::{ms_ssim, ssim, ssim_padded};

use crate::EvalError;
use i2slam_geometry::Image;

/// An error for images of different or empty shape, or of data that do not match their shape.
pub(crate) fn check_shapes(picture: &Image<f32>, truth: &Image<f32>) -> Result<(), EvalError> {
    let shape = |i: &Image<f32>| vec![i.width, i.height, i.channels];
    if shape(picture) != shape(truth) {
        let (first, second) = (shape(picture), shape(truth));
        return Err(EvalError::ShapeMismatch { what: "pictures", first, second });
    }
    let values = truth.width * truth.height * truth.channels;
    for image in [picture, truth] {
        if image.data.len() != values {
            let (first, second) = (vec![image.data.len()], vec![values]);
            return Err(EvalError::ShapeMismatch { what: "picture and its data", first, second });
        }
    }
    if values == 0 {
        return Err(EvalError::TooFew { what: "pixels", found: 0, needed: 1 });
    }
    Ok(())
}

/// An error for an image whose shorter side has fewer pixels than needed.
pub(crate) fn check_side(image: &Image<f32>, needed: usize) -> Result<(), EvalError> {
    match image.width.min(image.height) {
        found if found < needed => {
            Err(EvalError::TooFew { what: "pixels along the shorter side", found, needed })
        }
        _ => Ok(()),
    }
}

/// An error for a mask that does not have one entry per pixel.
pub(crate) fn check_mask(mask: &[bool], truth: &Image<f32>) -> Result<(), EvalError> {
    if mask.len() == truth.width * truth.height {
        return Ok(());
    }
    let (first, second) = (vec![mask.len()], vec![truth.width * truth.height]);
    Err(EvalError::ShapeMismatch { what: "mask and picture", first, second })
}

/// Random images for tests.
#[cfg(test)]
mod noise {
    use i2slam_geometry::Image;

    /// Numbers in `[-1, 1]`.
    pub(crate) fn values(seed: u64, count: usize) -> Vec<f32> {
        i2slam_check::noise(seed, count).iter().map(|&v| v as f32).collect()
    }

    /// Planes in `[0, 1]`.
    pub(crate) fn picture(seed: u64, width: usize, height: usize, channels: usize) -> Image<f32> {
        let data = values(seed, width * height * channels).iter().map(|v| 0.5 + 0.5 * v).collect();
        Image { width, height, channels, data }
    }
}

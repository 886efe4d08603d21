//! Picture errors: PSNR, SSIM, MS-SSIM, LPIPS of display-referred pictures in `[0, 1]`.
//!
//! Values outside `[0, 1]` are measured as they are: clamp a render first if it is judged as it
//! would be shown.

mod lpips;
mod ms_ssim;
mod psnr;
mod ssim;

pub use lpips::lpips;
pub use ms_ssim::ms_ssim;
pub use psnr::{psnr, psnr_channel_mean, psnr_masked, psnr_monogs, psnr_splatam};
pub use ssim::{ssim, ssim_padded};

use crate::EvalError;
use i2slam_geometry::Image;

/// Refuses pictures of different or empty shape, or whose data do not fill their shape.
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

/// Refuses a mask that does not have one entry per pixel.
pub(crate) fn check_mask(mask: &[bool], truth: &Image<f32>) -> Result<(), EvalError> {
    if mask.len() == truth.width * truth.height {
        return Ok(());
    }
    let (first, second) = (vec![mask.len()], vec![truth.width * truth.height]);
    Err(EvalError::ShapeMismatch { what: "mask and picture", first, second })
}

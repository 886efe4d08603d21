//! The judge: how far a run is from the truth.
//!
//! Plain arrays in, numbers out. This crate knows neither the system that it grades, nor the
//! maps, nor the dataset reader; it reads no file and prints nothing. Every number carries its
//! unit in its name, and input that cannot be judged is an [`EvalError`], never a NaN:
//! the only value that is not finite is the PSNR of two equal pictures, `+∞`
//! (which JSON writes as `null`).
//!
//! * [`trajectory`]: association, alignment, absolute and relative pose errors.
//! * [`image`]: PSNR in its dialects, SSIM, MS-SSIM, LPIPS.
//! * [`hdr`]: errors of linear radiance after one gain, or one for each channel.
//! * [`exposure`]: agreement of recovered exposures with the true ones.
//! * [`depth`]: L1 over valid pixels.
//! * [`sharpness`], [`frame_list`]: which frames are sharp, and lists of frames.
//! * [`statistics`]: summaries of lists of numbers.

pub mod depth;
mod error;
pub mod exposure;
pub mod frame_list;
pub mod hdr;
pub mod image;
#[cfg(test)]
mod noise;
pub mod sharpness;
pub mod statistics;
pub mod trajectory;

pub use error::EvalError;

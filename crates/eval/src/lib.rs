//! Evaluation metrics for trajectories and images against ground truth.
//!
//! Plain arrays in, numbers out: no dependency on the evaluated system, the maps or the dataset
//! reader, no file access. Every number carries its unit in its name. Invalid input is an
//! [`EvalError`], never a NaN; the only value that is not finite is the PSNR of two equal images,
//! `+∞` (`null` in JSON).
//!
//! * [`trajectory`]: association, alignment, absolute and relative pose errors.
//! * [`image`]: PSNR in its variants, SSIM, MS-SSIM, LPIPS.
//! * [`hdr`]: errors of linear radiance after one gain, or one for each channel.
//! * [`exposure`]: agreement of recovered exposures with the true ones.
//! * [`depth`]: L1 over valid pixels.
//! * [`sharpness`], [`frame_list`]: selection of sharp frames, and lists of frames.
//! * [`statistics`]: summaries of lists of numbers.

pub mod depth;
mod error;
pub mod exposure;
pub mod frame_list;
pub mod hdr;
pub mod image;
pub mod sharpness;
pub mod statistics;
pub mod trajectory;

pub use error::EvalError;

//! Evaluation metrics for trajectories and images against ground truth.
//!
//! Plain arrays in, numbers out: no dependency on the evaluated system and no file access. Every
//! number carries its unit in its name. Invalid input is an [`EvalError`], never a NaN; only the
//! PSNR of two equal images is not finite, `+∞` (`null` in JSON).

pub mod depth;
mod error;
pub mod exposure;
pub mod frame_list;
pub mod hdr;
pub mod image;
pub mod sharpness;
pub mod splats;
pub mod statistics;
pub mod trajectory;
pub mod white_balance;

pub use error::EvalError;

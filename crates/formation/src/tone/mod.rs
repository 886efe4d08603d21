//! Exposure, white balance and camera response (eqs. 8 to 11).
//!
//! ```text
//! picture_c = CRF_leaky(exposure · white_balance_c · radiance_c)
//! ```
//!
//! [`FrameTone`] holds the gains of one frame, [`CameraResponse`] the parameters of the response,
//! and [`ResponseCurve`] the monotone curve that they stand for, tabulated for fast evaluation.

mod curve;
mod frame;
mod grid;
mod response;
mod start;
#[cfg(test)]
mod tests;

pub use curve::{CurveGradient, ResponseCurve};
pub use frame::{FrameTone, FrameToneGradient, WhiteBalanceModel};
pub use grid::NodeSpacing;
pub use response::CameraResponse;
pub use start::StartCurve;

pub(crate) use curve::{Segment, above_slope, below_slope, evaluate};
pub(crate) use grid::{Even, Grid, Locate};

/// Nodes of one response curve (the paper's 256-dimensional grid `g`).
pub const NODES: usize = 256;

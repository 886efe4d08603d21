//! What a pixel's value means: exposure, white balance and camera response (eqs. 8 to 11).
//!
//! ```text
//! picture_c = CRF_leaky(exposure · white_balance_c · radiance_c)
//! ```
//!
//! [`FrameTone`] holds the gains of one frame, [`CameraResponse`] the free numbers of the
//! response, and [`ResponseCurve`] the monotone curve that they stand for, ready to be looked up
//! hundreds of thousands of times.

mod clip;
mod curve;
mod frame;
mod grid;
mod inverse;
mod repair;
mod response;
mod spacing;
mod start;
#[cfg(test)]
mod tests;

pub use curve::{CurveGradient, ResponseCurve};
pub use frame::{FrameTone, FrameToneGradient, WhiteBalanceModel};
pub use response::CameraResponse;
pub use spacing::NodeSpacing;
pub use start::StartCurve;

pub(crate) use clip::{above_slope, above_value, below_slope, below_value};
pub(crate) use curve::{Segment, evaluate};
pub(crate) use grid::{Even, Grid, Locate};

/// Nodes of one response curve (the paper's 256-dimensional grid `g`).
pub const NODES: usize = 256;

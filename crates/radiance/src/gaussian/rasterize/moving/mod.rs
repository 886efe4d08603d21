//! Compositing of splats that move while the shutter is open.
//!
//! All moments share the list of a tile. A splat is visited once, with all moments at a time and
//! row by row: what it composites, its value times the sum of its weights over the moments, is
//! added once, and only transmittances are kept per moment. They start at the moment's weight
//! instead of 1, so that sums over the moments are averages.

mod clock;
mod cpu_backward;
mod cpu_forward;

pub(crate) use clock::Clock;
pub(crate) use cpu_backward::{MotionSlot, Picture, pull_back};
pub(crate) use cpu_forward::{Scene, render};

use super::tile::Row;
use crate::gaussian::bin::TILE;

/// Moments that are composited together, at most; what is more than that goes in further rounds.
pub(crate) const PACK: usize = 16;

/// What a tile's pixels keep of one moment.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct MomentPixels {
    /// Transmittance times the moment's weight, with the sign turned where pixels ended.
    transmittance: [Row; TILE],
    /// The place in the tile's list at which the pixel ended, or `f32::MAX`; -1 outside of the
    /// image.
    ended: [Row; TILE],
}

impl Default for MomentPixels {
    fn default() -> Self {
        Self { transmittance: [[0.0; TILE]; TILE], ended: [[0.0; TILE]; TILE] }
    }
}

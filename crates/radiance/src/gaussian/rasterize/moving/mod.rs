//! Compositing of splats that move while the shutter is open.
//!
//! All moments share the list of a tile. A splat is visited once, with all moments at a time and
//! row by row: what it composites, its value times the sum of its weights over the moments, is
//! added once, and only transmittances are kept per moment. They start at the moment's weight
//! instead of 1, so that sums over the moments are averages.

mod clock;
mod cpu_backward;
mod cpu_forward;
mod mover;
mod step;

pub(crate) use clock::Clock;
pub(crate) use cpu_backward::{Picture, pull_back};
pub(crate) use cpu_forward::{Scene, render};
pub(crate) use step::MotionSlot;

use super::tile::Row;
use crate::gaussian::bin::{TILE, TileGrid};

/// Moments that are composited together, at most; what is more than that goes in further rounds.
pub(crate) const PACK: usize = 16;

/// What one row of a tile keeps of one moment.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(crate) struct MomentRow {
    /// Transmittance times the moment's weight, with the sign turned where pixels ended.
    transmittance: Row,
    /// The place in the tile's list at which the pixel ended, or `f32::MAX`; -1 outside of the
    /// image.
    ended: Row,
}

/// [`MomentRow`]s of a tile: all moments of its first row, then of the second.
pub(crate) fn moment_rows(grid: &TileGrid, clock: &Clock) -> usize {
    grid.len() * TILE * clock.moments.len()
}

//! Compositing of splats that move while the shutter is open.
//!
//! All moments share the list of a tile. A splat is visited once, with all moments at a time and
//! row by row: what it composites, its value times the sum of its weights over the moments, is
//! added once, and only transmittances are kept per moment. They start at the moment's weight
//! instead of 1, so that sums over the moments are averages.

use super::tile::Row;
use crate::gaussian::bin::{TILE, TileGrid};
use crate::gaussian::{Moment, ShutterMotion};
use crate::shutter_motion::row_place;
use i2slam_compute::simd::Column;
use std::ops::Range;

mod cpu_backward;
mod cpu_forward;
mod moving_splat;

pub(crate) use cpu_backward::{MotionTileSums, Picture, pull_back};
pub(crate) use cpu_forward::{Scene, render};

/// Moments that are composited together, at most; what is more than that goes in further rounds.
pub(crate) const PACK: usize = 16;

/// State of one row of a tile at one moment.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub(crate) struct MomentRow {
    /// Transmittance times the moment's weight, with the sign turned where pixels ended.
    transmittance: Row,
    /// The place in the list at which the pixel ended, or `f32::MAX`; -1 outside of the image.
    ended: Row,
}

/// [`MomentRow`]s of a tile: all moments of its first row, then of the second.
pub(crate) fn moment_rows(grid: &TileGrid, row_times: &RowTimes) -> usize {
    grid.len() * TILE * row_times.moments.len()
}

/// The moments of a picture, ready for use.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct RowTimes {
    /// Weights are positive and sum to 1.
    pub(crate) moments: Vec<Moment>,
    readout: f32,
    height: usize,
}

impl RowTimes {
    pub(crate) fn new(motion: &ShutterMotion, height: usize) -> Self {
        Self { moments: motion.counted(), readout: motion.counted_readout(), height }
    }

    pub(super) fn packs(&self) -> impl Iterator<Item = Range<usize>> + use<> {
        let count = self.moments.len();
        (0..count).step_by(PACK).map(move |first| first..(first + PACK).min(count))
    }

    /// The times of a tile's rows at the moments of one pack.
    pub(super) fn tile(&self, pack: Range<usize>, grid: &TileGrid, number: usize) -> TileTimes {
        let row = number / grid.columns * TILE;
        let place = |row: usize| row_place::<f32>(row, self.height);
        let mut times = TileTimes {
            count: pack.len(),
            first: [0.0; PACK],
            step: self.readout / self.height as f32,
            places: std::array::from_fn(|j| place(row + j)),
        };
        for (first, moment) in times.first.iter_mut().zip(&self.moments[pack]) {
            *first = moment.time + self.readout * place(row);
        }
        times
    }
}

/// Times at which the rows of one tile are exposed.
pub(super) struct TileTimes {
    /// Moments of the pack.
    pub(super) count: usize,
    /// The first row's time, per moment.
    pub(super) first: Column,
    /// From row to row.
    pub(super) step: f32,
    /// `∂s/∂readout` of each row.
    pub(super) places: [f32; TILE],
}

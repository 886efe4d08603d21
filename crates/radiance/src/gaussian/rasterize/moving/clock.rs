//! When the rows of a tile look.

use super::PACK;
use crate::gaussian::bin::{TILE, TileGrid};
use crate::gaussian::{Moment, ShutterMotion};
use crate::shutter_motion::row_place;
use i2slam_compute::simd::Column;
use std::ops::Range;

/// The moments of a picture, ready for use.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Clock {
    /// Weights are positive and sum to 1.
    pub(crate) moments: Vec<Moment>,
    readout: f32,
    height: usize,
}

impl Clock {
    pub(crate) fn new(motion: &ShutterMotion, height: usize) -> Self {
        Self { moments: motion.counted(), readout: motion.counted_readout(), height }
    }

    /// The moments in packs.
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

/// When the rows of one tile look.
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

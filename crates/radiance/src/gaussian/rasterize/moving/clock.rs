//! When the rows of a tile look, and where a moving splat is then.

use super::PACK;
use crate::gaussian::bin::{Ellipse, TILE, TileGrid};
use crate::gaussian::motion::row_place;
use crate::gaussian::project::{Column, Lanes, Path, Splat};
use crate::gaussian::{Moment, ShutterMotion};
use pulp::Simd;

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

    /// The times of a tile's rows at each moment of one pack.
    pub(super) fn tile(&self, moments: &[Moment], grid: &TileGrid, number: usize) -> TileTimes {
        let row = number / grid.columns * TILE;
        let place = |row: usize| row_place::<f32>(row, self.height);
        // Between the two rows in the middle of the tile.
        let middle = 0.5 * self.readout * (place(row + TILE / 2 - 1) + place(row + TILE / 2));
        let mut times = TileTimes {
            count: moments.len(),
            middle: [0.0; PACK],
            spread: self.readout.abs() * (TILE / 2) as f32 / self.height as f32,
            rows: [[0.0; PACK]; TILE],
            places: std::array::from_fn(|j| place(row + j)),
        };
        for (j, moment) in moments.iter().enumerate() {
            times.middle[j] = moment.time + middle;
            for (row, place) in times.rows.iter_mut().zip(times.places) {
                row[j] = moment.time + self.readout * place;
            }
        }
        times
    }
}

/// When the rows of one tile look.
pub(super) struct TileTimes {
    /// Moments of the pack.
    pub(super) count: usize,
    /// In the middle of the tile, per moment.
    middle: Column,
    /// How far the time of any of the rows is from that, at most.
    spread: f32,
    /// Of each row at each moment.
    pub(super) rows: [[f32; PACK]; TILE],
    /// `∂s/∂readout` of each row.
    pub(super) places: [f32; TILE],
}

/// The rows of a tile that a splat touches at each moment.
pub(super) struct Touched {
    pub(super) first: [usize; PACK],
    pub(super) count: [usize; PACK],
    /// Of all moments: first and end.
    pub(super) rows: [usize; 2],
}

impl Touched {
    /// Whether the row is touched at the moment.
    #[inline(always)]
    pub(super) fn contains(&self, moment: usize, row: usize) -> bool {
        row.wrapping_sub(self.first[moment]) < self.count[moment]
    }

    /// As `Ellipse::rows` of a splat that stands still, with a margin for the times between
    /// the rows of the tile. `origin` is the centre of the tile's first pixel.
    #[inline(always)]
    pub(super) fn of<S: Simd>(
        simd: S,
        splat: &Splat,
        path: &Path<f32>,
        times: &TileTimes,
        origin: [f32; 2],
        alive: &[bool; PACK],
    ) -> Self {
        let ellipse = Ellipse::of(splat);
        let (mut firsts, mut ends) = ([0.0; PACK], [0.0; PACK]);
        for part in 0..times.count.div_ceil(S::F32_LANES) {
            let time = Lanes::load_part(simd, &times.middle, part);
            let [first, end] = rows_at(simd, splat, path, &ellipse, time, times.spread, origin);
            first.store_part(&mut firsts, part);
            end.store_part(&mut ends, part);
        }
        let mut touched = Self { first: [0; PACK], count: [0; PACK], rows: [TILE, 0] };
        for j in 0..times.count {
            let (first, end) = (integer(firsts[j]), integer(ends[j]));
            if alive[j] && first < end {
                (touched.first[j], touched.count[j]) = (first, end - first);
                touched.rows = [touched.rows[0].min(first), touched.rows[1].max(end)];
            }
        }
        touched
    }
}

/// Added to a number between 0 and 2²² it leaves its nearest integer in the low bits.
const ROUND: f32 = 8_388_608.0;

/// The nearest integer of what [`ROUND`] was added to.
#[inline(always)]
fn integer(shifted: f32) -> usize {
    (shifted.to_bits() & 0x1f) as usize
}

/// First and end row of the tile at several moments, with [`ROUND`] added.
#[inline(always)]
fn rows_at<S: Simd>(
    simd: S,
    splat: &Splat,
    path: &Path<f32>,
    ellipse: &Ellipse,
    time: Lanes<S>,
    spread: f32,
    origin: [f32; 2],
) -> [Lanes<S>; 2] {
    let constant = |value: f32| Lanes::splat(simd, value);
    let ([vx, vy], [hx, hy]) = (path.velocity, path.curvature);
    let shift_x = time * (constant(vx) + time.times(hx));
    let shift_y = time * (constant(vy) + time.times(hy));
    // |shift(t + d) - shift(t)| <= |d| (|v| + |h| (2 |t| + |d|))
    let reach = time.abs().times(2.0) + constant(spread);
    let margin_x = (reach.times(hx.abs()) + constant(vx.abs())).times(spread);
    let margin_y = (reach.times(hy.abs()) + constant(vy.abs())).times(spread);
    let left = constant(origin[0] - splat.centre[0]) - shift_x - margin_x;
    let right = left + margin_x.times(2.0) + constant((TILE - 1) as f32);
    let low = constant(ellipse.lowest).larger(left).smaller(right);
    let high = constant(-ellipse.lowest).larger(left).smaller(right);
    let half_height = |dx: Lanes<S>| {
        let part = dx.times(ellipse.inverse_width);
        let rest = (constant(1.0) - part * part).max(0.0);
        rest.sqrt().times(splat.height_at_centre) + constant(0.01) + margin_y
    };
    let bottom = low.times(ellipse.slope) + half_height(low);
    let top = high.times(ellipse.slope) - half_height(high);
    // Row j has its centre at j + 1/2.
    let start = constant(origin[1] - 0.5 - splat.centre[1]) - shift_y;
    let limit = |v: Lanes<S>| (v - start).max(0.0).min(TILE as f32);
    let touches = low.times(ellipse.inverse_width).within(-1.001, 1.001);
    [limit(top) + constant(ROUND), limit(bottom).only(touches) + constant(ROUND)]
}

//! Splats that move over a tile: which rows they touch, and their exponents along them, for all
//! moments of a pack at a time.
//!
//! Row `r` of the tile is exposed at `s = s₀ + κ r`, so that the shift `s (v + s h)` of a centre is a
//! polynomial of the row with the coefficients `s₀ (v + s₀ h)`, `κ (v + 2 s₀ h)` and `κ² h`.

use super::PACK;
use super::TileTimes;
use crate::gaussian::bin::{Ellipse, List, TILE};
use crate::gaussian::project::{Path, Splat};
use crate::gaussian::rasterize::cpu_forward::{COLUMNS, ExponentRow};
use i2slam_compute::simd::{Column, Lanes, nearest};
use pulp::Simd;

/// Splats of a list that are made ready together: independent loads wait for the memory once.
pub(super) const BATCH: usize = 16;

/// A splat and its path over a tile, ready for all moments.
#[derive(Clone, Copy, Default)]
#[repr(C, align(64))]
pub(super) struct MovingSplat {
    pub(super) splat: Splat,
    /// From the centre to the tile's first pixel, per axis and moment, and its change by row.
    offset: [Column; 2],
    slope: [Column; 2],
    /// First and end row that are touched, per moment, with [`ROUND`] added.
    first: Column,
    end: Column,
    pub(super) path: Path<f32>,
    /// `c = Σ₂ h` of the depth's slope `h` \[m px\].
    pub(super) depth_covariance: [f32; 2],
    /// Quadratic coefficient of the offset by row, per axis.
    curve: [f32; 2],
    /// First and end row that are touched at any moment.
    pub(super) rows: [usize; 2],
}

/// Added to a number between 0 and 2²² it leaves its nearest integer in the low bits.
const ROUND: f32 = 8_388_608.0;

/// A tile whose splats move.
pub(super) struct Stage<'a> {
    pub(super) splats: &'a [Splat],
    pub(super) paths: &'a [Path<f32>],
    pub(super) list: List<'a>,
    /// Centre of the tile's first pixel \[px\].
    pub(super) origin: [f32; 2],
    pub(super) times: &'a TileTimes,
}

impl Stage<'_> {
    /// Prepares the splats from `start` on; returns their number. None touches where `alive` is 0.
    #[inline(always)]
    pub(super) fn load<S: Simd>(
        &self,
        simd: S,
        start: usize,
        alive: &Column,
        moving: &mut [MovingSplat; BATCH],
    ) -> usize {
        let count = (self.list.len() - start).min(BATCH);
        for k in 0..count {
            let index = self.list.get(start + k).splat();
            moving[k].load(simd, &self.splats[index], &self.paths[index], self, alive);
        }
        count
    }
}

impl MovingSplat {
    #[inline(always)]
    fn load<S: Simd>(
        &mut self,
        simd: S,
        splat: &Splat,
        path: &Path<f32>,
        stage: &Stage<'_>,
        alive: &Column,
    ) {
        (self.splat, self.path) = (*splat, *path);
        self.depth_covariance = splat.covariance_product(splat.depth_slope);
        let (times, ellipse) = (stage.times, Ellipse::of(splat));
        let (mut first_row, mut end_row) = (TILE as f32, 0.0_f32);
        for axis in 0..2 {
            self.curve[axis] = -times.step * times.step * path.curvature[axis];
        }
        for part in 0..times.count.div_ceil(S::F32_LANES) {
            let time = Lanes::load_group(simd, &times.first, part);
            for axis in 0..2 {
                let (v, h) = (path.velocity[axis], path.curvature[axis]);
                let shift = time * (time.constant(v) + time.scale(h));
                let offset =
                    time.constant(stage.origin[axis]) - (time.constant(splat.centre[axis]) + shift);
                offset.store_group(&mut self.offset[axis], part);
                let slope = (time.constant(v) + time.scale(2.0 * h)).scale(-times.step);
                slope.store_group(&mut self.slope[axis], part);
            }
            let alive = Lanes::load_group(simd, alive, part);
            let [first, end, touches] = self.rows_at(&ellipse, part, times, alive);
            let beyond = (touches.constant(1.0) - touches).scale(TILE as f32);
            first_row = first_row.min((first * touches + beyond).reduce_min());
            end_row = end_row.max(end.reduce_max());
            (first + first.constant(ROUND)).store_group(&mut self.first, part);
            (end + end.constant(ROUND)).store_group(&mut self.end, part);
        }
        self.rows = [nearest(first_row), nearest(end_row)];
    }

    /// First and end row of the tile at several moments before rounding, and 1 where any may be
    /// touched, elsewhere 0: as [`Ellipse::rows`] of a splat that stands still where it is in the
    /// middle of the tile, with a margin for how far it moves from there.
    #[inline(always)]
    fn rows_at<S: Simd>(
        &self,
        ellipse: &Ellipse,
        part: usize,
        times: &TileTimes,
        alive: Lanes<S>,
    ) -> [Lanes<S>; 3] {
        let (left, margin_x) = self.middle(0, part, times, alive);
        let (top, margin_y) = self.middle(1, part, times, alive);
        let right = left + margin_x + alive.constant((TILE - 1) as f32);
        let left = left - margin_x;
        let low = alive.constant(ellipse.lowest).max(left).min(right);
        let high = alive.constant(-ellipse.lowest).max(left).min(right);
        let bottom = low.scale(ellipse.slope) + half_height(ellipse, low);
        let highest = high.scale(ellipse.slope) - half_height(ellipse, high);
        // Row j has its centre at j + 1/2.
        let start = top - alive.constant(0.5);
        let (first, end) = (highest - margin_y - start, bottom + margin_y - start);
        let touches = low.scale(ellipse.inverse_width).within(-1.001, 1.001).keep(alive);
        [
            first.clamp_min(0.0).clamp_max(TILE as f32),
            end.clamp_min(0.0).clamp_max(TILE as f32) * touches,
            touches,
        ]
    }

    /// The offset at the tile's middle row, and how far from it that of another row may be.
    #[inline(always)]
    fn middle<S: Simd>(
        &self,
        axis: usize,
        part: usize,
        times: &TileTimes,
        like: Lanes<S>,
    ) -> (Lanes<S>, Lanes<S>) {
        const HALF: f32 = 0.5 * (TILE - 1) as f32;
        let offset = Lanes::load_group(like.simd(), &self.offset[axis], part);
        if times.step == 0.0 {
            return (offset, like.constant(0.0));
        }
        let slope = Lanes::load_group(like.simd(), &self.slope[axis], part);
        let curve = self.curve[axis];
        let at_middle = offset + slope.scale(HALF) + like.constant(HALF * HALF * curve);
        let farthest = slope.abs().scale(HALF) + like.constant(3.0 * HALF * HALF * curve.abs());
        (at_middle, farthest)
    }

    /// True if the splat touches the row at the moment.
    #[inline(always)]
    pub(super) fn touches(&self, moment: usize, row: usize) -> bool {
        let (first, end) = (self.first[moment].to_bits(), self.end[moment].to_bits());
        let row = ROUND.to_bits() + row as u32;
        first <= row && row < end
    }

    /// `log₂ α` along a row at a moment.
    #[inline(always)]
    pub(super) fn exponent<S: Simd>(&self, simd: S, row: usize, moment: usize) -> ExponentRow<S> {
        let row = simd.splat_f32s(row as f32);
        let x = self.offset_at(simd, 0, row, moment);
        let dy = simd.add_f32s(self.offset_at(simd, 1, row, moment), row);
        let [a, b, c] = self.splat.exponent;
        let (b, c) = (simd.splat_f32s(b), simd.splat_f32s(c));
        let log2_opacity = simd.splat_f32s(self.splat.log2_opacity);
        ExponentRow {
            a: simd.splat_f32s(a),
            slope: simd.mul_f32s(b, dy),
            base: simd.mul_add_e_f32s(simd.mul_f32s(c, dy), dy, log2_opacity),
            first: simd.add_f32s(S::as_simd_f32s(&COLUMNS).0[0], x),
            dy,
        }
    }

    /// From the centre to the tile's first pixel for a row, on one axis.
    #[inline(always)]
    fn offset_at<S: Simd>(&self, simd: S, axis: usize, row: S::f32s, moment: usize) -> S::f32s {
        let curve = simd.splat_f32s(self.curve[axis]);
        let slope = simd.splat_f32s(self.slope[axis][moment]);
        let slope = simd.mul_add_e_f32s(row, curve, slope);
        simd.mul_add_e_f32s(row, slope, simd.splat_f32s(self.offset[axis][moment]))
    }
}

/// Half the height of an extent at a column.
#[inline(always)]
fn half_height<S: Simd>(ellipse: &Ellipse, dx: Lanes<S>) -> Lanes<S> {
    let part = dx.scale(ellipse.inverse_width);
    let rest = (dx.constant(1.0) - part * part).clamp_min(0.0);
    rest.sqrt().scale(ellipse.height_at_centre) + dx.constant(0.01)
}

/// 1 for the moments that a pack has, 0 beyond.
pub(super) fn all_alive(times: &TileTimes) -> Column {
    let mut alive = [0.0; PACK];
    alive[..times.count].fill(1.0);
    alive
}

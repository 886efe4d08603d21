//! Backward pass on the CPU, front to back again.
//!
//! With `q_i = g · v_i` for the cotangent `g` of a pixel and what splat `i` composites,
//! `v_i = (r, g, b, z, 1)`, and the whole pixel's `S = Σ_j q_j α_j T_j = g · (C, D, O)`, which is
//! known from the picture, the light from behind contribution `i` is `S` less what has passed:
//!
//! ```text
//! ∂L/∂α_i = T_i q_i - (S - Σ_{j<=i} q_j α_j T_j) / (1 - α_i)
//! ```
//!
//! so that nothing but `T` and the remainder is carried along. Per splat and tile a dozen sums are
//! kept in registers, reduced once and written to their own slot: nothing is added by two
//! threads.

use super::cpu_forward::{Exponent, ExponentRow, Limits, Value, advance};
use super::tile::{Row, TilePixels};
use crate::gaussian::RasterSettings;
use crate::gaussian::bin::{Bins, Entry, TILE, TileGrid};
use crate::gaussian::project::Splat;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Sums of one splat over the pixels of one tile, with `e = α ∂L/∂α` and `w = α T`.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C)]
pub(crate) struct TileSums {
    /// `Σ e dx, Σ e dy`.
    pub(crate) first: [f32; 2],
    /// `Σ e dx², Σ e dx dy, Σ e dy²`.
    pub(crate) second: [f32; 3],
    /// `Σ w ∂L/∂depth`.
    pub(crate) depth: f32,
    /// `Σ w ∂L/∂depth dx, Σ w ∂L/∂depth dy`.
    pub(crate) depth_first: [f32; 2],
    /// `Σ e`. Only with the map.
    pub(crate) zeroth: f32,
    /// `Σ w ∂L/∂radiance`. Only with the map.
    pub(crate) radiance: [f32; 3],
    /// `Σ w` over the pixels whose cotangent is not zero. Only with the map.
    pub(crate) weight: f32,
}

impl TileSums {
    pub(crate) fn add(&mut self, other: &Self) {
        (0..2).for_each(|k| self.first[k] += other.first[k]);
        (0..2).for_each(|k| self.depth_first[k] += other.depth_first[k]);
        (0..3).for_each(|k| self.second[k] += other.second[k]);
        (0..3).for_each(|k| self.radiance[k] += other.radiance[k]);
        self.depth += other.depth;
        self.zeroth += other.zeroth;
        self.weight += other.weight;
    }
}

/// State of the last render, and the cotangent of its pixels.
pub(crate) struct Picture<'a> {
    pub(crate) arch: Arch,
    pub(crate) settings: &'a RasterSettings,
    pub(crate) grid: &'a TileGrid,
    pub(crate) splats: &'a [Splat],
    pub(crate) bins: &'a Bins,
    pub(crate) tiles: &'a [TilePixels],
    /// `∂L/∂[r, g, b, depth, opacity]`.
    pub(crate) cotangent: [Option<&'a [f32]>; 5],
    /// Compute the sums that only the map needs.
    pub(crate) with_map: bool,
}

/// Fills the slots of all entries of all tiles.
pub(crate) fn pull_back(picture: &Picture<'_>, slots: &mut [TileSums]) {
    let slots = picture.bins.by_tile(slots).into_par_iter().enumerate();
    slots.for_each(|(number, slots)| pull_back_tile(picture, number, slots));
}

/// Planes of the backward state of a pixel.
mod plane {
    pub(super) const TRANSMITTANCE: usize = 0;
    /// `S` less what has passed.
    pub(super) const REMAINDER: usize = 1;
    /// The cotangent: r, g, b, depth, opacity.
    pub(super) const COTANGENT: usize = 2;
    /// 1 where the cotangent is not zero.
    pub(super) const NONZERO: usize = 7;
    pub(super) const COUNT: usize = 8;
}

/// State of a tile's pixels, row by row, plane by plane.
#[repr(C, align(64))]
struct Scratch([[Row; plane::COUNT]; TILE]);

fn pull_back_tile(picture: &Picture<'_>, number: usize, slots: &mut [TileSums]) {
    let tile = &picture.tiles[number];
    let mut scratch = Scratch([[[0.0; TILE]; plane::COUNT]; TILE]);
    if !load(picture, number, &mut scratch) {
        slots.fill(TileSums::default());
        return;
    }
    let (column, row) = (number % picture.grid.columns, number / picture.grid.columns);
    let origin = [(column * TILE) as f32 + 0.5, (row * TILE) as f32 + 0.5];
    let (visited, rest) = slots.split_at_mut(tile.visited);
    rest.fill(TileSums::default());
    let list = picture.bins.list(number).zip(visited);
    let (settings, splats, rows) = (picture.settings, picture.splats, &mut scratch.0);
    if picture.with_map {
        picture.arch.dispatch(Backward::<_, true> { settings, splats, list, origin, rows });
    } else {
        picture.arch.dispatch(Backward::<_, false> { settings, splats, list, origin, rows });
    }
}

/// Fills the state from the cotangent and the picture; `false` when the cotangent is all zero.
fn load(picture: &Picture<'_>, number: usize, scratch: &mut Scratch) -> bool {
    let grid = picture.grid;
    let (column, row) = (number % grid.columns * TILE, number / grid.columns * TILE);
    let width = TILE.min(grid.width - column);
    let mut any = 0.0;
    for j in 0..TILE.min(grid.height - row) {
        let planes = &mut scratch.0[j];
        let at = (row + j) * grid.width + column;
        for (k, source) in picture.cotangent.iter().enumerate() {
            if let Some(source) = source {
                let target = &mut planes[plane::COTANGENT + k][..width];
                target.copy_from_slice(&source[at..at + width]);
            }
        }
        let [t, r, g, b, z] = &picture.tiles[number].rows[j];
        for i in 0..width {
            let cotangent: [f32; 5] = std::array::from_fn(|k| planes[plane::COTANGENT + k][i]);
            let value = [r[i], g[i], b[i], z[i], 1.0 - t[i].abs()];
            let nonzero = if cotangent == [0.0; 5] { 0.0 } else { 1.0 };
            planes[plane::TRANSMITTANCE][i] = 1.0;
            planes[plane::REMAINDER][i] = (0..5).map(|k| cotangent[k] * value[k]).sum();
            planes[plane::NONZERO][i] = nonzero;
            any += nonzero;
        }
    }
    any > 0.0
}

/// Backward pass of one tile. Without `MAP`, the sums that only the map needs stay zero.
struct Backward<'a, L, const MAP: bool> {
    settings: &'a RasterSettings,
    splats: &'a [Splat],
    list: L,
    /// Centre of the tile's first pixel \[px\].
    origin: [f32; 2],
    rows: &'a mut [[Row; plane::COUNT]; TILE],
}

impl<'a, L, const MAP: bool> WithSimd for Backward<'_, L, MAP>
where
    L: Iterator<Item = (Entry, &'a mut TileSums)>,
{
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let limits = Limits::new(simd, self.settings);
        for (entry, slot) in self.list {
            let splat = &self.splats[entry.splat()];
            let exponent = Exponent::new(simd, splat, self.origin);
            let value = Value::new(simd, splat);
            let mut sums = Sums::<S>::new(simd);
            let [first, end] = entry.rows();
            for (j, row) in self.rows[first..end].iter_mut().enumerate() {
                let exponent = exponent.row(simd, first + j);
                pull_back_row::<S, MAP>(simd, &limits, &exponent, &value, row, &mut sums);
            }
            *slot = sums.reduce::<MAP>(simd);
        }
    }
}

/// The sums of a [`TileSums`] in vectors.
pub(super) struct Sums<S: Simd> {
    pub(super) first: [S::f32s; 2],
    pub(super) second: [S::f32s; 3],
    pub(super) depth: S::f32s,
    pub(super) depth_first: [S::f32s; 2],
    pub(super) zeroth: S::f32s,
    pub(super) radiance: [S::f32s; 3],
    pub(super) weight: S::f32s,
}

impl<S: Simd> Sums<S> {
    #[inline(always)]
    pub(super) fn new(simd: S) -> Self {
        let zero = simd.splat_f32s(0.0);
        Self {
            first: [zero; 2],
            second: [zero; 3],
            depth: zero,
            depth_first: [zero; 2],
            zeroth: zero,
            radiance: [zero; 3],
            weight: zero,
        }
    }

    #[inline(always)]
    pub(super) fn reduce<const MAP: bool>(&self, simd: S) -> TileSums {
        let mut slot = TileSums::default();
        for k in 0..2 {
            slot.first[k] = simd.reduce_sum_f32s(self.first[k]);
            slot.depth_first[k] = simd.reduce_sum_f32s(self.depth_first[k]);
        }
        for k in 0..3 {
            slot.second[k] = simd.reduce_sum_f32s(self.second[k]);
        }
        slot.depth = simd.reduce_sum_f32s(self.depth);
        if MAP {
            slot.zeroth = simd.reduce_sum_f32s(self.zeroth);
            for k in 0..3 {
                slot.radiance[k] = simd.reduce_sum_f32s(self.radiance[k]);
            }
            slot.weight = simd.reduce_sum_f32s(self.weight);
        }
        slot
    }
}

/// `sum += a b`.
#[inline(always)]
pub(super) fn accumulate<S: Simd>(simd: S, sum: &mut S::f32s, a: S::f32s, b: S::f32s) {
    *sum = simd.mul_add_e_f32s(a, b, *sum);
}

/// Pulls one row back to the sums of one splat.
#[inline(always)]
fn pull_back_row<S: Simd, const MAP: bool>(
    simd: S,
    limits: &Limits<S>,
    exponent: &ExponentRow<S>,
    value: &Value<S>,
    row: &mut [Row; plane::COUNT],
    sums: &mut Sums<S>,
) {
    let [transmittance, remainder, r, g, b, z, o, nonzero] = row;
    let transmittance = S::as_mut_simd_f32s(transmittance).0;
    let remainder = S::as_mut_simd_f32s(remainder).0;
    let cotangent = [
        S::as_simd_f32s(r).0,
        S::as_simd_f32s(g).0,
        S::as_simd_f32s(b).0,
        S::as_simd_f32s(z).0,
        S::as_simd_f32s(o).0,
    ];
    let nonzero = S::as_simd_f32s(nonzero).0;
    for v in 0..TILE / S::F32_LANES {
        let dx = exponent.dx(simd, v);
        let free = exponent.alpha(simd, dx);
        let alpha = simd.min_f32s(free, limits.alpha_max);
        let step = advance(simd, limits, alpha, transmittance[v]);
        let mut q = cotangent[4][v];
        for k in 0..3 {
            q = simd.mul_add_e_f32s(cotangent[k][v], value.radiance[k], q);
        }
        q = simd.mul_add_e_f32s(cotangent[3][v], value.depth(simd, dx, exponent.dy), q);
        let behind = simd.negate_mul_add_e_f32s(step.weight, q, remainder[v]);
        let one = simd.splat_f32s(1.0);
        let from_behind = simd.div_f32s(behind, simd.sub_f32s(one, alpha));
        let d_alpha = simd.sub_f32s(simd.mul_f32s(transmittance[v], q), from_behind);
        let varies = simd.less_than_or_equal_f32s(free, limits.alpha_max);
        let varies = simd.and_m32s(step.counts, varies);
        let e = simd.select_f32s(varies, simd.mul_f32s(alpha, d_alpha), simd.splat_f32s(0.0));
        (transmittance[v], remainder[v]) = (step.next, behind);
        let (ex, ey) = (simd.mul_f32s(e, dx), simd.mul_f32s(e, exponent.dy));
        sums.first = [simd.add_f32s(sums.first[0], ex), simd.add_f32s(sums.first[1], ey)];
        accumulate(simd, &mut sums.second[0], ex, dx);
        accumulate(simd, &mut sums.second[1], ex, exponent.dy);
        accumulate(simd, &mut sums.second[2], ey, exponent.dy);
        accumulate(simd, &mut sums.depth, step.weight, cotangent[3][v]);
        let d_depth = simd.mul_f32s(step.weight, cotangent[3][v]);
        accumulate(simd, &mut sums.depth_first[0], d_depth, dx);
        accumulate(simd, &mut sums.depth_first[1], d_depth, exponent.dy);
        if MAP {
            sums.zeroth = simd.add_f32s(sums.zeroth, e);
            accumulate(simd, &mut sums.weight, step.weight, nonzero[v]);
            for k in 0..3 {
                accumulate(simd, &mut sums.radiance[k], step.weight, cotangent[k][v]);
            }
        }
    }
}

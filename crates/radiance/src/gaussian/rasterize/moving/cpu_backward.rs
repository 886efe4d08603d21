//! Backward pass of all moments of a tile, back to front.
//!
//! With `q_i = g · v_i` for the cotangent `g` of a pixel and what splat `i` composites,
//! `v_i = (r, g, b, z, 1)`, and at each moment the transmittance `T` behind contribution `i` and
//! the light `B` from there, both times the moment's weight,
//!
//! ```text
//! a = α / (1 - α),   α ∂L/∂α = a (T q - B),   B ← B + a T q,   T ← T + a T
//! ```
//!
//! steps to the next contribution in front. What is the same at all moments, `q` and the sums of
//! the colour, is done once per row.

use super::TileTimes;
use super::cpu_forward::Scene;
use super::moving_splat::{self, BATCH, MovingSplat, Stage};
use super::{MomentRow, PACK};
use crate::gaussian::RasterSettings;
use crate::gaussian::bin::TILE;
use crate::gaussian::rasterize::cpu_backward::{Sums, TileSums, accumulate};
use crate::gaussian::rasterize::cpu_forward::{ExponentRow, Limits, Value};
use crate::gaussian::rasterize::tile::{Row, TilePixels};
use pulp::{Simd, WithSimd};
use rayon::prelude::*;

/// State of the last render, and the cotangent of its pixels.
pub(crate) struct Picture<'a> {
    pub(crate) scene: Scene<'a>,
    pub(crate) tiles: &'a [TilePixels],
    pub(crate) states: &'a [MomentRow],
    /// `∂L/∂[r, g, b, depth, opacity]`.
    pub(crate) cotangent: [Option<&'a [f32]>; 5],
    /// Compute the sums that only the map needs.
    pub(crate) with_map: bool,
}

/// The slots of some tiles' entries.
struct Slots<'a> {
    slots: &'a mut [TileSums],
    motion: &'a mut [MotionTileSums],
}

/// Fills the slots of all entries of all tiles.
pub(crate) fn pull_back(
    picture: &Picture<'_>,
    slots: &mut [TileSums],
    motion: &mut [MotionTileSums],
) {
    let bins = picture.scene.bins;
    let slots = bins.by_tile(slots).into_par_iter().zip(bins.by_tile(motion));
    slots.enumerate().for_each(|(number, (slots, motion))| {
        pull_back_tile(picture, number, Slots { slots, motion });
    });
}

/// The cotangent of a tile's pixels, row by row, plane by plane.
#[repr(C, align(64))]
struct Cotangent([[Row; PLANES]; TILE]);

fn pull_back_tile(picture: &Picture<'_>, number: usize, Slots { slots, motion }: Slots<'_>) {
    let Scene { arch, settings, grid, row_times, splats, paths, bins } = picture.scene;
    slots.fill(TileSums::default());
    motion.fill(MotionTileSums::default());
    let (count, visited) = (row_times.moments.len(), picture.tiles[number].visited);
    let mut cotangent = Cotangent([[[0.0; TILE]; PLANES]; TILE]);
    if count == 0 || visited == 0 || !load(picture, number, &mut cotangent) {
        return;
    }
    let (column, row) = (number % grid.columns, number / grid.columns);
    let origin = [(column * TILE) as f32 + 0.5, (row * TILE) as f32 + 0.5];
    let states = &picture.states[number * TILE * count..][..TILE * count];
    for pack in row_times.packs() {
        let times = &row_times.tile(pack.clone(), grid, number);
        let passed = start(states.chunks(count).flat_map(|row| &row[pack.clone()]));
        let stage = Stage { splats, paths, list: bins.entries(number), origin, times };
        let (slots, motion) = (&mut slots[..visited], &mut motion[..visited]);
        let (rows, slots) = (&cotangent.0, Slots { slots, motion });
        if picture.with_map {
            arch.dispatch(Backward::<true> { settings, stage, slots, passed, rows });
        } else {
            arch.dispatch(Backward::<false> { settings, stage, slots, passed, rows });
        }
    }
}

/// Fills the cotangent's planes; `false` when it is all zero.
fn load(picture: &Picture<'_>, number: usize, cotangent: &mut Cotangent) -> bool {
    let grid = picture.scene.grid;
    let (column, row) = (number % grid.columns * TILE, number / grid.columns * TILE);
    let width = TILE.min(grid.width - column);
    let mut any = false;
    for j in 0..TILE.min(grid.height - row) {
        let planes = &mut cotangent.0[j];
        let at = (row + j) * grid.width + column;
        for (plane, source) in planes.iter_mut().zip(&picture.cotangent) {
            if let Some(source) = source {
                plane[..width].copy_from_slice(&source[at..at + width]);
            }
        }
        for i in 0..width {
            if (0..PLANES - 1).any(|k| planes[k][i] != 0.0) {
                planes[PLANES - 1][i] = 1.0;
                any = true;
            }
        }
    }
    any
}

/// The transmittance that the render left, and no light from behind.
fn start<'a>(states: impl Iterator<Item = &'a MomentRow>) -> Vec<MomentState> {
    let one = |state: &MomentRow| MomentState {
        transmittance: state.transmittance.map(f32::abs),
        behind: [0.0; TILE],
        ended: state.ended,
    };
    states.map(one).collect()
}

/// Backward pass of one tile. Without `MAP`, the sums that only the map needs stay zero.
struct Backward<'a, const MAP: bool> {
    settings: &'a RasterSettings,
    stage: Stage<'a>,
    /// Of the entries that were visited.
    slots: Slots<'a>,
    /// All moments of the tile's first row, then of the second.
    passed: Vec<MomentState>,
    rows: &'a [[Row; PLANES]; TILE],
}

impl<const MAP: bool> WithSimd for Backward<'_, MAP> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { stage, slots: Slots { slots, motion }, mut passed, rows, .. } = self;
        let limits = Limits::new(simd, self.settings);
        let (mut moving, alive) =
            ([MovingSplat::default(); BATCH], moving_splat::all_alive(stage.times));
        let moments = stage.times.count;
        for batch in (0..slots.len().div_ceil(BATCH)).rev() {
            let start = batch * BATCH;
            let count = stage.load(simd, start, &alive, &mut moving).min(slots.len() - start);
            for (k, moving_splat) in moving[..count].iter().enumerate().rev() {
                let mut step = Step {
                    moving_splat,
                    limits: &limits,
                    times: stage.times,
                    value: Value::new(simd, &moving_splat.splat),
                    order: simd.splat_f32s((start + k) as f32),
                    sums: Sums::new(simd),
                    motion_sums: MotionSums::new(simd),
                };
                let [first, end] = moving_splat.rows;
                for row in first..end {
                    let passed = &mut passed[row * moments..][..moments];
                    step.row::<MAP>(simd, row, &rows[row], passed);
                }
                slots[start + k].add(&step.sums.reduce::<MAP>(simd));
                motion[start + k].add(&step.motion_sums.reduce(simd));
            }
        }
    }
}

/// Sums by motion of one splat over a tile, beside its [`TileSums`]; `e = α ∂L/∂α`.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MotionTileSums {
    /// `Σ s (e d - w ∂L/∂depth c)`.
    pub(crate) velocity: [f32; 2],
    /// `Σ s² (e d - w ∂L/∂depth c)`.
    pub(crate) curvature: [f32; 2],
    /// `∂L/∂readout`.
    pub(crate) readout: f32,
}

impl MotionTileSums {
    pub(crate) fn add(&mut self, other: &Self) {
        (0..2).for_each(|k| self.velocity[k] += other.velocity[k]);
        (0..2).for_each(|k| self.curvature[k] += other.curvature[k]);
        self.readout += other.readout;
    }
}

/// Planes of the cotangent of a pixel: r, g, b, depth, opacity, and 1 where any is not zero.
pub(super) const PLANES: usize = 6;

/// Backward state of one row of a tile at one moment.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct MomentState {
    /// `T`.
    pub(super) transmittance: Row,
    /// `B`.
    pub(super) behind: Row,
    /// The place in the list at which pixels ended.
    pub(super) ended: Row,
}

/// The sums of a [`MotionTileSums`] in vectors.
pub(super) struct MotionSums<S: Simd> {
    velocity: [S::f32s; 2],
    curvature: [S::f32s; 2],
    readout: S::f32s,
}

impl<S: Simd> MotionSums<S> {
    #[inline(always)]
    pub(super) fn new(simd: S) -> Self {
        let zero = simd.splat_f32s(0.0);
        Self { velocity: [zero; 2], curvature: [zero; 2], readout: zero }
    }

    #[inline(always)]
    pub(super) fn reduce(&self, simd: S) -> MotionTileSums {
        let mut slot = MotionTileSums::default();
        for k in 0..2 {
            slot.velocity[k] = simd.reduce_sum_f32s(self.velocity[k]);
            slot.curvature[k] = simd.reduce_sum_f32s(self.curvature[k]);
        }
        slot.readout = simd.reduce_sum_f32s(self.readout);
        slot
    }
}

/// Backward pass of one splat.
pub(super) struct Step<'a, S: Simd> {
    pub(super) moving_splat: &'a MovingSplat,
    pub(super) limits: &'a Limits<S>,
    pub(super) times: &'a TileTimes,
    pub(super) value: Value<S>,
    /// Its place in the tile's list.
    pub(super) order: S::f32s,
    pub(super) sums: Sums<S>,
    pub(super) motion_sums: MotionSums<S>,
}

impl<S: Simd> Step<'_, S> {
    /// Pulls one row back at all moments.
    #[inline(always)]
    pub(super) fn row<const MAP: bool>(
        &mut self,
        simd: S,
        row: usize,
        cotangent: &[Row; PLANES],
        passed: &mut [MomentState],
    ) {
        for v in 0..TILE / S::F32_LANES {
            let mut g = [simd.splat_f32s(0.0); PLANES];
            for k in 0..PLANES {
                g[k] = S::as_simd_f32s(&cotangent[k]).0[v];
            }
            let mut q = g[4];
            for k in 0..3 {
                q = simd.mul_add_e_f32s(g[k], self.value.radiance[k], q);
            }
            let mut sums = RowSums::new(simd);
            for (j, passed) in passed.iter_mut().enumerate().take(PACK) {
                if self.moving_splat.touches(j, row) {
                    let s = simd.splat_f32s(self.times.first[j] + self.times.step * row as f32);
                    let exponent = self.moving_splat.exponent(simd, row, j);
                    let depth = self.value.depth(simd, exponent.dx(simd, v), exponent.dy);
                    let q = simd.mul_add_e_f32s(g[3], depth, q);
                    let light = self.step(simd, &exponent, v, q, passed);
                    self.add::<MAP>(simd, &exponent, v, (s, g[3]), &light, &mut sums);
                }
            }
            self.add_row(simd, row, &sums);
            accumulate(simd, &mut self.sums.depth, sums.weight, g[3]);
            for k in 0..2 {
                accumulate(simd, &mut self.sums.depth_first[k], sums.weight_first[k], g[3]);
            }
            if MAP {
                accumulate(simd, &mut self.sums.weight, sums.weight, g[PLANES - 1]);
                for k in 0..3 {
                    accumulate(simd, &mut self.sums.radiance[k], sums.weight, g[k]);
                }
            }
        }
    }

    /// Step over the contribution to one vector of pixels at one moment.
    #[inline(always)]
    fn step(
        &self,
        simd: S,
        exponent: &ExponentRow<S>,
        v: usize,
        q: S::f32s,
        passed: &mut MomentState,
    ) -> Light<S> {
        let transmittance = &mut S::as_mut_simd_f32s(&mut passed.transmittance).0[v];
        let behind = &mut S::as_mut_simd_f32s(&mut passed.behind).0[v];
        let ended = S::as_simd_f32s(&passed.ended).0[v];
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let free = exponent.alpha(simd, exponent.dx(simd, v));
        let alpha = simd.min_f32s(free, self.limits.alpha_max);
        let visible = simd.greater_than_or_equal_f32s(alpha, self.limits.alpha_min);
        let counts = simd.and_m32s(visible, simd.less_than_f32s(self.order, ended));
        let odds = simd.div_f32s(alpha, simd.sub_f32s(one, alpha));
        let odds = simd.select_f32s(counts, odds, zero);
        let weight = simd.mul_f32s(odds, *transmittance);
        // α ∂L/∂α = a (T q - B), with T and B behind the contribution.
        let gain = simd.sub_f32s(simd.mul_f32s(*transmittance, q), *behind);
        let varies = simd.less_than_or_equal_f32s(free, self.limits.alpha_max);
        let e = simd.mul_f32s(simd.select_f32s(varies, odds, zero), gain);
        *behind = simd.mul_add_e_f32s(weight, q, *behind);
        *transmittance = simd.add_f32s(*transmittance, weight);
        Light { e, weight }
    }

    /// Adds to the sums what depends on the moment.
    #[inline(always)]
    fn add<const MAP: bool>(
        &mut self,
        simd: S,
        exponent: &ExponentRow<S>,
        v: usize,
        (s, d_depth): (S::f32s, S::f32s),
        light: &Light<S>,
        row: &mut RowSums<S>,
    ) {
        let (dx, dy) = (exponent.dx(simd, v), exponent.dy);
        let (ex, ey) = (simd.mul_f32s(light.e, dx), simd.mul_f32s(light.e, dy));
        // A shift of the centre changes depth by -h, which is -Σ₂⁻¹ c.
        let d_depth = simd.mul_f32s(light.weight, d_depth);
        let [cx, cy] = self.moving_splat.depth_covariance.map(|c| simd.splat_f32s(c));
        let fx = simd.negate_mul_add_e_f32s(cx, d_depth, ex);
        let fy = simd.negate_mul_add_e_f32s(cy, d_depth, ey);
        let (sx, sy) = (simd.mul_f32s(s, fx), simd.mul_f32s(s, fy));
        row.weight = simd.add_f32s(row.weight, light.weight);
        accumulate(simd, &mut row.weight_first[0], light.weight, dx);
        accumulate(simd, &mut row.weight_first[1], light.weight, dy);
        row.first = [simd.add_f32s(row.first[0], fx), simd.add_f32s(row.first[1], fy)];
        row.moved = [simd.add_f32s(row.moved[0], sx), simd.add_f32s(row.moved[1], sy)];
        accumulate(simd, &mut self.sums.second[0], ex, dx);
        accumulate(simd, &mut self.sums.second[1], ex, dy);
        accumulate(simd, &mut self.sums.second[2], ey, dy);
        accumulate(simd, &mut self.motion_sums.curvature[0], s, sx);
        accumulate(simd, &mut self.motion_sums.curvature[1], s, sy);
        if MAP {
            self.sums.zeroth = simd.add_f32s(self.sums.zeroth, light.e);
        }
    }

    /// Adds the sums of a row; the readout moves the centre by the row's place times `v + 2 s h`.
    #[inline(always)]
    fn add_row(&mut self, simd: S, row: usize, sums: &RowSums<S>) {
        let MovingSplat { splat, path, .. } = self.moving_splat;
        let place = self.times.places[row];
        let speed = [path.velocity[0] * place, path.velocity[1] * place];
        let bend = [path.curvature[0] * 2.0 * place, path.curvature[1] * 2.0 * place];
        let (speed, bend) = (splat.gradient(speed), splat.gradient(bend));
        for k in 0..2 {
            let (first, moved) = (&mut self.sums.first[k], &mut self.motion_sums.velocity[k]);
            *first = simd.add_f32s(*first, sums.first[k]);
            *moved = simd.add_f32s(*moved, sums.moved[k]);
            let readout = &mut self.motion_sums.readout;
            accumulate(simd, readout, sums.first[k], simd.splat_f32s(speed[k]));
            accumulate(simd, readout, sums.moved[k], simd.splat_f32s(bend[k]));
        }
    }
}

/// One contribution: `e = α ∂L/∂α` and its weight.
struct Light<S: Simd> {
    e: S::f32s,
    weight: S::f32s,
}

/// Sums over the moments of one row.
struct RowSums<S: Simd> {
    weight: S::f32s,
    /// `Σ w dx, Σ w dy`.
    weight_first: [S::f32s; 2],
    /// `Σ e d - w ∂L/∂depth c`, of which `Σ₂⁻¹` makes `∂L/∂centre`.
    first: [S::f32s; 2],
    /// The same times `s`.
    moved: [S::f32s; 2],
}

impl<S: Simd> RowSums<S> {
    #[inline(always)]
    fn new(simd: S) -> Self {
        let zero = simd.splat_f32s(0.0);
        Self { weight: zero, weight_first: [zero; 2], first: [zero; 2], moved: [zero; 2] }
    }
}

//! Compositing of all moments of a tile.

use super::RowTimes;
use super::moving_splat::{self, BATCH, MovingSplat, Stage};
use super::{MomentRow, PACK};
use crate::gaussian::RasterSettings;
use crate::gaussian::bin::{Bins, TILE, TileGrid};
use crate::gaussian::project::{Path, Splat};
use crate::gaussian::rasterize::cpu_forward::{Limits, Value, advance};
use crate::gaussian::rasterize::tile::{PLANES, Row, TilePixels};
use i2slam_compute::simd::Column;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::ops::Range;

/// Inputs of both directions.
pub(crate) struct Scene<'a> {
    pub(crate) arch: Arch,
    pub(crate) settings: &'a RasterSettings,
    pub(crate) grid: &'a TileGrid,
    pub(crate) row_times: &'a RowTimes,
    pub(crate) splats: &'a [Splat],
    pub(crate) paths: &'a [Path<f32>],
    pub(crate) bins: &'a Bins,
}

/// Composites all tiles, or those that `mask` marks; nothing is visited of the others. `states`
/// holds the moments of the first tile, then of the second.
pub(crate) fn render(
    scene: &Scene<'_>,
    mask: Option<&[bool]>,
    tiles: &mut [TilePixels],
    states: &mut [MomentRow],
) {
    if scene.row_times.moments.is_empty() {
        tiles.par_iter_mut().for_each(show_nothing);
        return;
    }
    let count = TILE * scene.row_times.moments.len();
    let work = tiles.par_iter_mut().zip(states.par_chunks_mut(count)).enumerate();
    work.for_each(|(number, (tile, states))| match mask {
        Some(mask) if !mask[number] => tile.visited = 0,
        _ => render_tile(scene, number, tile, states),
    });
}

/// The transmittance is 1 everywhere.
fn show_nothing(tile: &mut TilePixels) {
    *tile = TilePixels::default();
    tile.rows.iter_mut().for_each(|row| row[0] = [1.0; TILE]);
}

fn render_tile(scene: &Scene<'_>, number: usize, tile: &mut TilePixels, states: &mut [MomentRow]) {
    let Scene { settings, splats, paths, bins, grid, row_times, .. } = *scene;
    let origin = start(grid, number, row_times, states);
    tile.rows = [[[0.0; TILE]; PLANES]; TILE];
    tile.visited = 0;
    for pack in row_times.packs() {
        let times = &row_times.tile(pack.clone(), grid, number);
        let stage = Stage { splats, paths, list: bins.entries(number), origin, times };
        let weights = row_times.moments[pack.clone()].iter();
        let minimum = weights.map(|moment| settings.transmittance_min * moment.weight).collect();
        let rows = &mut tile.rows;
        let states = States { rows: &mut *states, stride: row_times.moments.len(), pack };
        let visited = scene.arch.dispatch(Composite { settings, stage, minimum, states, rows });
        tile.visited = tile.visited.max(visited);
    }
    for (row, states) in tile.rows.iter_mut().zip(states.chunks(row_times.moments.len())) {
        let mut opacity = [0.0; TILE];
        for (state, moment) in states.iter().zip(&row_times.moments) {
            (0..TILE).for_each(|i| opacity[i] += moment.weight - state.transmittance[i].abs());
        }
        row[0] = opacity.map(|opacity| 1.0 - opacity);
    }
}

/// Sets a tile to nothing seen yet and ended outside of the image; gives its first pixel's centre.
fn start(
    grid: &TileGrid,
    number: usize,
    row_times: &RowTimes,
    states: &mut [MomentRow],
) -> [f32; 2] {
    let (column, row) = (number % grid.columns * TILE, number / grid.columns * TILE);
    for (j, states) in states.chunks_mut(row_times.moments.len()).enumerate() {
        let inside = if row + j < grid.height { grid.width - column } else { 0 };
        for (state, moment) in states.iter_mut().zip(&row_times.moments) {
            for i in 0..TILE {
                let (sign, ended) = if i < inside { (1.0, f32::MAX) } else { (-1.0, -1.0) };
                (state.transmittance[i], state.ended[i]) = (sign * moment.weight, ended);
            }
        }
    }
    [column as f32 + 0.5, row as f32 + 0.5]
}

/// The moments of one pack.
struct States<'a> {
    rows: &'a mut [MomentRow],
    /// Moments of all packs.
    stride: usize,
    pack: Range<usize>,
}

impl States<'_> {
    /// One row of the tile at the moments of the pack.
    #[inline(always)]
    fn row(&mut self, row: usize) -> &mut [MomentRow] {
        let start = row * self.stride + self.pack.start;
        &mut self.rows[start..start + self.pack.len()]
    }

    /// Note which moments have a pixel with transmittance left, and whether any has.
    #[inline(always)]
    fn any_alive<S: Simd>(&mut self, simd: S, alive: &mut Column) -> bool {
        *alive = [0.0; PACK];
        let mut any = false;
        for j in 0..self.pack.len() {
            let mut most = simd.splat_f32s(-1.0);
            for row in 0..TILE {
                for v in 0..TILE / S::F32_LANES {
                    let transmittance = &self.row(row)[j].transmittance;
                    most = simd.max_f32s(most, S::as_simd_f32s(transmittance).0[v]);
                }
            }
            if simd.reduce_max_f32s(most) > 0.0 {
                (alive[j], any) = (1.0, true);
            }
        }
        any
    }
}

/// Compositing of one tile; returns the number of entries visited.
struct Composite<'a> {
    settings: &'a RasterSettings,
    stage: Stage<'a>,
    /// `transmittance_min` times the weights of the moments.
    minimum: Vec<f32>,
    states: States<'a>,
    rows: &'a mut [[Row; PLANES]; TILE],
}

impl WithSimd for Composite<'_> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> usize {
        let Self { stage, mut states, rows, .. } = self;
        let mut limits = [Limits::new(simd, self.settings); PACK];
        for (limits, minimum) in limits.iter_mut().zip(&self.minimum) {
            limits.transmittance_min = simd.splat_f32s(*minimum);
        }
        let (mut moving, mut alive) =
            ([MovingSplat::default(); BATCH], moving_splat::all_alive(stage.times));
        let mut visited = 0;
        while visited < stage.list.len() && states.any_alive(simd, &mut alive) {
            let count = stage.load(simd, visited, &alive, &mut moving);
            for moving_splat in &moving[..count] {
                let blend = Blend {
                    limits: &limits,
                    moving_splat,
                    value: Value::new(simd, &moving_splat.splat),
                    order: simd.splat_f32s(visited as f32),
                };
                let [first, end] = moving_splat.rows;
                for row in first..end {
                    blend.row(simd, row, states.row(row), &mut rows[row]);
                }
                visited += 1;
            }
        }
        visited
    }
}

/// A splat to composite.
struct Blend<'a, S: Simd> {
    limits: &'a [Limits<S>; PACK],
    moving_splat: &'a MovingSplat,
    value: Value<S>,
    /// Its place in the tile's list.
    order: S::f32s,
}

impl<S: Simd> Blend<'_, S> {
    /// Composites all moments onto one row.
    #[inline(always)]
    fn row(&self, simd: S, row: usize, states: &mut [MomentRow], planes: &mut [Row; PLANES]) {
        for v in 0..TILE / S::F32_LANES {
            let zero = simd.splat_f32s(0.0);
            let (mut weights, mut depths) = (zero, S::as_simd_f32s(&planes[4]).0[v]);
            for (j, state) in states.iter_mut().enumerate().take(PACK) {
                if !self.moving_splat.touches(j, row) {
                    continue;
                }
                let exponent = self.moving_splat.exponent(simd, row, j);
                let dx = exponent.dx(simd, v);
                let alpha = simd.min_f32s(exponent.alpha(simd, dx), self.limits[j].alpha_max);
                let transmittance = &mut S::as_mut_simd_f32s(&mut state.transmittance).0[v];
                let step = advance(simd, &self.limits[j], alpha, *transmittance);
                let lit = simd.greater_than_f32s(*transmittance, zero);
                let ends = simd.and_m32s(lit, simd.less_than_f32s(step.next, zero));
                if simd.first_true_m32s(ends) < S::F32_LANES {
                    let ended = &mut S::as_mut_simd_f32s(&mut state.ended).0[v];
                    *ended = simd.select_f32s(ends, self.order, *ended);
                }
                *transmittance = step.next;
                weights = simd.add_f32s(weights, step.weight);
                let depth = self.value.depth(simd, dx, exponent.dy);
                depths = simd.mul_add_e_f32s(step.weight, depth, depths);
            }
            for k in 0..3 {
                let plane = &mut S::as_mut_simd_f32s(&mut planes[1 + k]).0[v];
                *plane = simd.mul_add_e_f32s(weights, self.value.radiance[k], *plane);
            }
            S::as_mut_simd_f32s(&mut planes[4]).0[v] = depths;
        }
    }
}

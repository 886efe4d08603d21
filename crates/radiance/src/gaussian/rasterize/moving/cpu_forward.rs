//! Compositing of all moments of a tile.

use super::clock::{Clock, TileTimes, Touched};
use super::{MomentPixels, PACK};
use crate::gaussian::RasterSettings;
use crate::gaussian::bin::{Bins, Entry, TILE, TileGrid};
use crate::gaussian::project::{Path, Splat};
use crate::gaussian::rasterize::cpu_forward::{
    Exponent, ExponentRow, LOOK, Limits, Value, advance,
};
use crate::gaussian::rasterize::tile::{PLANES, Row, TilePixels};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// What both directions need.
pub(crate) struct Scene<'a> {
    pub(crate) arch: Arch,
    pub(crate) settings: &'a RasterSettings,
    pub(crate) grid: &'a TileGrid,
    pub(crate) clock: &'a Clock,
    pub(crate) splats: &'a [Splat],
    pub(crate) paths: &'a [Path<f32>],
    pub(crate) bins: &'a Bins,
}

/// Composite all tiles. `states` holds the moments of the first tile, then of the second.
pub(crate) fn render(scene: &Scene<'_>, tiles: &mut [TilePixels], states: &mut [MomentPixels]) {
    let count = scene.clock.moments.len();
    if count == 0 {
        // Nothing is seen: the transmittance is 1 everywhere.
        tiles.par_iter_mut().for_each(|tile| {
            tile.rows = [[[0.0; TILE]; PLANES]; TILE];
            tile.rows.iter_mut().for_each(|row| row[0] = [1.0; TILE]);
        });
        return;
    }
    let work = tiles.par_iter_mut().zip(states.par_chunks_mut(count)).enumerate();
    work.for_each(|(number, (tile, states))| render_tile(scene, number, tile, states));
}

fn render_tile(
    scene: &Scene<'_>,
    number: usize,
    tile: &mut TilePixels,
    states: &mut [MomentPixels],
) {
    let Scene { settings, splats, paths, bins, grid, .. } = *scene;
    tile.rows = [[[0.0; TILE]; PLANES]; TILE];
    tile.visited = 0;
    let rows = &mut tile.rows;
    for (moments, states) in scene.clock.moments.chunks(PACK).zip(states.chunks_mut(PACK)) {
        let times = scene.clock.tile(moments, grid, number);
        let weights = moments.iter().map(|moment| moment.weight);
        let origin = start(grid, number, weights.clone(), states);
        let transmittance_min = weights.map(|weight| settings.transmittance_min * weight).collect();
        let visited = scene.arch.dispatch(Composite {
            settings,
            splats,
            paths,
            list: bins.list(number),
            origin,
            times: &times,
            transmittance_min,
            states,
            rows,
        });
        tile.visited = tile.visited.max(visited);
    }
    for state in states.iter() {
        for (row, transmittance) in tile.rows.iter_mut().zip(&state.transmittance) {
            (0..TILE).for_each(|i| row[0][i] += transmittance[i].abs());
        }
    }
}

/// Set the moments of a tile to nothing seen yet; pixels outside of the image have ended. Gives
/// the centre of the tile's first pixel.
fn start(
    grid: &TileGrid,
    number: usize,
    weights: impl Iterator<Item = f32>,
    states: &mut [MomentPixels],
) -> [f32; 2] {
    let (column, row) = (number % grid.columns * TILE, number / grid.columns * TILE);
    for (state, weight) in states.iter_mut().zip(weights) {
        for j in 0..TILE {
            let inside = if row + j < grid.height { grid.width - column } else { 0 };
            for i in 0..TILE {
                let (transmittance, ended) =
                    if i < inside { (weight, f32::MAX) } else { (-weight, -1.0) };
                (state.transmittance[j][i], state.ended[j][i]) = (transmittance, ended);
            }
        }
    }
    [column as f32 + 0.5, row as f32 + 0.5]
}

/// One tile's compositing; gives the number of entries visited.
struct Composite<'a, L> {
    settings: &'a RasterSettings,
    splats: &'a [Splat],
    paths: &'a [Path<f32>],
    list: L,
    /// Centre of the tile's first pixel \[px\].
    origin: [f32; 2],
    times: &'a TileTimes,
    /// The setting times the weights of the moments.
    transmittance_min: Vec<f32>,
    states: &'a mut [MomentPixels],
    rows: &'a mut [[Row; PLANES]; TILE],
}

impl<L: Iterator<Item = Entry>> WithSimd for Composite<'_, L> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> usize {
        let Self { settings, splats, paths, list, origin, times, states, rows, .. } = self;
        let mut limits = [Limits::new(simd, settings); PACK];
        for (limits, minimum) in limits.iter_mut().zip(&self.transmittance_min) {
            limits.transmittance_min = simd.splat_f32s(*minimum);
        }
        let mut alive = [true; PACK];
        let mut visited = 0;
        for entry in list {
            if visited % LOOK == LOOK - 1 && !any_alive(states, &mut alive) {
                break;
            }
            let (splat, path) = (&splats[entry.splat()], &paths[entry.splat()]);
            let touched = Touched::of(simd, splat, path, times, origin, &alive);
            let order = simd.splat_f32s(visited as f32);
            visited += 1;
            let [first, end] = touched.rows;
            let value = Value::new(simd, splat);
            for row in first..end {
                let moving = MovingRow { splat, path, origin, times, row };
                let target = &mut rows[row];
                composite_row(simd, &limits, &touched, &moving, &value, order, states, target);
            }
        }
        visited
    }
}

/// Note which moments have a pixel with transmittance left, and whether any has.
#[inline(always)]
fn any_alive(states: &[MomentPixels], alive: &mut [bool; PACK]) -> bool {
    let mut any = false;
    for (state, alive) in states.iter().zip(alive) {
        let rows = &state.transmittance;
        *alive = rows
            .iter()
            .any(|row| row.iter().fold(-1.0_f32, |m, transmittance| m.max(*transmittance)) > 0.0);
        any |= *alive;
    }
    any
}

/// A splat on one row of a tile, at any moment.
pub(super) struct MovingRow<'a> {
    pub(super) splat: &'a Splat,
    pub(super) path: &'a Path<f32>,
    pub(super) origin: [f32; 2],
    pub(super) times: &'a TileTimes,
    pub(super) row: usize,
}

impl MovingRow<'_> {
    /// When the row looks.
    #[inline(always)]
    pub(super) fn time(&self, moment: usize) -> f32 {
        self.times.rows[self.row][moment]
    }

    /// `log₂ α` along the row.
    #[inline(always)]
    pub(super) fn exponent<S: Simd>(&self, simd: S, moment: usize) -> ExponentRow<S> {
        let (s, path) = (self.time(moment), self.path);
        let centre = [
            self.splat.centre[0] + s * (path.velocity[0] + s * path.curvature[0]),
            self.splat.centre[1] + s * (path.velocity[1] + s * path.curvature[1]),
        ];
        Exponent::at(simd, self.splat, centre, self.origin).row(simd, self.row)
    }
}

/// Composite one splat at all moments onto one row.
#[inline(always)]
fn composite_row<S: Simd>(
    simd: S,
    limits: &[Limits<S>; PACK],
    touched: &Touched,
    moving: &MovingRow<'_>,
    value: &Value<S>,
    order: S::f32s,
    states: &mut [MomentPixels],
    planes: &mut [Row; PLANES],
) {
    let row = moving.row;
    for v in 0..TILE / S::F32_LANES {
        let mut weights = simd.splat_f32s(0.0);
        for (j, state) in states.iter_mut().enumerate() {
            if !touched.contains(j, row) {
                continue;
            }
            let exponent = moving.exponent(simd, j);
            let alpha = exponent.alpha(simd, exponent.dx(simd, v));
            let alpha = simd.min_f32s(alpha, limits[j].alpha_max);
            let transmittance = &mut S::as_mut_simd_f32s(&mut state.transmittance[row]).0[v];
            let step = advance(simd, &limits[j], alpha, *transmittance);
            let lit = simd.greater_than_f32s(*transmittance, simd.splat_f32s(0.0));
            let dark = simd.less_than_f32s(step.next, simd.splat_f32s(0.0));
            let ends = simd.and_m32s(lit, dark);
            if simd.first_true_m32s(ends) < S::F32_LANES {
                let ended = &mut S::as_mut_simd_f32s(&mut state.ended[row]).0[v];
                *ended = simd.select_f32s(ends, order, *ended);
            }
            *transmittance = step.next;
            weights = simd.add_f32s(weights, step.weight);
        }
        for k in 0..PLANES - 1 {
            let plane = &mut S::as_mut_simd_f32s(&mut planes[1 + k]).0[v];
            *plane = simd.mul_add_e_f32s(weights, value.0[k], *plane);
        }
    }
}

//! Compositing on the CPU: tile by tile, splat by splat, row by row.
//!
//! The state of a tile's pixels stays in the first-level cache while its splats pass in order of
//! depth; a splat touches only the rows of its ellipse, a whole row of the tile at a time. A
//! pixel that has ended keeps its transmittance with the sign turned: every later product with it
//! falls under `transmittance_min`, so no other flag is needed.

use super::tile::{PLANES, Row, TilePixels, start};
use crate::gaussian::RasterSettings;
use crate::gaussian::bin::{Bins, Entry, TILE, TileGrid};
use crate::gaussian::project::Splat;
use i2slam_compute::simd::exp2;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Splats between two checks whether all pixels have ended.
pub(super) const LOOK: usize = 32;

pub(crate) fn render(
    arch: Arch,
    settings: &RasterSettings,
    grid: &TileGrid,
    splats: &[Splat],
    bins: &Bins,
    tiles: &mut [TilePixels],
) {
    tiles.par_iter_mut().enumerate().for_each(|(number, tile)| {
        let origin = start(tile, grid, number);
        let rows = &mut tile.rows;
        tile.visited =
            arch.dispatch(Composite { settings, splats, list: bins.list(number), origin, rows });
    });
}

/// Compositing of one tile; returns the number of entries visited.
struct Composite<'a, L> {
    settings: &'a RasterSettings,
    splats: &'a [Splat],
    list: L,
    /// Centre of the tile's first pixel \[px\].
    origin: [f32; 2],
    rows: &'a mut [[Row; PLANES]; TILE],
}

impl<L: Iterator<Item = Entry>> WithSimd for Composite<'_, L> {
    type Output = usize;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> usize {
        let limits = Limits::new(simd, self.settings);
        let mut visited = 0;
        for entry in self.list {
            if visited % LOOK == LOOK - 1 && all_ended(self.rows) {
                break;
            }
            visited += 1;
            let splat = &self.splats[entry.splat()];
            let exponent = Exponent::new(simd, splat, self.origin);
            let [first, end] = entry.rows();
            let value = Value::new(simd, splat);
            for (j, row) in self.rows[first..end].iter_mut().enumerate() {
                composite_row(simd, &limits, &exponent.row(simd, first + j), &value, row);
            }
        }
        visited
    }
}

/// True if no pixel of the tile has transmittance left.
#[inline(always)]
fn all_ended(rows: &[[Row; PLANES]; TILE]) -> bool {
    rows.iter().all(|row| row[0].iter().fold(-1.0_f32, |m, t| m.max(*t)) < 0.0)
}

/// The settings in vectors.
#[derive(Clone, Copy)]
pub(super) struct Limits<S: Simd> {
    pub(super) alpha_max: S::f32s,
    pub(super) alpha_min: S::f32s,
    pub(super) transmittance_min: S::f32s,
}

impl<S: Simd> Limits<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, settings: &RasterSettings) -> Self {
        Self {
            alpha_max: simd.splat_f32s(settings.alpha_max),
            alpha_min: simd.splat_f32s(settings.alpha_min),
            transmittance_min: simd.splat_f32s(settings.transmittance_min),
        }
    }
}

/// `log₂ α` of a splat as a function of the pixel within a tile.
pub(super) struct Exponent<S: Simd> {
    a: S::f32s,
    b: S::f32s,
    c: S::f32s,
    log2_opacity: S::f32s,
    /// From the centre to the tile's first pixels.
    first: S::f32s,
    /// From the centre to the tile's first row.
    top: f32,
}

/// `log₂ α = (a dx + slope) dx + base` along one row.
pub(super) struct ExponentRow<S: Simd> {
    pub(super) a: S::f32s,
    pub(super) slope: S::f32s,
    pub(super) base: S::f32s,
    /// From the centre to the tile's first pixels.
    pub(super) first: S::f32s,
    /// From the centre to the row.
    pub(super) dy: S::f32s,
}

pub(super) const COLUMNS: Row = {
    let mut columns = [0.0; TILE];
    let mut i = 0;
    while i < TILE {
        columns[i] = i as f32;
        i += 1;
    }
    columns
};

impl<S: Simd> Exponent<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, splat: &Splat, origin: [f32; 2]) -> Self {
        let [a, b, c] = splat.exponent;
        let columns = S::as_simd_f32s(&COLUMNS).0[0];
        Self {
            a: simd.splat_f32s(a),
            b: simd.splat_f32s(b),
            c: simd.splat_f32s(c),
            log2_opacity: simd.splat_f32s(splat.log2_opacity),
            first: simd.add_f32s(columns, simd.splat_f32s(origin[0] - splat.centre[0])),
            top: origin[1] - splat.centre[1],
        }
    }

    #[inline(always)]
    pub(super) fn row(&self, simd: S, row: usize) -> ExponentRow<S> {
        let dy = simd.splat_f32s(self.top + row as f32);
        ExponentRow {
            a: self.a,
            slope: simd.mul_f32s(self.b, dy),
            base: simd.mul_add_e_f32s(simd.mul_f32s(self.c, dy), dy, self.log2_opacity),
            first: self.first,
            dy,
        }
    }
}

impl<S: Simd> ExponentRow<S> {
    /// Horizontal offset from the centre, for the vector of pixels with this number.
    #[inline(always)]
    pub(super) fn dx(&self, simd: S, vector: usize) -> S::f32s {
        simd.add_f32s(self.first, simd.splat_f32s((vector * S::F32_LANES) as f32))
    }

    /// `α` before `alpha_max`.
    #[inline(always)]
    pub(super) fn alpha(&self, simd: S, dx: S::f32s) -> S::f32s {
        let inner = simd.mul_add_e_f32s(self.a, dx, self.slope);
        exp2(simd, simd.mul_add_e_f32s(inner, dx, self.base))
    }
}

/// Radiance and depth of a splat, in vectors.
pub(super) struct Value<S: Simd> {
    pub(super) radiance: [S::f32s; 3],
    /// Depth at the centre, and its changes by column and row.
    depth: S::f32s,
    depth_slope: [S::f32s; 2],
}

impl<S: Simd> Value<S> {
    #[inline(always)]
    pub(super) fn new(simd: S, splat: &Splat) -> Self {
        let ([r, g, b], [x, y]) = (splat.radiance, splat.depth_slope);
        Self {
            radiance: [simd.splat_f32s(r), simd.splat_f32s(g), simd.splat_f32s(b)],
            depth: simd.splat_f32s(splat.depth),
            depth_slope: [simd.splat_f32s(x), simd.splat_f32s(y)],
        }
    }

    /// Depth at an offset from the centre.
    #[inline(always)]
    pub(super) fn depth(&self, simd: S, dx: S::f32s, dy: S::f32s) -> S::f32s {
        let [x, y] = self.depth_slope;
        simd.mul_add_e_f32s(x, dx, simd.mul_add_e_f32s(y, dy, self.depth))
    }
}

/// Composites one splat onto one row.
#[inline(always)]
fn composite_row<S: Simd>(
    simd: S,
    limits: &Limits<S>,
    exponent: &ExponentRow<S>,
    value: &Value<S>,
    row: &mut [Row; PLANES],
) {
    let [transmittance, planes @ ..] = row;
    let transmittance = S::as_mut_simd_f32s(transmittance).0;
    let [r, g, b, z] = planes;
    let planes = [
        S::as_mut_simd_f32s(r).0,
        S::as_mut_simd_f32s(g).0,
        S::as_mut_simd_f32s(b).0,
        S::as_mut_simd_f32s(z).0,
    ];
    for v in 0..TILE / S::F32_LANES {
        let dx = exponent.dx(simd, v);
        let alpha = simd.min_f32s(exponent.alpha(simd, dx), limits.alpha_max);
        let step = advance(simd, limits, alpha, transmittance[v]);
        transmittance[v] = step.next;
        for k in 0..3 {
            planes[k][v] = simd.mul_add_e_f32s(step.weight, value.radiance[k], planes[k][v]);
        }
        let depth = value.depth(simd, dx, exponent.dy);
        planes[3][v] = simd.mul_add_e_f32s(step.weight, depth, planes[3][v]);
    }
}

/// Effect of one contribution on a vector of pixels.
pub(super) struct Step<S: Simd> {
    /// The transmittance behind it, with the sign turned where pixels ended.
    pub(super) next: S::f32s,
    /// `α T`, zero where there is no contribution.
    pub(super) weight: S::f32s,
    /// True where the splat contributes.
    pub(super) counts: S::m32s,
}

/// The rules of `alpha_min` and `transmittance_min`.
#[inline(always)]
pub(super) fn advance<S: Simd>(
    simd: S,
    limits: &Limits<S>,
    alpha: S::f32s,
    transmittance: S::f32s,
) -> Step<S> {
    let zero = simd.splat_f32s(0.0);
    let weight = simd.mul_f32s(alpha, transmittance);
    let behind = simd.sub_f32s(transmittance, weight);
    let visible = simd.greater_than_or_equal_f32s(alpha, limits.alpha_min);
    let goes_on = simd.greater_than_or_equal_f32s(behind, limits.transmittance_min);
    let ended = simd.or_f32s(transmittance, simd.splat_f32s(-0.0));
    let counts = simd.and_m32s(visible, goes_on);
    let next = simd.select_f32s(goes_on, behind, ended);
    Step {
        next: simd.select_f32s(visible, next, transmittance),
        weight: simd.select_f32s(counts, weight, zero),
        counts,
    }
}

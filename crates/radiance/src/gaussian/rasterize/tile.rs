//! The pixels of a tile, and how they become a picture.

use crate::gaussian::Render;
use crate::gaussian::bin::{TILE, TileGrid};
use rayon::prelude::*;

/// Pixels of one row of a tile.
pub(crate) type Row = [f32; TILE];

/// Planes of a tile's state: transmittance, red, green, blue, depth.
pub(crate) const PLANES: usize = 5;
/// The pixels of one tile after compositing.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(crate) struct TilePixels {
    /// Row by row, plane by plane.
    pub(crate) rows: [[Row; PLANES]; TILE],
    /// Entries of the tile's list that were looked at before all its pixels had ended.
    pub(crate) visited: usize,
}

impl Default for TilePixels {
    fn default() -> Self {
        Self { rows: [[[0.0; TILE]; PLANES]; TILE], visited: 0 }
    }
}

/// Sets a tile to nothing seen yet and ended outside of the image; gives its first pixel's centre.
pub(crate) fn start(tile: &mut TilePixels, grid: &TileGrid, number: usize) -> [f32; 2] {
    let (column, row) = (number % grid.columns * TILE, number / grid.columns * TILE);
    tile.rows = [[[0.0; TILE]; PLANES]; TILE];
    for (j, planes) in tile.rows.iter_mut().enumerate() {
        let inside = if row + j < grid.height { grid.width - column } else { 0 };
        for (i, transmittance) in planes[0].iter_mut().enumerate() {
            *transmittance = if i < inside { 1.0 } else { -1.0 };
        }
    }
    [column as f32 + 0.5, row as f32 + 0.5]
}

/// From tiles to planes; tiles that `mask` leaves out are black.
pub(crate) fn copy_out(
    grid: &TileGrid,
    tiles: &[TilePixels],
    mask: Option<&[bool]>,
    out: &mut Render,
) {
    out.resize(grid.width, grid.height);
    if grid.len() == 0 {
        return;
    }
    let (width, band) = (grid.width, grid.width * TILE);
    let (red, rest) = out.radiance.data.split_at_mut(width * grid.height);
    let (green, blue) = rest.split_at_mut(width * grid.height);
    let bands = (red.par_chunks_mut(band), green.par_chunks_mut(band), blue.par_chunks_mut(band));
    let scalars = (out.depth.data.par_chunks_mut(band), out.opacity.data.par_chunks_mut(band));
    let work = tiles.par_chunks(grid.columns).zip(bands.into_par_iter()).zip(scalars);
    work.enumerate().for_each(|(row, ((tiles, (r, g, b)), (z, opacity)))| {
        if mask.is_some() {
            for plane in [&mut *r, &mut *g, &mut *b, &mut *z, &mut *opacity] {
                plane.fill(0.0);
            }
        }
        for j in 0..r.len() / width {
            for (column, tile) in tiles.iter().enumerate() {
                if mask.is_some_and(|mask| !mask[row * grid.columns + column]) {
                    continue;
                }
                let [t, planes @ ..] = &tile.rows[j];
                let at = j * width + column * TILE;
                let end = (at + TILE).min((j + 1) * width);
                let targets = [&mut *r, &mut *g, &mut *b, &mut *z];
                for (target, plane) in targets.into_iter().zip(planes) {
                    target[at..end].copy_from_slice(&plane[..end - at]);
                }
                opacity[at..end].iter_mut().zip(t).for_each(|(o, t)| *o = 1.0 - t.abs());
            }
        }
    });
}

//! Which Gaussians may show in wanted tiles, from bounds that cost less than their footprints.

use super::CHUNK;
use super::cpu_forward::{Project, half, store_box, tiles_within};
use super::cpu_motion::MotionFrame;
use super::stages::{Frame, Parameters};
use crate::gaussian::bin::TileGrid;
use crate::gaussian::{GaussianMap, Shape, sort};
use i2slam_compute::simd::{Column, Lanes};
use pulp::Simd;
use std::f32::consts::LN_2;

const _: () = assert!(CHUNK == 256, "a byte tells the row of a chunk");

/// All rows of a chunk.
pub(super) const ALL: [u8; CHUNK] = {
    let mut rows = [0; CHUNK];
    let mut row = 0;
    while row < CHUNK {
        rows[row] = row as u8;
        row += 1;
    }
    rows
};

/// The wanted tiles of a picture.
pub(super) struct Wanted<'a> {
    /// Row by row.
    pub(super) tiles: &'a [bool],
    stride: usize,
    /// For each corner of tiles, row by row: how many wanted ones are above it on its left.
    counts: Vec<u32>,
}

impl<'a> Wanted<'a> {
    pub(super) fn new(grid: &TileGrid, tiles: &'a [bool]) -> Self {
        let stride = grid.columns + 1;
        let mut counts = vec![0; stride * (grid.rows + 1)];
        for (row, tiles) in tiles.chunks(grid.columns.max(1)).enumerate() {
            let mut along = 0;
            for (column, &wanted) in tiles.iter().enumerate() {
                along += u32::from(wanted);
                let corner = row * stride + column + 1;
                counts[corner + stride] = counts[corner] + along;
            }
        }
        Self { tiles, stride, counts }
    }

    /// Whether any is wanted in a box of tiles (first column, first row, end column, end row).
    #[inline(always)]
    fn any(&self, [x0, y0, x1, y1]: [usize; 4]) -> bool {
        let count = |x: usize, y: usize| self.counts[y * self.stride + x];
        count(x1, y1) + count(x0, y0) > count(x1, y0) + count(x0, y1)
    }
}

/// Boxes around the moving footprints of a group: those of opaque balls with the largest standard
/// deviation.
#[derive(Default)]
struct Bounds {
    parameters: Parameters,
    /// First column, first row, end column, end row of the pixels within.
    pixels: [Column; 4],
}

impl Bounds {
    /// Put the Gaussian at `index` of the map at `place` of the group.
    #[inline(always)]
    fn set(&mut self, place: usize, map: &GaussianMap, index: usize) {
        let (mean, [s0, s1, s2]) = (&map.means[index], map.log_scales[index]);
        let Parameters { mean: columns, log_scale, .. } = &mut self.parameters;
        (0..3).for_each(|k| columns[k][place] = mean[k]);
        let several = map.shape == Shape::Anisotropic;
        log_scale[0][place] = if several { s0.max(s1).max(s2) } else { s0 };
    }

    /// Find the boxes, and tell whether there are any. There are none where the projection leaves a
    /// Gaussian out.
    #[inline(always)]
    fn find<S: Simd>(
        &mut self,
        simd: S,
        frame: &Frame,
        motion: &MotionFrame,
        grid: &TileGrid,
    ) -> bool {
        let stages = frame.stages::<S, false>(simd, &self.parameters);
        let [xx, _, yy] = stages.covariance(frame.settings.screen_variance);
        let reach2 = -2.0 * LN_2 * frame.log2_alpha_min;
        // A little more than the footprint's own extent, whose numbers are rounded otherwise.
        let extent = [xx, yy].map(|v| half(v.scale(1.001 * reach2)) + v.constant(0.01));
        let centre = frame.centre(&stages);
        let path = motion.path(simd, &self.parameters, centre);
        let depth = stages.p[2].within(frame.settings.near, frame.settings.far);
        let known = (extent[0] + extent[1]).within(0.0, f32::INFINITY);
        let accepted = depth & known & path.accepted;
        let shifts = motion.sweep(&path, centre[1], extent[1]);
        store_box(&mut self.pixels, grid, centre, shifts, extent, accepted);
        let [left, top, right, bottom] = Lanes::load_all(simd, &self.pixels);
        let (width, height) = (right - left, bottom - top);
        accepted.keep(width.min(height)).reduce_max() > 0.0
    }
}

impl Project<'_> {
    /// Put the rows of the Gaussians that may show in wanted tiles first; gives how many there are.
    #[inline(always)]
    pub(super) fn choose<S: Simd>(
        &self,
        simd: S,
        wanted: &Wanted<'_>,
        motion: &MotionFrame,
        chosen: &mut [u8; CHUNK],
    ) -> usize {
        let mut bounds = Bounds::default();
        let (mut rows, mut count) = (ALL, 0);
        let candidates = self.candidates(&mut rows);
        for rows in rows[..candidates].chunks(S::F32_LANES) {
            for (place, &row) in rows.iter().enumerate() {
                bounds.set(place, self.map, self.start + usize::from(row));
            }
            if bounds.find(simd, self.frame, motion, self.grid) {
                for (place, &row) in rows.iter().enumerate() {
                    chosen[count] = row;
                    count += usize::from(wanted.any(tiles_within(&bounds.pixels, place)));
                }
            }
        }
        count
    }

    /// Put the rows of the Gaussians that are asked first; gives how many there are.
    #[inline(always)]
    fn candidates(&self, rows: &mut [u8; CHUNK]) -> usize {
        let Some(shown) = self.shown else { return self.splats.len() };
        for (row, &item) in rows.iter_mut().zip(shown) {
            *row = (sort::index(item) - self.start) as u8;
        }
        shown.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_are_asked_of_sums() {
        let grid = TileGrid { width: 60, height: 40, columns: 4, rows: 3 };
        let tiles: Vec<_> = (0..12).map(|number| number % 5 == 1).collect();
        let wanted = Wanted::new(&grid, &tiles);
        for (x0, x1) in (0..5).flat_map(|x0| (x0..5).map(move |x1| (x0, x1))) {
            for (y0, y1) in (0..4).flat_map(|y0| (y0..4).map(move |y1| (y0, y1))) {
                let any = (y0..y1).any(|y| (x0..x1).any(|x| tiles[y * 4 + x]));
                assert_eq!(wanted.any([x0, y0, x1, y1]), any);
            }
        }
    }
}

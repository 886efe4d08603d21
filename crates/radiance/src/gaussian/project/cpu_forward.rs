//! The projection of all Gaussians, in groups of one vector, on all threads.
//!
//! With a tile mask, Gaussians that may touch marked tiles are found first, from bounds that cost
//! less than their footprints.

use super::path::Path;
use super::path::{MotionFrame, PathColumns};
use super::stages::{Frame, Parameters, put, symmetric_product};
use super::{CHUNK, Chunk, Splat};
use crate::gaussian::bin::{TILE, TileGrid};
use crate::gaussian::{ColourActivation, GaussianMap, RasterSettings, Shape, View, sort};
use i2slam_compute::simd::{Column, Lanes, Mask, nearest};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;
use std::f32::consts::{LN_2, LOG2_E};

/// Outputs of the projection of a map, and what limits it.
pub(crate) struct Projection<'a> {
    /// By the index of the Gaussian; undefined for those that are `visible` in no chunk.
    pub(crate) splats: &'a mut Vec<Splat>,
    pub(crate) chunks: &'a mut Vec<Chunk>,
    /// One per splat when the camera moves.
    pub(crate) paths: &'a mut Vec<Path<f32>>,
    /// Tiles to draw, if not all.
    pub(crate) mask: Option<&'a [bool]>,
    /// Chunks whose `visible` Gaussians are the only candidates, if known.
    pub(crate) candidates: Option<&'a [Chunk]>,
}

/// Projects the map, with the paths of its splats when the camera moves.
pub(crate) fn project(
    arch: Arch,
    map: &GaussianMap,
    view: &View<f32>,
    motion: Option<&MotionFrame>,
    settings: &RasterSettings,
    Projection { splats, chunks, paths, mask, candidates }: Projection<'_>,
) {
    let (grid, frame) = (TileGrid::of(&view.camera), Frame::new(map, view, settings));
    splats.resize(map.len(), Splat::default());
    chunks.resize_with(map.len().div_ceil(CHUNK), Chunk::default);
    paths.resize(if motion.is_some() { map.len() } else { 0 }, Path::default());
    let mask = mask.map(|mask| TileMask::new(&grid, mask));
    let work = splats.par_chunks_mut(CHUNK).zip(chunks.par_iter_mut()).enumerate();
    let (frame, grid, mask) = (&frame, &grid, mask.as_ref());
    let project = |number: usize, splats, chunk: &mut Chunk, moving| {
        chunk.visible.clear();
        chunk.tile_count = 0;
        let (start, candidates) =
            (number * CHUNK, candidates.map(|chunks| chunks[number].visible.as_slice()));
        arch.dispatch(Project { frame, map, grid, mask, candidates, start, splats, moving, chunk });
    };
    match motion {
        None => work.for_each(|(number, (splats, chunk))| project(number, splats, chunk, None)),
        Some(motion) => {
            work.zip(paths.par_chunks_mut(CHUNK)).for_each(|((number, (splats, chunk)), paths)| {
                project(number, splats, chunk, Some((motion, paths)))
            })
        }
    }
}

/// The projection of one chunk.
pub(super) struct Project<'a> {
    pub(super) frame: &'a Frame,
    pub(super) map: &'a GaussianMap,
    pub(super) grid: &'a TileGrid,
    mask: Option<&'a TileMask<'a>>,
    /// Sort items of the candidates, if not all Gaussians are.
    pub(super) candidates: Option<&'a [u64]>,
    /// Index of the first Gaussian.
    pub(super) start: usize,
    pub(super) splats: &'a mut [Splat],
    /// With a moving camera.
    moving: Option<(&'a MotionFrame, &'a mut [Path<f32>])>,
    chunk: &'a mut Chunk,
}

impl WithSimd for Project<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let motion = self.moving.as_ref().map(|(motion, _)| *motion);
        let (mut group, mut chosen) = (Group::default(), ALL);
        let count = match (self.mask, motion) {
            (Some(mask), Some(motion)) => self.select_rows(simd, mask, motion, &mut chosen),
            _ => self.splats.len(),
        };
        for chosen in chosen[..count].chunks(S::F32_LANES) {
            for (place, &row) in chosen.iter().enumerate() {
                let index = self.start + usize::from(row);
                group.parameters.set(place, self.map, index);
                put(&mut group.radiance, place, &self.map.colour_from(index, self.frame.origin));
            }
            match self.frame.shape {
                Shape::Isotropic => {
                    group.project::<S, false>(simd, self.frame, motion, self.grid);
                }
                Shape::Anisotropic => {
                    group.project::<S, true>(simd, self.frame, motion, self.grid);
                }
            }
            for (place, &row) in chosen.iter().enumerate() {
                self.write(&group, place, usize::from(row));
            }
        }
    }
}

impl Project<'_> {
    /// Writes what the group has at `place` to a row of the chunk.
    #[inline(always)]
    fn write(&mut self, group: &Group, place: usize, row: usize) {
        let splat = &mut self.splats[row];
        group.write(place, splat);
        if let Some(mask) = self.mask {
            splat.tiles = self.grid.masked_box(mask.tiles, splat.tiles);
        }
        splat.first_tile = self.chunk.tile_count;
        if let Some((_, paths)) = &mut self.moving {
            paths[row] = group.paths.path(place);
        }
        let count = splat.tile_count();
        if count > 0 {
            self.chunk.tile_count += count;
            self.chunk.visible.push(sort::item(splat.depth, (self.start + row) as u32));
        }
    }
}

/// Tiles of the group's pixels at `place` (first column and row, end column and row), if any.
#[inline(always)]
pub(super) fn tiles_within(pixels: &[Column; 4], place: usize) -> [usize; 4] {
    let [x0, y0, x1, y1] = take(pixels, place).map(nearest);
    if x0 >= x1 || y0 >= y1 {
        return [0; 4];
    }
    [x0 / TILE, y0 / TILE, x1.div_ceil(TILE), y1.div_ceil(TILE)]
}

/// Parameters and footprints of a group.
#[derive(Default)]
struct Group {
    parameters: Parameters,
    /// The colour, then the radiance.
    radiance: [Column; 3],
    centre: [Column; 2],
    exponent: [Column; 3],
    log2_opacity: Column,
    depth: Column,
    depth_slope: [Column; 2],
    reach: Column,
    /// First column, first row, end column, end row of the pixels within the extent.
    pixels: [Column; 4],
    /// With a moving camera.
    paths: PathColumns,
}

impl Group {
    #[inline(always)]
    fn project<S: Simd, const ANISOTROPIC: bool>(
        &mut self,
        simd: S,
        frame: &Frame,
        motion: Option<&MotionFrame>,
        grid: &TileGrid,
    ) {
        let stages = frame.stages::<S, ANISOTROPIC>(simd, &self.parameters);
        let invalid = self.invalid::<S, ANISOTROPIC>(simd);
        let invalid = invalid + self.activate(simd, frame.activation);
        let logit = Lanes::load(simd, &self.parameters.opacity_logit);
        let log2_opacity = -(logit.constant(1.0) + (-logit).exp()).log2();
        let [xx, xy, yy] = stages.covariance(frame.settings.screen_variance);
        let determinant = xx * yy - xy * xy;
        let inverse = determinant.recip();
        let conic = [yy * inverse, -(xy * inverse), xx * inverse];
        let centre = frame.centre(&stages);
        let invalid = invalid + (centre[0] + centre[1] + determinant).scale(0.0);
        let invalid = invalid + (conic[0] + conic[1] + conic[2]).scale(0.0);
        let depth = stages.p[2].within(frame.settings.near, frame.settings.far);
        let opaque = log2_opacity.within(frame.log2_alpha_min, f32::MAX);
        let accepted = depth & opaque & invalid.within(0.0, 0.0);
        let accepted = accepted & determinant.within(f32::MIN_POSITIVE, f32::MAX);

        let reach = log2_opacity - logit.constant(frame.log2_alpha_min);
        let reach2 = reach.scale(2.0 * LN_2);
        let extent = [half(reach2 * xx), half(reach2 * yy)];
        self.store_extent(grid, motion, centre, extent, accepted);
        reach.store(&mut self.reach);
        if let Some(axes) = &stages.axes {
            let slope = symmetric_product(conic, stages.depth_covariance(axes));
            (0..2).for_each(|k| slope[k].store(&mut self.depth_slope[k]));
        }
        conic[0].scale(-0.5 * LOG2_E).store(&mut self.exponent[0]);
        conic[1].scale(-LOG2_E).store(&mut self.exponent[1]);
        conic[2].scale(-0.5 * LOG2_E).store(&mut self.exponent[2]);
        log2_opacity.store(&mut self.log2_opacity);
        stages.p[2].store(&mut self.depth);
    }

    /// Stores centre, path, extent and pixels, of which there are none where not `accepted`.
    #[inline(always)]
    fn store_extent<S: Simd>(
        &mut self,
        grid: &TileGrid,
        motion: Option<&MotionFrame>,
        centre: [Lanes<S>; 2],
        extent: [Lanes<S>; 2],
        mut accepted: Mask<S>,
    ) {
        let mut shifts = [[centre[0].constant(0.0); 2]; 2];
        if let Some(motion) = motion {
            let simd = centre[0].simd();
            let path = motion.path(simd, &self.parameters, centre);
            accepted = accepted & path.accepted;
            shifts = motion.sweep(&path, centre[1], extent[1]);
            self.paths.store(&path);
        }
        for axis in 0..2 {
            centre[axis].store(&mut self.centre[axis]);
        }
        store_box(&mut self.pixels, grid, centre, shifts, extent, accepted);
    }

    /// Not zero where a parameter is not finite.
    #[inline(always)]
    fn invalid<S: Simd, const ANISOTROPIC: bool>(&self, simd: S) -> Lanes<S> {
        let [x, y, z] = Lanes::load_all(simd, &self.parameters.mean);
        let [r, g, b] = Lanes::load_all(simd, &self.radiance);
        let [s0, s1, s2] = Lanes::load_all(simd, &self.parameters.log_scale);
        let logit = Lanes::load(simd, &self.parameters.opacity_logit);
        let zero = |v: Lanes<S>| v.scale(0.0);
        let sum = zero(x) + zero(y) + zero(z) + zero(r) + zero(g) + zero(b) + zero(s0);
        let sum = sum + zero(logit);
        if ANISOTROPIC {
            let [w, x, y, z] = Lanes::load_all(simd, &self.parameters.rotation);
            return sum + zero(s1) + zero(s2) + zero(w) + zero(x) + zero(y) + zero(z);
        }
        sum
    }

    /// Turns colour into radiance; returns a non-zero number where it overflows.
    #[inline(always)]
    fn activate<S: Simd>(&mut self, simd: S, activation: ColourActivation) -> Lanes<S> {
        let mut excess = Lanes::splat(simd, 0.0);
        if activation == ColourActivation::Exponential {
            for column in &mut self.radiance {
                let colour = Lanes::load(simd, column);
                excess += colour.clamp_min(87.0) - colour.constant(87.0);
                colour.exp().store(column);
            }
        }
        excess
    }

    /// The splat of the Gaussian at `place`.
    #[inline(always)]
    fn write(&self, place: usize, splat: &mut Splat) {
        splat.tiles = tiles_within(&self.pixels, place).map(|tile| tile as u16);
        if splat.tile_count() == 0 {
            return;
        }
        splat.centre = take(&self.centre, place);
        splat.exponent = take(&self.exponent, place);
        splat.radiance = take(&self.radiance, place);
        splat.depth_slope = take(&self.depth_slope, place);
        splat.reach = self.reach[place];
        splat.log2_opacity = self.log2_opacity[place];
        splat.depth = self.depth[place];
    }
}

/// Stores the pixels within an extent around a centre that shifts; none where not `accepted`.
#[inline(always)]
pub(super) fn store_box<S: Simd>(
    pixels: &mut [Column; 4],
    grid: &TileGrid,
    centre: [Lanes<S>; 2],
    shifts: [[Lanes<S>; 2]; 2],
    extent: [Lanes<S>; 2],
    accepted: Mask<S>,
) {
    let limits = [grid.width as f32, grid.height as f32];
    for axis in 0..2 {
        let [low, high] = shifts[axis].map(|shift| centre[axis] + shift);
        let first = (low - extent[axis]).clamp_min(0.0).clamp_max(limits[axis]);
        let end = (high + extent[axis]).clamp_min(0.0).clamp_max(limits[axis]);
        first.store(&mut pixels[axis]);
        accepted.keep(end).store(&mut pixels[2 + axis]);
    }
}

/// Half an extent from its exact square, a little more to make up for rounding.
#[inline(always)]
pub(super) fn half<S: Simd>(squared: Lanes<S>) -> Lanes<S> {
    squared.sqrt().scale(1.001) + squared.constant(0.01)
}

/// The numbers of the Gaussian at one place.
#[inline(always)]
fn take<const N: usize>(columns: &[Column; N], place: usize) -> [f32; N] {
    let mut values = [0.0; N];
    for k in 0..N {
        values[k] = columns[k][place];
    }
    values
}

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

/// The marked tiles of a picture.
pub(super) struct TileMask<'a> {
    /// Row by row.
    pub(super) tiles: &'a [bool],
    stride: usize,
    /// For each corner of tiles, row by row: how many marked ones are above it on its left.
    counts: Vec<u32>,
}

impl<'a> TileMask<'a> {
    pub(super) fn new(grid: &TileGrid, tiles: &'a [bool]) -> Self {
        let stride = grid.columns + 1;
        let mut counts = vec![0; stride * (grid.rows + 1)];
        for (row, tiles) in tiles.chunks(grid.columns.max(1)).enumerate() {
            let mut along = 0;
            for (column, &mask) in tiles.iter().enumerate() {
                along += u32::from(mask);
                let corner = row * stride + column + 1;
                counts[corner + stride] = counts[corner] + along;
            }
        }
        Self { tiles, stride, counts }
    }

    /// True if any tile of a box is marked (first column, first row, end column, end row).
    #[inline(always)]
    fn any(&self, [x0, y0, x1, y1]: [usize; 4]) -> bool {
        let count = |x: usize, y: usize| self.counts[y * self.stride + x];
        count(x1, y1) + count(x0, y0) > count(x1, y0) + count(x0, y1)
    }
}

/// Boxes around moving footprints, taken as opaque balls of the largest standard deviation.
#[derive(Default)]
struct Bounds {
    parameters: Parameters,
    /// First column, first row, end column, end row of the pixels within.
    pixels: [Column; 4],
}

impl Bounds {
    /// Puts the Gaussian at `index` of the map at `place` of the group.
    #[inline(always)]
    fn set(&mut self, place: usize, map: &GaussianMap, index: usize) {
        let (mean, [s0, s1, s2]) = (&map.means[index], map.log_scales[index]);
        let Parameters { mean: columns, log_scale, .. } = &mut self.parameters;
        (0..3).for_each(|k| columns[k][place] = mean[k]);
        let several = map.shape == Shape::Anisotropic;
        log_scale[0][place] = if several { s0.max(s1).max(s2) } else { s0 };
    }

    /// Finds the boxes, and tells whether there are any.
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
    /// Writes the rows of Gaussians that may touch marked tiles, and returns their number.
    #[inline(always)]
    pub(super) fn select_rows<S: Simd>(
        &self,
        simd: S,
        mask: &TileMask<'_>,
        motion: &MotionFrame,
        chosen: &mut [u8; CHUNK],
    ) -> usize {
        let mut bounds = Bounds::default();
        let (mut rows, mut count) = (ALL, 0);
        let candidates = self.candidate_rows(&mut rows);
        for rows in rows[..candidates].chunks(S::F32_LANES) {
            for (place, &row) in rows.iter().enumerate() {
                bounds.set(place, self.map, self.start + usize::from(row));
            }
            if bounds.find(simd, self.frame, motion, self.grid) {
                for (place, &row) in rows.iter().enumerate() {
                    chosen[count] = row;
                    count += usize::from(mask.any(tiles_within(&bounds.pixels, place)));
                }
            }
        }
        count
    }

    /// Writes the rows of the candidates, and returns their number.
    #[inline(always)]
    fn candidate_rows(&self, rows: &mut [u8; CHUNK]) -> usize {
        let Some(candidates) = self.candidates else { return self.splats.len() };
        for (row, &item) in rows.iter_mut().zip(candidates) {
            *row = (sort::index(item) - self.start) as u8;
        }
        candidates.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_are_asked_of_sums() {
        let grid = TileGrid { width: 60, height: 40, columns: 4, rows: 3 };
        let tiles: Vec<_> = (0..12).map(|number| number % 5 == 1).collect();
        let mask = TileMask::new(&grid, &tiles);
        for (x0, x1) in (0..5).flat_map(|x0| (x0..5).map(move |x1| (x0, x1))) {
            for (y0, y1) in (0..4).flat_map(|y0| (y0..4).map(move |y1| (y0, y1))) {
                let any = (y0..y1).any(|y| (x0..x1).any(|x| tiles[y * 4 + x]));
                assert_eq!(mask.any([x0, y0, x1, y1]), any);
            }
        }
    }
}

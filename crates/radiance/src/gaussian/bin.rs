//! Lists of the splats of each tile, in order of depth.

use super::project::{CHUNK, Chunk, Splat};
use super::sort::{self, take};
use i2slam_compute::simd::nearest;
use i2slam_geometry::Camera;
use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

/// Width and height of a tile \[px\].
pub const TILE: usize = 16;
/// Sorted splats that one thread takes at least.
const SORTED_CHUNK: usize = 4096;

/// The tiles of an image, row by row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct TileGrid {
    /// Of the image \[px\].
    pub(crate) width: usize,
    /// Of the image \[px\].
    pub(crate) height: usize,
    /// Tiles in a row.
    pub(crate) columns: usize,
    pub(crate) rows: usize,
}

impl TileGrid {
    pub(crate) fn of<T>(camera: &Camera<T>) -> Self {
        let (width, height) = (camera.width, camera.height);
        Self { width, height, columns: width.div_ceil(TILE), rows: height.div_ceil(TILE) }
    }

    pub(crate) fn len(&self) -> usize {
        self.columns * self.rows
    }

    /// Bounding box of the marked tiles in a box (first column and row, end column and row).
    pub(crate) fn masked_box(&self, mask: &[bool], [x0, y0, x1, y1]: [u16; 4]) -> [u16; 4] {
        let mut part = [x1, y1, 0, 0];
        for row in y0..y1 {
            for column in x0..x1 {
                if mask[usize::from(row) * self.columns + usize::from(column)] {
                    let [left, top, right, _] = part;
                    part = [left.min(column), top.min(row), right.max(column + 1), row + 1];
                }
            }
        }
        if part[2] > 0 { part } else { [0; 4] }
    }
}

/// A splat in a tile: its index, and the rows of the tile that its extent may touch.
#[derive(Clone, Copy)]
pub(crate) struct Entry(u64);

impl Entry {
    fn new(splat: usize, [first, end]: [usize; 2]) -> Self {
        Self(splat as u64 | (first as u64) << 32 | (end as u64) << 40)
    }

    #[inline(always)]
    pub(crate) fn splat(self) -> usize {
        (self.0 & 0xffff_ffff) as usize
    }

    /// First and end row within the tile.
    #[inline(always)]
    pub(crate) fn rows(self) -> [usize; 2] {
        [(self.0 >> 32) as usize & 0xff, (self.0 >> 40) as usize & 0xff]
    }
}

#[derive(Clone, Copy)]
pub(crate) struct List<'a>(&'a [AtomicU64]);

impl List<'_> {
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    #[inline(always)]
    pub(crate) fn get(&self, index: usize) -> Entry {
        Entry(self.0[index].load(Relaxed))
    }
}

/// The lists of all tiles, one after another.
#[derive(Default)]
pub(crate) struct Bins {
    /// Start of each tile's list, and the end of the last.
    pub(crate) starts: Vec<u32>,
    entries: Vec<AtomicU64>,
    /// For each splat of the map in order, for each of its tiles in order: its place in `entries`.
    places: Vec<AtomicU32>,
    /// Start of the places of each chunk of splats.
    chunk_starts: Vec<u32>,
    /// One row of places in `entries`, tile by tile, per chunk of sorted splats.
    counters: Vec<AtomicU32>,
    /// One grid of corners per chunk of sorted splats, see [`Corners`].
    corners: Vec<AtomicU32>,
}

impl Bins {
    /// Number of pairs of a splat and a tile.
    pub(crate) fn len(&self) -> usize {
        self.entries.len()
    }

    #[inline(always)]
    pub(crate) fn list(&self, tile: usize) -> impl ExactSizeIterator<Item = Entry> + '_ {
        let range = self.starts[tile] as usize..self.starts[tile + 1] as usize;
        self.entries[range].iter().map(|entry| Entry(entry.load(Relaxed)))
    }

    /// The list of one tile, for access in any order.
    #[inline(always)]
    pub(crate) fn entries(&self, tile: usize) -> List<'_> {
        List(&self.entries[self.starts[tile] as usize..self.starts[tile + 1] as usize])
    }

    /// The parts of `values`, one per entry, that belong to each tile.
    pub(crate) fn by_tile<'a, T>(&self, mut values: &'a mut [T]) -> Vec<&'a mut [T]> {
        let mut parts = Vec::with_capacity(self.starts.len());
        for range in self.starts.windows(2) {
            parts.push(values.split_off_mut(..(range[1] - range[0]) as usize).unwrap_or_default());
        }
        parts
    }

    /// Positions of a splat's entries in the lists.
    #[inline(always)]
    pub(crate) fn places_of(
        &self,
        index: usize,
        splat: &Splat,
    ) -> impl Iterator<Item = usize> + '_ {
        let start = (self.chunk_starts[index / CHUNK] + splat.first_tile) as usize;
        let places = &self.places[start..start + splat.tile_count() as usize];
        places.iter().map(|place| place.load(Relaxed) as usize)
    }

    /// Fills the lists from the sorted splats; those that are `moving` have all rows of a tile.
    pub(crate) fn fill(
        &mut self,
        moving: bool,
        grid: &TileGrid,
        splats: &[Splat],
        chunks: &[Chunk],
        sorted: &[u64],
    ) {
        let total = self.start_chunks(chunks);
        self.entries.resize_with(total, AtomicU64::default);
        self.places.resize_with(total, AtomicU32::default);
        let chunk = sorted.len().div_ceil(rayon::current_num_threads()).max(SORTED_CHUNK);
        let count = sorted.len().div_ceil(chunk);
        self.counters.clear();
        self.counters.resize_with(count * grid.len(), AtomicU32::default);
        self.corners.clear();
        self.corners.resize_with(count * Corners::len(grid), AtomicU32::default);
        let rows = || self.counters.par_chunks(grid.len().max(1)).zip(sorted.par_chunks(chunk));
        rows().zip(self.corners.par_chunks(Corners::len(grid))).for_each(
            |((counters, items), corners)| {
                let corners = Corners { grid, corners };
                for items in items.chunks(FETCH) {
                    let boxes = fetch(items, |index| splats[index].tiles);
                    boxes.iter().take(items.len()).for_each(|tiles| corners.mark(*tiles));
                }
                corners.count(counters);
            },
        );
        start_lists(&mut self.starts, &self.counters, grid.len());
        rows().for_each(|(counters, items)| {
            for items in items.chunks(FETCH) {
                let fetched = fetch(items, |index| splats[index]);
                for (item, splat) in items.iter().zip(&fetched) {
                    self.scatter(moving, sort::index(*item), splat, grid, counters);
                }
            }
        });
    }

    fn start_chunks(&mut self, chunks: &[Chunk]) -> usize {
        let mut total = 0;
        self.chunk_starts.clear();
        self.chunk_starts.extend(chunks.iter().map(|chunk| {
            total += chunk.tile_count;
            total - chunk.tile_count
        }));
        total as usize
    }

    fn scatter(
        &self,
        moving: bool,
        index: usize,
        splat: &Splat,
        grid: &TileGrid,
        counters: &[AtomicU32],
    ) {
        let ellipse = Ellipse::of(splat);
        let mut place = (self.chunk_starts[index / CHUNK] + splat.first_tile) as usize;
        for_tiles(splat.tiles, grid, |tile, column, row| {
            let at = take(&counters[tile]);
            let rows = if moving { [0, TILE] } else { ellipse.rows(splat, column, row) };
            let entry = Entry::new(index, rows);
            self.entries[at as usize].store(entry.0, Relaxed);
            self.places[place].store(at, Relaxed);
            place += 1;
        });
    }
}

/// Counts the boxes over each tile from marks at their corners, +1 and -1, summed along both axes:
/// a loop over the tiles of each box would be mispredicted.
struct Corners<'a> {
    grid: &'a TileGrid,
    /// One more row and column than there are tiles.
    corners: &'a [AtomicU32],
}

impl Corners<'_> {
    fn len(grid: &TileGrid) -> usize {
        (grid.columns + 1) * (grid.rows + 1)
    }

    #[inline(always)]
    fn mark(&self, tiles: [u16; 4]) {
        let [x0, y0, x1, y1] = tiles.map(usize::from);
        let stride = self.grid.columns + 1;
        for (at, sign) in [(y0, 1), (y1, u32::MAX)] {
            add(&self.corners[at * stride + x0], sign);
            add(&self.corners[at * stride + x1], sign.wrapping_neg());
        }
    }

    /// Writes the count of each tile.
    fn count(&self, counters: &[AtomicU32]) {
        let columns = self.grid.columns;
        let stride = columns + 1;
        for row in 0..self.grid.rows {
            let mut along = 0_u32;
            for column in 0..columns {
                let mark = self.corners[row * stride + column].load(Relaxed);
                along = along.wrapping_add(mark);
                let above = match row {
                    0 => 0,
                    _ => counters[(row - 1) * columns + column].load(Relaxed),
                };
                counters[row * columns + column].store(along.wrapping_add(above), Relaxed);
            }
        }
    }
}

/// Only one thread may use the counter.
#[inline(always)]
fn add(counter: &AtomicU32, by: u32) {
    counter.store(counter.load(Relaxed).wrapping_add(by), Relaxed);
}

/// Turns counts per chunk and tile into places, and note where each tile's list starts.
fn start_lists(starts: &mut Vec<u32>, counters: &[AtomicU32], tiles: usize) {
    let mut next = 0;
    starts.clear();
    for tile in 0..tiles {
        starts.push(next);
        for counter in counters.iter().skip(tile).step_by(tiles) {
            let count = counter.load(Relaxed);
            counter.store(next, Relaxed);
            next += count;
        }
    }
    starts.push(next);
}

/// Items whose footprints are fetched together: independent loads wait for the memory once.
const FETCH: usize = 16;

/// `get` for each of up to [`FETCH`] items.
#[inline(always)]
fn fetch<T: Default>(items: &[u64], get: impl Fn(usize) -> T) -> [T; FETCH] {
    std::array::from_fn(|i| items.get(i).map_or_else(T::default, |item| get(sort::index(*item))))
}

/// Calls `f(tile, column, row)` for the tiles that a splat's box touches, row by row.
#[inline(always)]
fn for_tiles(tiles: [u16; 4], grid: &TileGrid, mut f: impl FnMut(usize, usize, usize)) {
    let [x0, y0, x1, y1] = tiles.map(usize::from);
    let (mut column, mut row) = (x0, y0);
    for _ in 0..(x1 - x0) * (y1 - y0) {
        f(row * grid.columns + column, column, row);
        let ends = column + 1 == x1;
        column = if ends { x0 } else { column + 1 };
        row += usize::from(ends);
    }
}

/// The rows that a splat's ellipse touches within the columns of a tile.
///
/// The ellipse has its lowest point at `dx = s_y h`, where `h` is half its height; within the
/// slab of the tile's columns the lowest point is at the nearest `dx`, and there the ellipse
/// spans `s_x dx ± r sqrt(1 - (dx / w)²)`, with `w` half its width and `r` half its height at
/// the column of its centre. The highest point mirrors the lowest.
pub(crate) struct Ellipse {
    /// `Σxy/Σxx`.
    pub(crate) slope: f32,
    /// `dx` of the lowest point.
    pub(crate) lowest: f32,
    /// `1 / w`.
    pub(crate) inverse_width: f32,
    /// `r`.
    pub(crate) height_at_centre: f32,
}

impl Ellipse {
    #[inline(always)]
    pub(crate) fn of(splat: &Splat) -> Self {
        let [a, b, c] = splat.exponent;
        // -a dx² - b dx dy - c dy² <= reach, with a margin for rounding as in the box of its tiles.
        let half = |squared: f32| 1.001 * squared.sqrt() + 0.01;
        let area = splat.reach / (4.0 * a * c - b * b);
        let (width, height) = (half(-4.0 * c * area), half(-4.0 * a * area));
        let height_at_centre = half(-splat.reach / c);
        let lowest = -b / (2.0 * a) * height;
        Self { slope: -b / (2.0 * c), lowest, inverse_width: width.recip(), height_at_centre }
    }

    /// First and end row of the tile that are touched.
    #[inline(always)]
    fn rows(&self, splat: &Splat, column: usize, row: usize) -> [usize; 2] {
        let left = (column * TILE) as f32 + 0.5 - splat.centre[0];
        let right = left + (TILE - 1) as f32;
        let (low, high) = (self.lowest.max(left).min(right), (-self.lowest).max(left).min(right));
        let bottom = self.slope * low + self.reach(low);
        let top = self.slope * high - self.reach(high);
        // Row j has its centre at j + 1/2.
        let start = (row * TILE) as f32 - splat.centre[1];
        let limit = |v: f32| nearest((v - start).max(0.0).min(TILE as f32));
        let (first, end) = (limit(top), limit(bottom));
        if first < end { [first, end] } else { [0, 0] }
    }

    #[inline(always)]
    fn reach(&self, dx: f32) -> f32 {
        let part = dx * self.inverse_width;
        self.height_at_centre * (1.0 - part * part).max(0.0).sqrt() + 0.01
    }
}

//! The surface of the sharp render: a small plane per pixel, and bounds of inverse depth per block.

use i2slam_geometry::{Image, Real};
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// The inverse depth around a pixel centre: `w(d) = value + slope · d`, d in pixels.
///
/// Inverse depth is affine in the image wherever the surface is flat, so this is exact there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Facet<T> {
    /// 1/m.
    pub(super) value: T,
    /// 1/m per pixel to the right.
    pub(super) slope_x: T,
    /// 1/m per pixel down.
    pub(super) slope_y: T,
    /// Largest second difference along row and column: a step shows here in full.
    pub(super) bend: T,
}

/// Inverse depth, its slopes, and where it has steps.
#[derive(Clone, Debug, Default)]
pub(super) struct Surface<T> {
    pub(super) width: usize,
    pub(super) height: usize,
    inverse: Vec<T>,
    facets: Vec<Facet<T>>,
    /// The facets' values alone, which are looked at the most.
    values: Vec<T>,
    pub(super) blocks: Blocks<T>,
}

impl<T: Real> Surface<T> {
    /// Reads plane 0 of `depth` [m]. A depth that is zero, negative or not finite takes the
    /// farther of the two nearest known depths in its row; a row without any is infinitely far.
    pub(super) fn update(&mut self, depth: &Image<T>) {
        let (width, height) = (depth.width, depth.height);
        (self.width, self.height) = (width, height);
        self.inverse.resize(width * height, T::zero());
        self.facets.resize(width * height, Facet::default());
        self.values.resize(width * height, T::zero());
        self.blocks.resize(width, height);
        if width * height == 0 {
            return;
        }
        let arch = Arch::new();
        self.inverse
            .par_chunks_mut(BLOCK * width)
            .zip(depth.plane(0).par_chunks(BLOCK * width))
            .for_each(|(inverse, depth)| {
                arch.dispatch(|| invert(depth, inverse));
                inverse.chunks_exact_mut(width).for_each(fill_holes);
            });
        let inverse = &self.inverse;
        let across = self.blocks.columns;
        self.facets
            .par_chunks_mut(BLOCK * width)
            .zip(self.values.par_chunks_mut(BLOCK * width))
            .zip(self.blocks.own.par_chunks_mut(across))
            .enumerate()
            .for_each(|(block_row, ((facets, values), blocks))| {
                let top = block_row * BLOCK;
                blocks.fill(Block::empty());
                for (y, facets) in (top..).zip(facets.chunks_exact_mut(width)) {
                    arch.dispatch(RowFacets { inverse, y, height, facets, blocks });
                }
                values.iter_mut().zip(facets).for_each(|(value, facet)| *value = facet.value);
            });
    }

    /// One row of inverse depths.
    pub(super) fn row(&self, y: usize) -> &[T] {
        &self.inverse[y * self.width..(y + 1) * self.width]
    }

    /// One row of facets.
    pub(super) fn facets(&self, y: usize) -> &[Facet<T>] {
        &self.facets[y * self.width..(y + 1) * self.width]
    }

    /// The facets of some pixels, by their indices.
    #[inline(always)]
    pub(super) fn facets_at<const N: usize>(&self, indices: &[u32; N]) -> [Facet<T>; N] {
        look_up(&self.facets, indices)
    }

    /// The values of their facets.
    #[inline(always)]
    pub(super) fn values_at<const N: usize>(&self, indices: &[u32; N]) -> [T; N] {
        look_up(&self.values, indices)
    }

    /// The facet of the pixel that covers `(x, y)` [px], and that pixel's centre. Positions
    /// outside the image take the nearest pixel.
    #[inline(always)]
    pub(super) fn facet_at(&self, x: T, y: T) -> (Facet<T>, T, T) {
        let column = clamped(x, self.width);
        let row = clamped(y, self.height);
        let half = T::of(0.5);
        let centre = |index: usize| T::of(index as f64) + half;
        (self.facets[row * self.width + column], centre(column), centre(row))
    }
}

/// Several items, of which there are some; without a branch for each index.
///
/// What `map` calls may stay a function of its own, without the vectors of its caller.
#[inline(always)]
fn look_up<V: Copy, const N: usize>(items: &[V], indices: &[u32; N]) -> [V; N] {
    assert!(!items.is_empty(), "no pixels");
    let mut found = [items[0]; N];
    for i in 0..N {
        found[i] = items[(indices[i] as usize).min(items.len() - 1)];
    }
    found
}

/// The pixel that covers a coordinate, NaN and positions outside included.
#[inline(always)]
fn clamped<T: Real>(position: T, size: usize) -> usize {
    let most = T::of(size.saturating_sub(1) as f64);
    (-larger(-larger(position, T::zero()), -most)).to_u32().unwrap_or(0) as usize
}

/// Writes `1 / depth`, 0 where the depth is unknown.
#[inline(always)]
fn invert<T: Real>(depth: &[T], inverse: &mut [T]) {
    for (w, &z) in inverse.iter_mut().zip(depth) {
        let known = z > T::zero() && z < T::infinity();
        *w = if known { T::one() / z } else { T::zero() };
    }
}

fn fill_holes<T: Real>(row: &mut [T]) {
    let mut x = 0;
    while let Some(skip) = row[x..].iter().position(|w| *w == T::zero()) {
        let start = x + skip;
        let end = row[start..].iter().position(|w| *w > T::zero()).map_or(row.len(), |n| start + n);
        let sides = [start.checked_sub(1), (end < row.len()).then_some(end)];
        let known = sides.into_iter().flatten().map(|side| row[side]);
        let far = known.reduce(T::min).unwrap_or(T::zero());
        row[start..end].fill(far);
        x = end;
    }
}

/// The facets of row `y`, and their share of the blocks.
struct RowFacets<'a, T> {
    inverse: &'a [T],
    y: usize,
    height: usize,
    facets: &'a mut [Facet<T>],
    blocks: &'a mut [Block<T>],
}

impl<T: Real> WithSimd for RowFacets<'_, T> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { inverse, y, height, facets, blocks } = self;
        let n = facets.len();
        let row = |y: usize| &inverse[y * n..(y + 1) * n];
        let rows = [row(y.saturating_sub(1)), row(y), row((y + 1).min(height - 1))];
        let sides = (y > 0, y + 1 < height);
        facets[0] = facet(rows, sides, 0, (0, 1.min(n - 1)));
        for x in 1..n.saturating_sub(1) {
            facets[x] = facet(rows, sides, x, (x - 1, x + 1));
        }
        facets[n - 1] = facet(rows, sides, n - 1, (n.saturating_sub(2), n - 1));
        let row_at = |offset: usize| (y + offset).checked_sub(2).filter(|&y| y < height).map(row);
        let around = [row_at(0), row_at(1), row_at(2), row_at(3), row_at(4)];
        for x in 0..n {
            if facets[x].bend > facets[x].value * T::of(STEP) {
                let along_row =
                    rows[1].get(x.wrapping_sub(2)..).and_then(|rest| rest.first_chunk());
                unmix(along_row.copied(), &mut facets[x], true);
                let [Some(a), Some(b), Some(c), Some(d), Some(e)] = around else { continue };
                unmix(Some([a[x], b[x], c[x], d[x], e[x]]), &mut facets[x], false);
            }
        }
        for (block, facets) in blocks.iter_mut().zip(facets.chunks(BLOCK)) {
            for facet in facets {
                block.include(facet);
            }
        }
    }
}

/// Bends beyond this share of the inverse depth may be steps.
const STEP: f64 = 0.02;

/// A pixel partly covered by a foreground holds a mixture of two depths, and that of neither
/// surface. It belongs to the foreground, which carries its soft edge along: it takes the
/// foreground's depth, continued from its neighbours.
fn unmix<T: Real>(values: Option<[T; 5]>, facet: &mut Facet<T>, in_x: bool) {
    let Some([a, b, c, d, e]) = values else { return };
    let step = (d - b).abs();
    let between = (c - b) * (d - c) > T::zero();
    if !between || (b - a).abs() + (e - d).abs() > step * T::of(0.25) {
        return;
    }
    let slope = if b > d { b - a } else { e - d };
    facet.value = if b > d { b + slope } else { d - slope };
    if in_x {
        facet.slope_x = slope;
    } else {
        facet.slope_y = slope;
    }
}

/// The facet of pixel `x` of the middle row, between its neighbours `left` and `right`.
#[inline(always)]
fn facet<T: Real>(
    [up, here, down]: [&[T]; 3],
    (has_up, has_down): (bool, bool),
    x: usize,
    (left, right): (usize, usize),
) -> Facet<T> {
    let value = here[x];
    let (slope_x, bend_x) = slope(value - here[left], here[right] - value, x > left, right > x);
    let (slope_y, bend_y) = slope(value - up[x], down[x] - value, has_up, has_down);
    Facet { value, slope_x, slope_y, bend: larger(bend_x, bend_y) }
}

/// The flatter of two one-sided differences (so that a slope never bridges a step), and their
/// difference. A missing neighbour leaves the other side alone.
#[inline(always)]
fn slope<T: Real>(before: T, after: T, has_before: bool, has_after: bool) -> (T, T) {
    let flatter = if before.abs() < after.abs() { before } else { after };
    let both = has_before && has_after;
    let value = if both {
        flatter
    } else if has_before {
        before
    } else {
        after
    };
    (value, if both { (after - before).abs() } else { T::zero() })
}

/// Side of a block [px].
pub(super) const BLOCK: usize = 4;

/// Depth steps whose sides move apart by less than this are not searched [px].
const VISIBLE_STEP: f64 = 0.5;

/// Largest distance [blocks] at which a block searches for depth steps (64 px).
const MAX_REACH: f64 = 16.0;

/// Bounds of inverse depth [1/m] and the largest bend of some pixels.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block<T> {
    pub(super) nearest: T,
    pub(super) farthest: T,
    pub(super) bend: T,
}

impl<T: Real> Block<T> {
    pub(super) fn empty() -> Self {
        Self { nearest: T::zero(), farthest: T::infinity(), bend: T::zero() }
    }

    #[inline(always)]
    pub(super) fn include(&mut self, facet: &Facet<T>) {
        self.merge(&Self { nearest: facet.value, farthest: facet.value, bend: facet.bend });
    }

    #[inline(always)]
    fn merge(&mut self, other: &Self) {
        self.nearest = larger(other.nearest, self.nearest);
        self.farthest = T::zero() - larger(-other.farthest, -self.farthest);
        self.bend = larger(other.bend, self.bend);
    }
}

/// The step in inverse depth from which on a motion by `parallax` pixels per unit of it shows.
#[inline(always)]
pub(super) fn steep<T: Real>(parallax: T) -> T {
    T::of(VISIBLE_STEP) / parallax
}

/// The larger of two numbers; `b` where `a` is not a number.
#[inline(always)]
pub(super) fn larger<T: Real>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

/// The blocks of an image, alone and with what surrounds them.
#[derive(Clone, Debug, Default)]
pub(super) struct Blocks<T> {
    pub(super) columns: usize,
    pub(super) own: Vec<Block<T>>,
    along_rows: Vec<Block<T>>,
    /// A block and everything that the motion can bring into it.
    around: Vec<Block<T>>,
    steep: T,
}

impl<T: Real> Blocks<T> {
    pub(super) fn resize(&mut self, width: usize, height: usize) {
        self.columns = width.div_ceil(BLOCK);
        let count = self.columns * height.div_ceil(BLOCK);
        for blocks in [&mut self.own, &mut self.along_rows, &mut self.around] {
            blocks.clear();
            blocks.resize(count, Block::empty());
        }
    }

    /// The largest inverse depth [1/m].
    pub(super) fn nearest(&self) -> T {
        self.own.iter().fold(T::zero(), |most, block| most.max(block.nearest))
    }

    /// Prepares [`search_bounds`](Self::search_bounds) for motion by up to `reach` [px] with at most
    /// `parallax` pixels per unit of inverse depth.
    pub(super) fn prepare_search(&mut self, reach: T, parallax: T) {
        self.steep = steep(parallax);
        let blocks = (reach.to_f64() / BLOCK as f64).ceil().clamp(0.0, MAX_REACH) as usize;
        let columns = self.columns.max(1);
        for (out, row) in self.along_rows.chunks_mut(columns).zip(self.own.chunks(columns)) {
            for (x, out) in out.iter_mut().enumerate() {
                *out = Block::empty();
                let near = &row[x.saturating_sub(blocks)..(x + blocks + 1).min(row.len())];
                near.iter().for_each(|block| out.merge(block));
            }
        }
        let rows = self.own.len() / columns;
        for (y, out) in self.around.chunks_mut(columns).enumerate() {
            out.fill(Block::empty());
            for near in y.saturating_sub(blocks)..(y + blocks + 1).min(rows) {
                let row = &self.along_rows[near * columns..(near + 1) * columns];
                out.iter_mut().zip(row).for_each(|(out, block)| out.merge(block));
            }
        }
    }

    /// The bounds around pixel (`x`, `y`) if a step near it moves visibly for any view, else
    /// `None`.
    #[inline(always)]
    pub(super) fn search_bounds(&self, x: usize, y: usize) -> Option<Block<T>> {
        let block = self.around[(y / BLOCK) * self.columns + x / BLOCK];
        (block.bend > self.steep).then_some(block)
    }
}

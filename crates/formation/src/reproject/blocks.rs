//! Blocks of pixels: which of them lie near a step in depth that the motion makes visible.

use super::surface::Facet;
use i2slam_geometry::Real;

/// Side of a block [px].
pub(super) const BLOCK: usize = 4;

/// Steps whose two sides move apart by less than this are not searched [px].
const VISIBLE_STEP: f64 = 0.5;

/// A block looks at most this many blocks away for steps (64 px).
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

    /// Prepares [`searched`](Self::searched) for motion by up to `reach` [px] with at most
    /// `parallax` pixels per unit of inverse depth.
    pub(super) fn surround(&mut self, reach: T, parallax: T) {
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
    pub(super) fn searched(&self, x: usize, y: usize) -> Option<Block<T>> {
        let block = self.around[(y / BLOCK) * self.columns + x / BLOCK];
        (block.bend > self.steep).then_some(block)
    }
}

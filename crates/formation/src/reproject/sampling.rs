//! Samples of the fine grid for sixteen neighbouring pixels of a virtual camera.
//!
//! All numbers of a chunk live in arrays of fixed length on the stack: loops over those become
//! vector instructions on any machine.

use super::views::{Line, View};
use i2slam_compute::simd::{Column, Float4, MAX_LANES, clamp_or_zero, floor_and_fraction};
use i2slam_geometry::Camera;

/// Pixels of a row that are treated together.
pub(super) const LANES: usize = MAX_LANES;

/// Number of chunks in a row; the last one may extend beyond it.
pub(super) fn chunks(width: usize) -> usize {
    width.div_ceil(LANES)
}

/// The lines of a chunk's pixels, see [`Line`], and their directions.
#[derive(Clone, Copy)]
pub(super) struct Lines {
    pub(super) a: Column,
    pub(super) b: Column,
    pub(super) x: Column,
    pub(super) y: Column,
    pub(super) ex: Column,
    pub(super) ey: Column,
}

impl Lines {
    /// Lines of the pixels from column `x` on, in row `y`, of `view`.
    #[inline(always)]
    pub(super) fn new(camera: &Camera<f32>, view: &View<f32>, x: usize, y: usize) -> Self {
        let zero = [0.0; LANES];
        let mut lines = Self { a: zero, b: zero, x: zero, y: zero, ex: zero, ey: zero };
        let (x, y) = (x as f32 + 0.5, y as f32 + 0.5);
        for i in 0..LANES {
            let direction = view.direction(x + i as f32, y);
            let line = view.line(camera, direction);
            (lines.a[i], lines.b[i]) = direction;
            (lines.x[i], lines.y[i]) = (line.x, line.y);
            (lines.ex[i], lines.ey[i]) = (line.ex, line.ey);
        }
        lines
    }

    /// One of them.
    pub(super) fn line(&self, i: usize) -> Line<f32> {
        Line { x: self.x[i], y: self.y[i], ex: self.ex[i], ey: self.ey[i] }
    }
}

/// Positions in the fine grid.
#[derive(Clone, Copy)]
pub(super) struct Taps {
    /// Upper left sample of each tap.
    pub(super) index: [u32; LANES],
    pub(super) row: [u32; LANES],
    /// Fractions to the right and down.
    pub(super) across: Column,
    pub(super) down: Column,
    /// 2 (samples per pixel) where the tap moves with its position, 0 where it is held at an edge.
    pub(super) free_x: Column,
    pub(super) free_y: Column,
}

impl Taps {
    /// At inverse depths `w` on `lines`. Positions outside the image are held at its edge.
    #[inline(always)]
    pub(super) fn new(camera: &Camera<f32>, lines: &Lines, w: &Column) -> Self {
        let zero = [0.0; LANES];
        let mut taps = Self {
            index: [0; LANES],
            row: [0; LANES],
            across: zero,
            down: zero,
            free_x: zero,
            free_y: zero,
        };
        let stride = 2 * camera.width as u32;
        let most_x = (2 * camera.width - 2) as f32;
        let most_y = (2 * camera.height - 2) as f32;
        for i in 0..LANES {
            let x = 2.0 * (lines.x[i] + lines.ex[i] * w[i]) - 1.0;
            let y = 2.0 * (lines.y[i] + lines.ey[i] * w[i]) - 1.0;
            let (held_x, held_y) = (clamp_or_zero(x, most_x), clamp_or_zero(y, most_y));
            taps.free_x[i] = if x == held_x { 2.0 } else { 0.0 };
            taps.free_y[i] = if y == held_y { 2.0 } else { 0.0 };
            let (column, across) = floor_and_fraction(held_x);
            let (row, down) = floor_and_fraction(held_y);
            (taps.across[i], taps.down[i]) = (across, down);
            taps.row[i] = row;
            taps.index[i] = row * stride + column;
        }
        taps
    }

    /// First and last row of the upper samples.
    #[inline(always)]
    pub(super) fn rows(&self) -> (u32, u32) {
        let (mut first, mut last) = (u32::MAX, 0);
        for i in 0..LANES {
            first = first.min(self.row[i]);
            last = last.max(self.row[i]);
        }
        (first, last)
    }
}

/// Red, green, blue and a zero.
pub(super) type Texel = Float4;

/// The four samples around a position: upper left, upper right, lower left, lower right.
#[derive(Clone, Copy)]
pub(super) struct Corners([Texel; 4]);

impl Corners {
    #[inline(always)]
    pub(super) fn at(fine: &[Texel], index: usize, stride: usize) -> Option<Self> {
        let rows = fine.get(index..index + stride + 2)?;
        Some(Self([rows[0], rows[1], rows[stride], rows[stride + 1]]))
    }

    /// The bilinear value at fractions `across` and `down`.
    #[inline(always)]
    pub(super) fn interpolate(&self, across: f32, down: f32) -> Texel {
        let [a, b, c, d] = self.0;
        a.lerp(c, down).lerp(b.lerp(d, down), across)
    }

    /// Its derivatives by `across` and by `down`.
    #[inline(always)]
    pub(super) fn slopes(&self, across: f32, down: f32) -> (Texel, Texel) {
        let [a, b, c, d] = self.0;
        let (right, lower) = (b - a, c - a);
        let twist = d - c - right;
        (right + twist * down, lower + twist * across)
    }
}

/// The transpose of [`Corners::interpolate`]: adds `d` to the four samples around a position.
#[inline(always)]
pub(super) fn scatter(
    d_fine: &mut [Texel],
    index: usize,
    stride: usize,
    d: Texel,
    (across, down): (f32, f32),
) {
    let Some(rows) = d_fine.get_mut(index..index + stride + 2) else { return };
    let right = d * across;
    let left = d - right;
    let (lower_left, lower_right) = (left * down, right * down);
    rows[0] += left - lower_left;
    rows[1] += right - lower_right;
    rows[stride] += lower_left;
    rows[stride + 1] += lower_right;
}

/// Up to sixteen pixels of three planes, times `weight`; zero beyond.
#[inline(always)]
pub(super) fn read_chunk(planes: &[&[f32]; 3], weight: f32) -> [Texel; LANES] {
    let mut texels = [Texel::zero(); LANES];
    let [red, green, blue] = planes;
    for (texel, ((red, green), blue)) in texels.iter_mut().zip(red.iter().zip(*green).zip(*blue)) {
        *texel = Texel::xyz0(*red, *green, *blue) * weight;
    }
    texels
}

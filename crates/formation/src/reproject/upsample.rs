//! The sharp render at twice its resolution, and the transpose of that.
//!
//! Bilinear sampling between pixels dulls the picture. Between the samples of a grid twice as
//! fine it does so four times less, and costs the same four samples: so the price of a better
//! kernel is paid once, not once for every virtual camera.
//!
//! Sample `2 i` of the fine grid is pixel `i`; sample `2 i + 1` is the point halfway to pixel
//! `i + 1`. Beyond the edge the last pixel repeats.

use super::texel::Texel;
use i2slam_geometry::Real;
use pulp::{Simd, WithSimd};

/// How the sharp render is read between its pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Interpolation {
    /// Bilinear: never leaves the range of the four pixels around, dulls detail.
    Linear,
    /// Catmull-Rom halfway between pixels, bilinear from there: keeps detail, and overshoots at
    /// an edge by up to an eighth of its height.
    #[default]
    Cubic,
}

impl Interpolation {
    /// Weights of the pixels -1, 0, 1, 2 for the point halfway between 0 and 1.
    #[inline(always)]
    pub(super) fn halfway<T: Real>(self) -> [T; 4] {
        let sixteenths = match self {
            Self::Linear => [0.0, 8.0, 8.0, 0.0],
            Self::Cubic => [-1.0, 9.0, 9.0, -1.0],
        };
        sixteenths.map(|w| T::of(w / 16.0))
    }
}

/// The pixels that a halfway point after pixel `i` of `size` is made of.
#[inline(always)]
pub(super) fn neighbours(i: usize, size: usize) -> [usize; 4] {
    [i.saturating_sub(1), i, (i + 1).min(size - 1), (i + 2).min(size - 1)]
}

/// Writes row `y` of the fine grid.
pub(super) struct UpsampleRow<'a> {
    /// The sharp render, `height` rows.
    pub(super) planes: [&'a [f32]; 3],
    pub(super) height: usize,
    pub(super) y: usize,
    pub(super) kernel: &'a [f32; 4],
    /// Room for three rows of the render.
    pub(super) scratch: &'a mut [f32],
    pub(super) out: &'a mut [Texel],
}

impl WithSimd for UpsampleRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { planes, height, y, kernel, scratch, out } = self;
        let width = scratch.len() / 3;
        if y.is_multiple_of(2) {
            let at = y / 2 * width..(y / 2 + 1) * width;
            return widen(planes.map(|plane| &plane[at.clone()]), kernel, out);
        }
        let sources = neighbours(y / 2, height);
        for (plane, to) in planes.into_iter().zip(scratch.chunks_exact_mut(width)) {
            let [a, b, c, d] = sources.map(|y| &plane[y * width..(y + 1) * width]);
            for x in 0..width {
                to[x] = kernel[0] * a[x] + kernel[1] * b[x] + kernel[2] * c[x] + kernel[3] * d[x];
            }
        }
        let (red, rest) = scratch.split_at(width);
        let (green, blue) = rest.split_at(width);
        widen([red, green, blue], kernel, out);
    }
}

#[inline(always)]
fn widen([red, green, blue]: [&[f32]; 3], kernel: &[f32; 4], out: &mut [Texel]) {
    let width = red.len();
    let (green, blue) = (&green[..width], &blue[..width]);
    let second = 1.min(width - 1);
    let first = Texel::new(red[0], green[0], blue[0]);
    let mut window = [first, first, Texel::new(red[second], green[second], blue[second])];
    for (i, pair) in out.chunks_exact_mut(2).enumerate().take(width) {
        let [a, b, c] = window;
        let i = (i + 2).min(width - 1);
        let d = Texel::new(red[i], green[i], blue[i]);
        pair[0] = b;
        pair[1] = combine([a, b, c, d], *kernel);
        window = [b, c, d];
    }
}

/// The transpose of [`UpsampleRow`]: adds what row `y` of the fine grid asks of three planes.
/// Row 0 of each of the `d_planes` is row `first` of the image; `narrow_row` is scratch.
#[inline(always)]
pub(super) fn pull_back_row(
    d_out: &[Texel],
    y: usize,
    height: usize,
    kernel: &[f32; 4],
    narrow_row: &mut [f32],
    first: usize,
    d_planes: [&mut [f32]; 3],
) {
    let width = narrow_row.len() / 3;
    narrow(d_out, kernel, narrow_row);
    let targets = neighbours(y / 2, height);
    for (d_plane, from) in d_planes.into_iter().zip(narrow_row.chunks_exact(width)) {
        if y.is_multiple_of(2) {
            add_row(d_plane, y / 2 - first, 1.0, from);
            continue;
        }
        for (&target, &weight) in targets.iter().zip(kernel) {
            add_row(d_plane, target - first, weight, from);
        }
    }
}

#[inline(always)]
fn combine([a, b, c, d]: [Texel; 4], weights: [f32; 4]) -> Texel {
    (b * weights[1] + c * weights[2]) + (a * weights[0] + d * weights[3])
}

#[inline(always)]
fn add_row(plane: &mut [f32], y: usize, weight: f32, from: &[f32]) {
    let to = &mut plane[y * from.len()..(y + 1) * from.len()];
    for (to, from) in to.iter_mut().zip(from) {
        *to += weight * from;
    }
}

/// The transpose of [`widen`], written to three rows in `out`.
#[inline(always)]
fn narrow(d: &[Texel], kernel: &[f32; 4], out: &mut [f32]) {
    let width = out.len() / 3;
    let (red, rest) = out.split_at_mut(width);
    let (green, blue) = rest.split_at_mut(width);
    let zero = Texel::zero();
    let mut window = [zero, zero, d[1]];
    for i in 0..width {
        let [a, b, c] = window;
        let next = d.get(2 * i + 3).copied().unwrap_or(zero);
        let [k0, k1, k2, k3] = *kernel;
        let sum = d[2 * i] + combine([a, b, c, next], [k3, k2, k1, k0]);
        [red[i], green[i], blue[i]] = sum.channels();
        window = [b, c, next];
    }
    // What was read beyond the edges belongs to the edge pixels.
    let before_first = (d[1] * kernel[0]).channels();
    let [before, last, _] = window;
    let after_last = (last * (kernel[2] + kernel[3]) + before * kernel[3]).channels();
    for (k, row) in [red, green, blue].into_iter().enumerate() {
        row[0] += before_first[k];
        row[width - 1] += after_last[k];
    }
}

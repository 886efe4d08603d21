//! The sharp render at twice its resolution, and the transpose of that.
//!
//! Bilinear sampling between pixels dulls the picture. Between the samples of a grid twice as
//! fine it does so four times less, and costs the same four samples: so the price of a better
//! kernel is paid once, not once for every virtual camera.
//!
//! Sample `2 i` of the fine grid is pixel `i`; sample `2 i + 1` is the point halfway to pixel
//! `i + 1`. Beyond the edge the last pixel repeats.

use super::sampling::Texel;
use pulp::{Simd, WithSimd};

/// Pixels that a halfway point is made of, along one axis.
pub(super) const TAPS: usize = 6;

/// Weights of the pixels -2 to 3 for the point halfway between 0 and 1.
///
/// They sharpen a little, which makes up for what the bilinear step dulls: for pictures whose
/// spectrum falls with frequency, the mean square error over all positions between pixels is some
/// 5 dB below that of Catmull-Rom's weights. Overshoots at an edge by up to a ninth of its height.
pub(super) const KERNEL: [f32; TAPS] =
    [6.0 / 256.0, -35.0 / 256.0, 157.0 / 256.0, 157.0 / 256.0, -35.0 / 256.0, 6.0 / 256.0];

/// The pixels that a halfway point after pixel `i` of `size` is made of.
#[inline(always)]
pub(super) fn neighbours(i: usize, size: usize) -> [usize; TAPS] {
    let last = size - 1;
    let next = |step: usize| (i + step).min(last);
    [i.saturating_sub(2), i.saturating_sub(1), i, next(1), next(2), next(3)]
}

/// Writes row `y` of the fine grid.
pub(super) struct UpsampleRow<'a> {
    /// The sharp render, `height` rows.
    pub(super) planes: [&'a [f32]; 3],
    pub(super) height: usize,
    pub(super) y: usize,
    /// Room for three rows of the render.
    pub(super) scratch: &'a mut [f32],
    pub(super) out: &'a mut [Texel],
}

impl WithSimd for UpsampleRow<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { planes, height, y, scratch, out } = self;
        let width = scratch.len() / 3;
        if y.is_multiple_of(2) {
            let at = y / 2 * width..(y / 2 + 1) * width;
            return widen(planes.map(|plane| &plane[at.clone()]), out);
        }
        let sources = neighbours(y / 2, height);
        for (plane, to) in planes.into_iter().zip(scratch.chunks_exact_mut(width)) {
            let row = |k: usize| &plane[sources[k] * width..(sources[k] + 1) * width];
            let (outer, middle, inner) =
                (row(0).iter().zip(row(5)), row(1).iter().zip(row(4)), row(2).iter().zip(row(3)));
            for (to, ((outer, middle), inner)) in to.iter_mut().zip(outer.zip(middle).zip(inner)) {
                let pair =
                    |k: usize, (a, b): (&f32, &f32)| KERNEL[k] * a + KERNEL[TAPS - 1 - k] * b;
                *to = pair(0, outer) + pair(1, middle) + pair(2, inner);
            }
        }
        let (red, rest) = scratch.split_at(width);
        let (green, blue) = rest.split_at(width);
        widen([red, green, blue], out);
    }
}

#[inline(always)]
fn widen([red, green, blue]: [&[f32]; 3], out: &mut [Texel]) {
    let width = red.len();
    let (green, blue) = (&green[..width], &blue[..width]);
    let pixel = |i: usize| {
        let i = i.min(width - 1);
        Texel::xyz0(red[i], green[i], blue[i])
    };
    let mut window = [pixel(0), pixel(0), pixel(0), pixel(1), pixel(2)];
    for (i, pair) in out.chunks_exact_mut(2).enumerate().take(width) {
        let [a, b, c, d, e] = window;
        let f = pixel(i + 3);
        pair[0] = c;
        pair[1] = combine([a, b, c, d, e, f], KERNEL);
        window = [b, c, d, e, f];
    }
}

/// The transpose of [`UpsampleRow`]: adds the gradient of row `y` of the fine grid to three planes.
/// Row 0 of each of the `d_planes` is row `first` of the image; `narrow_row` is scratch.
#[inline(always)]
pub(super) fn pull_back_row(
    d_out: &[Texel],
    y: usize,
    height: usize,
    narrow_row: &mut [f32],
    first: usize,
    d_planes: [&mut [f32]; 3],
) {
    let width = narrow_row.len() / 3;
    narrow(d_out, narrow_row);
    let targets = neighbours(y / 2, height);
    for (d_plane, from) in d_planes.into_iter().zip(narrow_row.chunks_exact(width)) {
        if y.is_multiple_of(2) {
            add_row(d_plane, y / 2 - first, 1.0, from);
            continue;
        }
        for (&target, &weight) in targets.iter().zip(&KERNEL) {
            add_row(d_plane, target - first, weight, from);
        }
    }
}

#[inline(always)]
fn combine([a, b, c, d, e, f]: [Texel; TAPS], weights: [f32; TAPS]) -> Texel {
    (c * weights[2] + d * weights[3])
        + (b * weights[1] + e * weights[4])
        + (a * weights[0] + f * weights[5])
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
fn narrow(d: &[Texel], out: &mut [f32]) {
    let width = out.len() / 3;
    let (red, rest) = out.split_at_mut(width);
    let (green, blue) = rest.split_at_mut(width);
    let (zero, [k0, k1, k2, k3, k4, k5]) = (Texel::zero(), KERNEL);
    let halfway = |i: usize| d.get(2 * i + 1).copied().unwrap_or(zero);
    let mut window = [zero, zero, zero, halfway(0), halfway(1)];
    for i in 0..width {
        let [a, b, c, e, f] = window;
        let g = halfway(i + 2);
        let sum = d[2 * i] + combine([a, b, c, e, f, g], [k5, k4, k3, k2, k1, k0]);
        [red[i], green[i], blue[i]] = sum.xyz();
        window = [b, c, e, f, g];
    }
    // What was read beyond the edges belongs to the edge pixels.
    let before_first = (halfway(0) * (k0 + k1) + halfway(1) * k0).xyz();
    let [third_last, second_last, last, ..] = window;
    let after_last = last * (k3 + k4 + k5) + second_last * (k4 + k5) + third_last * k5;
    let after_last = after_last.xyz();
    for (k, row) in [red, green, blue].into_iter().enumerate() {
        row[0] += before_first[k];
        row[width - 1] += after_last[k];
    }
}

//! The sharp render at twice its resolution, and the transpose of that.
//!
//! Bilinear sampling between pixels dulls the picture. Between the samples of a grid twice as
//! fine it does so four times less, and costs the same four samples: so the price of a better
//! kernel is paid once, not once for every virtual camera.
//!
//! Sample `2 i` of the fine grid is pixel `i`; sample `2 i + 1` is the point halfway to pixel
//! `i + 1`. Beyond the edge the last pixel repeats.

use i2slam_geometry::Real;

/// One sample of the fine grid: R, G, B and a zero.
pub(super) type Texel<T> = [T; 4];

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

/// Writes row `y` of the fine grid of three `planes` (`height` rows of the width of `halfway_row`
/// over 3, which is scratch).
#[inline(always)]
pub(super) fn upsample_row(
    planes: [&[f32]; 3],
    height: usize,
    y: usize,
    kernel: &[f32; 4],
    halfway_row: &mut [f32],
    out: &mut [Texel<f32>],
) {
    let width = halfway_row.len() / 3;
    let row = |plane: usize, y: usize| &planes[plane][y * width..(y + 1) * width];
    if y.is_multiple_of(2) {
        return widen([row(0, y / 2), row(1, y / 2), row(2, y / 2)], kernel, out);
    }
    let sources = neighbours(y / 2, height);
    for (plane, to) in halfway_row.chunks_exact_mut(width).enumerate() {
        let [a, b, c, d] = sources.map(|y| row(plane, y));
        for x in 0..width {
            to[x] = kernel[0] * a[x] + kernel[1] * b[x] + kernel[2] * c[x] + kernel[3] * d[x];
        }
    }
    let (red, rest) = halfway_row.split_at(width);
    let (green, blue) = rest.split_at(width);
    widen([red, green, blue], kernel, out);
}

#[inline(always)]
fn widen([red, green, blue]: [&[f32]; 3], kernel: &[f32; 4], out: &mut [Texel<f32>]) {
    let width = red.len();
    let (green, blue) = (&green[..width], &blue[..width]);
    let texel = |i: usize| [red[i], green[i], blue[i], 0.0];
    let mut window = [texel(0), texel(0), texel(1.min(width - 1))];
    for (i, pair) in out.chunks_exact_mut(2).enumerate().take(width) {
        let [a, b, c] = window;
        let d = texel((i + 2).min(width - 1));
        pair[0] = b;
        for k in 0..4 {
            pair[1][k] = kernel[0] * a[k] + kernel[1] * b[k] + kernel[2] * c[k] + kernel[3] * d[k];
        }
        window = [b, c, d];
    }
}

/// The transpose of [`upsample_row`]: adds what row `y` of the fine grid asks of three planes.
/// Row 0 of each of the `d_planes` is row `first` of the image; `narrow_row` is scratch.
#[inline(always)]
pub(super) fn pull_back_row(
    d_out: &[Texel<f32>],
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
        let mut add = |y: usize, weight: f32| {
            let to = &mut d_plane[(y - first) * width..(y - first + 1) * width];
            to.iter_mut().zip(from).for_each(|(to, from)| *to += weight * from);
        };
        if y.is_multiple_of(2) {
            add(y / 2, 1.0);
        } else {
            targets.iter().zip(kernel).for_each(|(&y, &weight)| add(y, weight));
        }
    }
}

/// The transpose of [`widen`], written to three rows in `out`.
#[inline(always)]
fn narrow(d: &[Texel<f32>], kernel: &[f32; 4], out: &mut [f32]) {
    let width = out.len() / 3;
    let (red, rest) = out.split_at_mut(width);
    let (green, blue) = rest.split_at_mut(width);
    let zero = [0.0; 4];
    let mut window = [zero, zero, d[1]];
    for i in 0..width {
        let [a, b, c] = window;
        let next = d.get(2 * i + 3).copied().unwrap_or(zero);
        let mut sum = d[2 * i];
        for k in 0..4 {
            sum[k] += kernel[3] * a[k] + kernel[2] * b[k] + kernel[1] * c[k] + kernel[0] * next[k];
        }
        (red[i], green[i], blue[i]) = (sum[0], sum[1], sum[2]);
        window = [b, c, next];
    }
    // What was read beyond the edges belongs to the edge pixels.
    let last = window[1];
    let before = window[0];
    for (k, row) in [red, green, blue].into_iter().enumerate() {
        row[0] += kernel[0] * d[1][k];
        row[width - 1] += (kernel[2] + kernel[3]) * last[k] + kernel[3] * before[k];
    }
}

//! The fast lane of the encoding: indices and weights of sixteen positions at once.

use super::Level;
use pulp::{Arch, Simd, WithSimd};

/// Positions of a group.
const GROUP: usize = 16;

/// Added to a float under 2²³ it leaves its nearest integer in the low bits.
const ROUND: f32 = 8_388_608.0;

/// The eight corners around sixteen positions.
struct Corners {
    index: [[u32; GROUP]; 8],
    fraction: [[f32; GROUP]; 3],
}

impl Corners {
    /// `⌊x s + ½⌋` is taken as the nearest integer of `x s`: where both differ, at ties, the
    /// fraction is 1 instead of 0, and the interpolated value is the same.
    #[inline(always)]
    fn new(level: &Level, axes: &[[f32; GROUP]; 3]) -> Self {
        let (mut low, mut high) = ([[0_u32; GROUP]; 3], [[0_u32; GROUP]; 3]);
        let mut fraction = [[0.0; GROUP]; 3];
        let scale = level.scale as f32;
        for k in 0..3 {
            let factor = level.factors[k];
            for i in 0..GROUP {
                let p = axes[k][i] * scale;
                let shifted = p + ROUND;
                let node = shifted.to_bits() & 0x007f_ffff;
                fraction[k][i] = p - (shifted - ROUND) + 0.5;
                low[k][i] = node.wrapping_mul(factor);
                high[k][i] = low[k][i].wrapping_add(factor);
            }
        }
        let mut index = [[0; GROUP]; 8];
        let mask = (level.entries - 1) as u32;
        for c in 0..8 {
            let [x, y, z] = [
                if c & 1 == 0 { &low[0] } else { &high[0] },
                if c & 2 == 0 { &low[1] } else { &high[1] },
                if c & 4 == 0 { &low[2] } else { &high[2] },
            ];
            if level.hashed {
                for i in 0..GROUP {
                    index[c][i] = (x[i] ^ y[i] ^ z[i]) & mask;
                }
            } else {
                for i in 0..GROUP {
                    index[c][i] = x[i].wrapping_add(y[i]).wrapping_add(z[i]);
                }
            }
        }
        Self { index, fraction }
    }

    /// `Π_k (c_k ? f_k : 1 - f_k)` of each corner.
    #[inline(always)]
    fn weights(&self) -> [[f32; GROUP]; 8] {
        let [x, y, z] = &self.fraction;
        let mut weights = [[0.0; GROUP]; 8];
        for i in 0..GROUP {
            let (x1, y1, z1) = (x[i], y[i], z[i]);
            let (x0, y0, z0) = (1.0 - x1, 1.0 - y1, 1.0 - z1);
            let (a, b, c, d) = (y0 * z0, y1 * z0, y0 * z1, y1 * z1);
            let all = [x0 * a, x1 * a, x0 * b, x1 * b, x0 * c, x1 * c, x0 * d, x1 * d];
            for c in 0..8 {
                weights[c][i] = all[c];
            }
        }
        weights
    }
}

/// Sixteen positions, one row per axis.
#[inline(always)]
#[expect(clippy::manual_clamp, reason = "NaN must give an index within the table")]
fn axes(positions: &[[f32; 3]]) -> [[f32; GROUP]; 3] {
    let mut axes = [[0.0; GROUP]; 3];
    for (i, x) in positions.iter().enumerate().take(GROUP) {
        for k in 0..3 {
            axes[k][i] = x[k].max(0.0).min(1.0);
        }
    }
    axes
}

/// The entries of a level.
#[inline(always)]
fn entries<'a, const F: usize>(table: &'a [f32], level: &Level) -> &'a [[f32; F]] {
    &table.as_chunks::<F>().0[level.first..level.first + level.entries]
}

/// Features of positions in the unit cube, and their slopes. A row of `out` has `width` numbers,
/// of which the first `levels · F` are written; slopes, if wanted, have three such rows per
/// position: the derivatives by x, y and z.
struct Encode<'a, const F: usize> {
    levels: &'a [Level],
    table: &'a [f32],
    positions: &'a [[f32; 3]],
    out: &'a mut [f32],
    width: usize,
    slopes: &'a mut [f32],
}

impl<const F: usize> WithSimd for Encode<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let width = self.width;
        let mut slope_rows = self.slopes.chunks_mut(3 * GROUP * width);
        let rows = self.out.chunks_mut(GROUP * width);
        for (positions, out) in self.positions.chunks(GROUP).zip(rows) {
            let axes = axes(positions);
            let slopes = slope_rows.next().unwrap_or_default();
            for (l, level) in self.levels.iter().enumerate() {
                let corners = Corners::new(level, &axes);
                let values = gather(entries::<F>(self.table, level), &corners.index);
                for f in 0..F {
                    let column = l * F + f;
                    let mut by = [[0.0; GROUP]; 3];
                    let value = interpolate(&corners.fraction, &values[f]);
                    for (i, row) in out.chunks_exact_mut(width).enumerate() {
                        row[column] = value[i];
                    }
                    if !slopes.is_empty() {
                        add_slopes(level.scale as f32, &corners.fraction, &values[f], &mut by);
                        for (i, rows) in slopes.chunks_exact_mut(3 * width).enumerate() {
                            for k in 0..3 {
                                rows[k * width + column] = by[k][i];
                            }
                        }
                    }
                }
            }
        }
    }
}

/// The entries of the corners, a row per feature and corner.
#[inline(always)]
fn gather<const F: usize>(
    entries: &[[f32; F]],
    index: &[[u32; GROUP]; 8],
) -> [[[f32; GROUP]; 8]; F] {
    let mut values = [[[0.0; GROUP]; 8]; F];
    for i in 0..GROUP {
        for c in 0..8 {
            let entry = &entries[index[c][i] as usize];
            for f in 0..F {
                values[f][c][i] = entry[f];
            }
        }
    }
    values
}

/// The values between the corners.
#[inline(always)]
fn interpolate([x, y, z]: &[[f32; GROUP]; 3], v: &[[f32; GROUP]; 8]) -> [f32; GROUP] {
    let mut out = [0.0; GROUP];
    for i in 0..GROUP {
        let (x, y, z) = (x[i], y[i], z[i]);
        let (a, b) = (v[0][i] + x * (v[1][i] - v[0][i]), v[2][i] + x * (v[3][i] - v[2][i]));
        let (c, d) = (v[4][i] + x * (v[5][i] - v[4][i]), v[6][i] + x * (v[7][i] - v[6][i]));
        let (near, far) = (a + y * (b - a), c + y * (d - c));
        out[i] = near + z * (far - near);
    }
    out
}

/// `∂L/∂x` in the unit cube, from `∂L/∂features` in rows of `width`.
struct PositionGradient<'a, const F: usize> {
    levels: &'a [Level],
    table: &'a [f32],
    positions: &'a [[f32; 3]],
    cotangent: &'a [f32],
    width: usize,
    out: &'a mut [[f32; 3]],
}

impl<const F: usize> WithSimd for PositionGradient<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let rows = self.cotangent.chunks(GROUP * self.width);
        let groups = self.positions.chunks(GROUP).zip(self.out.chunks_mut(GROUP));
        for ((positions, out), cotangent) in groups.zip(rows) {
            let axes = axes(positions);
            let mut sums = [[0.0_f32; GROUP]; 3];
            for (l, level) in self.levels.iter().enumerate() {
                let entries = entries::<F>(self.table, level);
                let corners = Corners::new(level, &axes);
                let mut values = [[0.0; GROUP]; 8];
                for (i, d) in cotangent.chunks_exact(self.width).enumerate().take(GROUP) {
                    let d = &d[l * F..(l + 1) * F];
                    for c in 0..8 {
                        let entry = &entries[corners.index[c][i] as usize];
                        for f in 0..F {
                            values[c][i] += d[f] * entry[f];
                        }
                    }
                }
                add_slopes(level.scale as f32, &corners.fraction, &values, &mut sums);
            }
            for (i, out) in out.iter_mut().enumerate() {
                *out = [sums[0][i], sums[1][i], sums[2][i]];
            }
        }
    }
}

/// The slope of the interpolation of `values` along each axis.
#[inline(always)]
fn add_slopes(
    scale: f32,
    [x, y, z]: &[[f32; GROUP]; 3],
    v: &[[f32; GROUP]; 8],
    sums: &mut [[f32; GROUP]; 3],
) {
    for i in 0..GROUP {
        let (x, y, z) = (x[i], y[i], z[i]);
        // Differences along x at the four edges, and their averages over y and z.
        let (dx00, dx10) = (v[1][i] - v[0][i], v[3][i] - v[2][i]);
        let (dx01, dx11) = (v[5][i] - v[4][i], v[7][i] - v[6][i]);
        let (near, far) = (dx00 + y * (dx10 - dx00), dx01 + y * (dx11 - dx01));
        sums[0][i] += scale * (near + z * (far - near));
        // Values at the x of the position, at the four edges along x.
        let (a, b) = (v[0][i] + x * dx00, v[2][i] + x * dx10);
        let (c, d) = (v[4][i] + x * dx01, v[6][i] + x * dx11);
        sums[1][i] += scale * ((b - a) + z * ((d - c) - (b - a)));
        sums[2][i] += scale * ((c - a) + y * ((d - b) - (c - a)));
    }
}

/// Adds `weight · ∂L/∂features` of one level to its entries, position after position.
struct Scatter<'a, const F: usize> {
    level: &'a Level,
    positions: &'a [[f32; 3]],
    /// `F` numbers per position.
    cotangent: &'a [f32],
    /// The gradient of the level's entries.
    gradient: &'a mut [f32],
}

impl<const F: usize> WithSimd for Scatter<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let entries = &mut self.gradient.as_chunks_mut::<F>().0[..self.level.entries];
        let rows = self.cotangent.as_chunks::<F>().0.chunks(GROUP);
        for (positions, cotangent) in self.positions.chunks(GROUP).zip(rows) {
            let corners = Corners::new(self.level, &axes(positions));
            let weights = corners.weights();
            for (i, d) in cotangent.iter().enumerate() {
                for c in 0..8 {
                    let entry = &mut entries[corners.index[c][i] as usize];
                    for f in 0..F {
                        entry[f] += weights[c][i] * d[f];
                    }
                }
            }
        }
    }
}

/// Run a kernel for the number of features of a field, which its settings bound to 1, 2, 4 or 8.
macro_rules! dispatch {
    ($arch:expr, $features:expr, $kernel:ident $fields:tt) => {
        match $features {
            1 => $arch.dispatch($kernel::<1> $fields),
            2 => $arch.dispatch($kernel::<2> $fields),
            4 => $arch.dispatch($kernel::<4> $fields),
            _ => $arch.dispatch($kernel::<8> $fields),
        }
    };
}

/// [`Encode`] for `features` numbers per entry; `slopes` may be empty.
pub(crate) fn encode(
    arch: Arch,
    features: usize,
    (levels, table): (&[Level], &[f32]),
    positions: &[[f32; 3]],
    width: usize,
    out: &mut [f32],
    slopes: &mut [f32],
) {
    dispatch!(arch, features, Encode { levels, table, positions, out, width, slopes });
}

/// [`PositionGradient`] for `features` numbers per entry.
pub(crate) fn position_gradient(
    arch: Arch,
    features: usize,
    (levels, table): (&[Level], &[f32]),
    positions: &[[f32; 3]],
    (cotangent, width): (&[f32], usize),
    out: &mut [[f32; 3]],
) {
    dispatch!(arch, features, PositionGradient { levels, table, positions, cotangent, width, out });
}

/// [`Scatter`] for `features` numbers per entry.
pub(crate) fn scatter(
    arch: Arch,
    features: usize,
    level: &Level,
    positions: &[[f32; 3]],
    cotangent: &[f32],
    gradient: &mut [f32],
) {
    dispatch!(arch, features, Scatter { level, positions, cotangent, gradient });
}

/// `∂L/∂x` from kept slopes: a sum of products per position and axis.
pub(crate) struct BySlopes<'a> {
    /// `width` numbers per position.
    pub(crate) cotangent: &'a [f32],
    /// Three rows of `width` numbers per position.
    pub(crate) slopes: &'a [f32],
    pub(crate) width: usize,
    pub(crate) out: &'a mut [[f32; 3]],
}

impl WithSimd for BySlopes<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let width = self.width;
        let rows = self.cotangent.chunks_exact(width).zip(self.slopes.chunks_exact(3 * width));
        for (out, (cotangent, slopes)) in self.out.iter_mut().zip(rows) {
            let cotangent = S::as_simd_f32s(cotangent).0;
            for (out, slopes) in out.iter_mut().zip(slopes.chunks_exact(width)) {
                let mut sum = simd.splat_f32s(0.0);
                for (d, slope) in cotangent.iter().zip(S::as_simd_f32s(slopes).0) {
                    sum = simd.mul_add_e_f32s(*d, *slope, sum);
                }
                *out = simd.reduce_sum_f32s(sum);
            }
        }
    }
}

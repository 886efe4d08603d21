//! The fast lane of the encoding, sixteen positions at a time.

use super::Level;
use super::interpolation::{Corners, GROUP, axes, entries};
use super::interpolation::{Rows, gather, interpolate, slopes_of, spread};
use pulp::{Simd, WithSimd};

/// Runs a kernel for the number of features of a field, which its settings bound to 1, 2, 4 or 8.
macro_rules! by_features {
    ($kernel:ident) => {
        impl WithSimd for $kernel<'_> {
            type Output = ();

            #[inline(always)]
            fn with_simd<S: Simd>(self, _: S) {
                match self.features {
                    1 => self.run::<1>(),
                    2 => self.run::<2>(),
                    4 => self.run::<4>(),
                    _ => self.run::<8>(),
                }
            }
        }
    };
}

by_features!(Encode);
by_features!(PositionGradient);
by_features!(Scatter);

/// Features of positions in the unit cube in rows of `width` numbers, and their slopes, unless
/// empty, in three such rows per position: the derivatives by x, y and z.
pub(crate) struct Encode<'a> {
    pub(crate) features: usize,
    pub(crate) levels: &'a [Level],
    pub(crate) table: &'a [f32],
    pub(crate) positions: &'a [[f32; 3]],
    pub(crate) out: &'a mut [f32],
    pub(crate) width: usize,
    pub(crate) slopes: &'a mut [f32],
}

impl Encode<'_> {
    #[inline(always)]
    fn run<const F: usize>(self) {
        let width = self.width;
        let mut slope_rows = self.slopes.chunks_mut(3 * GROUP * width);
        let rows = self.out.chunks_mut(GROUP * width);
        for (positions, out) in self.positions.chunks(GROUP).zip(rows) {
            let axes = axes(positions);
            let slopes = slope_rows.next().unwrap_or_default();
            for (l, level) in self.levels.iter().enumerate() {
                let corners = Corners::new(level, &axes);
                let fraction = spread::<F>(&corners.fraction);
                let values = gather(entries::<F>(self.table, level), &corners.index);
                let column = l * F..(l + 1) * F;
                let value = interpolate(&fraction, &values);
                for (i, row) in out.chunks_exact_mut(width).enumerate() {
                    row[column.clone()].copy_from_slice(&value[i]);
                }
                if !slopes.is_empty() {
                    let by = slopes_of(level.scale as f32, &fraction, &values);
                    for (i, rows) in slopes.chunks_exact_mut(3 * width).enumerate() {
                        for k in 0..3 {
                            let from = k * width + column.start;
                            rows[from..from + F].copy_from_slice(&by[k][i]);
                        }
                    }
                }
            }
        }
    }
}

/// `∂L/∂x` in the unit cube, from `∂L/∂features` in rows of `width`.
pub(crate) struct PositionGradient<'a> {
    pub(crate) features: usize,
    pub(crate) levels: &'a [Level],
    pub(crate) table: &'a [f32],
    pub(crate) positions: &'a [[f32; 3]],
    pub(crate) cotangent: &'a [f32],
    pub(crate) width: usize,
    pub(crate) out: &'a mut [[f32; 3]],
}

impl PositionGradient<'_> {
    #[inline(always)]
    fn run<const F: usize>(self) {
        let rows = self.cotangent.chunks(GROUP * self.width);
        let groups = self.positions.chunks(GROUP).zip(self.out.chunks_mut(GROUP));
        for ((positions, out), cotangent) in groups.zip(rows) {
            let axes = axes(positions);
            let mut sums = [[0.0_f32; GROUP]; 3];
            for (l, level) in self.levels.iter().enumerate() {
                let entries = entries::<F>(self.table, level);
                let corners = Corners::new(level, &axes);
                let mut values: [Rows<1>; 8] = [[[0.0]; GROUP]; 8];
                for (i, d) in cotangent.chunks_exact(self.width).enumerate().take(GROUP) {
                    let d = &d[l * F..(l + 1) * F];
                    for c in 0..8 {
                        let entry = &entries[corners.index[c][i] as usize];
                        for f in 0..F {
                            values[c][i][0] += d[f] * entry[f];
                        }
                    }
                }
                let by = slopes_of(level.scale as f32, &spread(&corners.fraction), &values);
                for k in 0..3 {
                    for i in 0..GROUP {
                        sums[k][i] += by[k][i][0];
                    }
                }
            }
            for (i, out) in out.iter_mut().enumerate() {
                *out = [sums[0][i], sums[1][i], sums[2][i]];
            }
        }
    }
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

/// Adds `weight · ∂L/∂features` of one level to its entries, position after position.
pub(crate) struct Scatter<'a> {
    pub(crate) features: usize,
    pub(crate) level: &'a Level,
    pub(crate) positions: &'a [[f32; 3]],
    /// `features` numbers per position.
    pub(crate) cotangent: &'a [f32],
    /// The gradient of the level's entries.
    pub(crate) gradient: &'a mut [f32],
}

impl Scatter<'_> {
    #[inline(always)]
    fn run<const F: usize>(self) {
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

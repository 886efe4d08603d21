//! From derivatives by features to those by positions and by the table.

use super::Level;
use super::corners::{Corners, GROUP, axes, entries};
use super::interpolate::{Rows, slopes_of, spread};
use pulp::{Simd, WithSimd};

/// `∂L/∂x` in the unit cube, from `∂L/∂features` in rows of `width`.
pub(super) struct PositionGradient<'a, const F: usize> {
    pub(super) levels: &'a [Level],
    pub(super) table: &'a [f32],
    pub(super) positions: &'a [[f32; 3]],
    pub(super) cotangent: &'a [f32],
    pub(super) width: usize,
    pub(super) out: &'a mut [[f32; 3]],
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
pub(super) struct Scatter<'a, const F: usize> {
    pub(super) level: &'a Level,
    pub(super) positions: &'a [[f32; 3]],
    /// `F` numbers per position.
    pub(super) cotangent: &'a [f32],
    /// The gradient of the level's entries.
    pub(super) gradient: &'a mut [f32],
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

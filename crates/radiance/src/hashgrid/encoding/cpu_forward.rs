//! From positions to features.

use super::Level;
use super::corners::{Corners, GROUP, axes, entries};
use super::interpolate::{gather, interpolate, slopes_of, spread};
use pulp::{Simd, WithSimd};

/// Features of positions in the unit cube, and their slopes. A row of `out` has `width` numbers,
/// of which the first `levels · F` are written; slopes, if wanted, have three such rows per
/// position: the derivatives by x, y and z.
pub(super) struct Encode<'a, const F: usize> {
    pub(super) levels: &'a [Level],
    pub(super) table: &'a [f32],
    pub(super) positions: &'a [[f32; 3]],
    pub(super) out: &'a mut [f32],
    pub(super) width: usize,
    pub(super) slopes: &'a mut [f32],
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

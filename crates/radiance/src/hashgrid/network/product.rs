//! Products of small row-major matrices whose widths are multiples of [`PAD`].
//!
//! A tile of the result stays in registers while the sum runs: every step loads a row of the
//! right factor and spreads single numbers of the left one.

use pulp::{Simd, WithSimd};

/// Widths are rounded up to multiples of this: the widest vector.
pub(crate) const PAD: usize = 16;

/// Rows of a result come in multiples of this.
pub(crate) const ROWS: usize = 8;

/// `width` rounded up to a multiple of [`PAD`].
pub(crate) fn padded(width: usize) -> usize {
    width.next_multiple_of(PAD)
}

/// `C = A B`, then `max(·, 0)` if `relu`: `A` is `rows x depth`, `B` is `depth x columns`.
pub(crate) struct Product<'a> {
    pub(crate) a: &'a [f32],
    pub(crate) b: &'a [f32],
    pub(crate) c: &'a mut [f32],
    pub(crate) depth: usize,
    pub(crate) columns: usize,
    pub(crate) relu: bool,
}

impl WithSimd for Product<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { a, b, c, depth, columns, relu } = self;
        // Half of the registers of the narrower instruction set.
        if S::F32_LANES >= 16 {
            for (a, c) in a.chunks_exact(8 * depth).zip(c.chunks_exact_mut(8 * columns)) {
                row_of_tiles::<S, 8>(simd, a, b, c, depth, columns, relu);
            }
        } else {
            for (a, c) in a.chunks_exact(4 * depth).zip(c.chunks_exact_mut(4 * columns)) {
                row_of_tiles::<S, 4>(simd, a, b, c, depth, columns, relu);
            }
        }
    }
}

#[inline(always)]
fn row_of_tiles<S: Simd, const M: usize>(
    simd: S,
    a: &[f32],
    b: &[f32],
    c: &mut [f32],
    depth: usize,
    columns: usize,
    relu: bool,
) {
    let mut first = 0;
    while first + 2 * S::F32_LANES <= columns {
        tile::<S, M, 2>(simd, a, b, c, depth, columns, first, relu);
        first += 2 * S::F32_LANES;
    }
    while first + S::F32_LANES <= columns {
        tile::<S, M, 1>(simd, a, b, c, depth, columns, first, relu);
        first += S::F32_LANES;
    }
}

/// `M` rows and `N` vectors of columns, from column `first`.
#[inline(always)]
fn tile<S: Simd, const M: usize, const N: usize>(
    simd: S,
    a: &[f32],
    b: &[f32],
    c: &mut [f32],
    depth: usize,
    columns: usize,
    first: usize,
    relu: bool,
) {
    let zero = simd.splat_f32s(0.0);
    let mut sums = [[zero; N]; M];
    let mut rows = [a; M];
    for m in 0..M {
        rows[m] = &a[m * depth..(m + 1) * depth];
    }
    for (k, b) in b.chunks_exact(columns).enumerate().take(depth) {
        let b = S::as_simd_f32s(&b[first..first + N * S::F32_LANES]).0;
        for m in 0..M {
            let x = simd.splat_f32s(rows[m][k]);
            for n in 0..N {
                sums[m][n] = simd.mul_add_e_f32s(x, b[n], sums[m][n]);
            }
        }
    }
    for m in 0..M {
        let from = m * columns + first;
        let c = S::as_mut_simd_f32s(&mut c[from..from + N * S::F32_LANES]).0;
        for n in 0..N {
            c[n] = if relu { simd.max_f32s(sums[m][n], zero) } else { sums[m][n] };
        }
    }
}

/// `C += Aᵀ B` over `samples`: `A` is `samples x rows`, `B` is `samples x columns`.
pub(crate) struct OuterProduct<'a> {
    pub(crate) a: &'a [f32],
    pub(crate) b: &'a [f32],
    pub(crate) c: &'a mut [f32],
    pub(crate) rows: usize,
    pub(crate) columns: usize,
}

impl WithSimd for OuterProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { a, b, c, rows, columns } = self;
        if S::F32_LANES >= 16 {
            for (m, c) in c.chunks_exact_mut(8 * columns).enumerate() {
                outer_row::<S, 8>(simd, a, b, c, rows, columns, 8 * m);
            }
        } else {
            for (m, c) in c.chunks_exact_mut(4 * columns).enumerate() {
                outer_row::<S, 4>(simd, a, b, c, rows, columns, 4 * m);
            }
        }
    }
}

#[inline(always)]
fn outer_row<S: Simd, const M: usize>(
    simd: S,
    a: &[f32],
    b: &[f32],
    c: &mut [f32],
    rows: usize,
    columns: usize,
    row: usize,
) {
    let mut first = 0;
    while first + 2 * S::F32_LANES <= columns {
        outer_tile::<S, M, 2>(simd, a, b, c, [rows, columns], [row, first]);
        first += 2 * S::F32_LANES;
    }
    while first + S::F32_LANES <= columns {
        outer_tile::<S, M, 1>(simd, a, b, c, [rows, columns], [row, first]);
        first += S::F32_LANES;
    }
}

#[inline(always)]
fn outer_tile<S: Simd, const M: usize, const N: usize>(
    simd: S,
    a: &[f32],
    b: &[f32],
    c: &mut [f32],
    [rows, columns]: [usize; 2],
    [row, first]: [usize; 2],
) {
    let mut sums = [[simd.splat_f32s(0.0); N]; M];
    for (a, b) in a.chunks_exact(rows).zip(b.chunks_exact(columns)) {
        let a = &a[row..row + M];
        let b = S::as_simd_f32s(&b[first..first + N * S::F32_LANES]).0;
        for m in 0..M {
            let x = simd.splat_f32s(a[m]);
            for n in 0..N {
                sums[m][n] = simd.mul_add_e_f32s(x, b[n], sums[m][n]);
            }
        }
    }
    for m in 0..M {
        let from = m * columns + first;
        let c = S::as_mut_simd_f32s(&mut c[from..from + N * S::F32_LANES]).0;
        for n in 0..N {
            c[n] = simd.add_f32s(c[n], sums[m][n]);
        }
    }
}

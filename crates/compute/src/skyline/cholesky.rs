//! Blocked Cholesky factorisation of a skyline matrix.
//!
//! Block columns `J` are factorised from left to right (Golub and Van Loan 2013, section 4.2):
//!
//! ```text
//! A_JJ - Σ_K L_JK L_JKᵀ = L_JJ L_JJᵀ,   L_IJ = (A_IJ - Σ_K L_IK L_JKᵀ) L_JJ⁻ᵀ for all I > J
//! ```
//!
//! Blocks of rows `I` are independent of each other and run in parallel. The rows of `L_JK` are
//! packed as columns of a panel, with which six rows are multiplied at a time, two vectors wide.
//! Every entry is a sum in order of columns, whatever the number of threads.

use super::SkylineMatrix;
use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

/// Rows and columns of a block.
const BLOCK: usize = 48;
/// Rows multiplied at once: the six of a pose begin in one column.
const ROWS: usize = 6;
/// Vectors of a block row multiplied at once.
const VECTORS: usize = 2;
/// Columns multiplied at once: their part of the panel stays in the cache of a core.
const DEPTH: usize = 512;

/// A row of a block.
type BlockRow = [f64; BLOCK];

/// A row of the matrix up to its diagonal.
struct Row<'a> {
    /// Column of the first value.
    first: usize,
    values: &'a mut [f64],
}

/// Replaces `A` by Cholesky's factor; returns whether it was positive definite.
pub(super) fn factorise(matrix: &mut SkylineMatrix, arch: Arch) -> bool {
    let SkylineMatrix { first, start, values } = matrix;
    let count = first.len();
    let mut storage = Vec::new();
    for begin in (0..count).step_by(BLOCK) {
        let end = (begin + BLOCK).min(count);
        let (above, below) = values.split_at_mut(start[end]);
        let mut rows = split_rows(&first[begin..end], begin, &mut above[start[begin]..]);
        let panel = Panel::new(&rows, begin, storage);
        let Some(diagonal) = arch.dispatch(DiagonalBlock { rows: &mut rows, panel: &panel }) else {
            return false;
        };
        let mut groups = Vec::new();
        let mut rest = below;
        for from in (end..count).step_by(BLOCK) {
            let to = (from + BLOCK).min(count);
            let (group, after) = rest.split_at_mut(start[to] - start[from]);
            rest = after;
            if first[from..to].iter().any(|first| *first < end) {
                groups.push((from..to, group));
            }
        }
        groups.into_par_iter().for_each(|(range, values)| {
            let mut rows = split_rows(&first[range.clone()], range.start, values);
            arch.dispatch(BlockBelow { rows: &mut rows, panel: &panel, diagonal: &diagonal });
        });
        storage = panel.columns;
    }
    true
}

/// Rows from `begin` on, given where they begin and their values one after another.
fn split_rows<'a>(first: &[usize], begin: usize, values: &'a mut [f64]) -> Vec<Row<'a>> {
    let mut rest = values;
    let mut rows = Vec::with_capacity(first.len());
    for (row, first) in (begin..).zip(first) {
        let (values, after) = rest.split_at_mut(row + 1 - first);
        rows.push(Row { first: *first, values });
        rest = after;
    }
    rows
}

/// The rows of a block column left of its diagonal block, transposed.
struct Panel {
    /// Column of the matrix in which the block column begins.
    begin: usize,
    /// Column of the matrix of the first entry.
    first: usize,
    /// For every column from `first` to `begin` the entries of all rows.
    columns: Vec<BlockRow>,
}

impl Panel {
    fn new(rows: &[Row<'_>], begin: usize, mut columns: Vec<BlockRow>) -> Self {
        let first = rows.iter().map(|row| row.first).min().unwrap_or(begin).min(begin);
        columns.clear();
        columns.resize(begin - first, [0.0; BLOCK]);
        for (place, row) in rows.iter().enumerate() {
            let Some(from) = row.first.checked_sub(first).filter(|_| row.first < begin) else {
                continue;
            };
            for (column, value) in columns[from..].iter_mut().zip(row.values.iter()) {
                column[place] = *value;
            }
        }
        Self { begin, first, columns }
    }

    /// `A_IJ - Σ_K L_IK L_JKᵀ` of some rows, zero left of where they begin and beyond the diagonal.
    #[inline(always)]
    fn remainders<S: Simd>(&self, simd: S, rows: &[Row<'_>]) -> Vec<BlockRow> {
        let mut out: Vec<BlockRow> = rows.iter().map(|row| self.block_row(row)).collect();
        for part in (0..self.columns.len()).step_by(DEPTH) {
            let part = part..(part + DEPTH).min(self.columns.len());
            for (rows, out) in rows.chunks(ROWS).zip(out.chunks_mut(ROWS)) {
                self.subtract_part(simd, rows, out, part.clone());
            }
        }
        out
    }

    /// The entries of a row in the columns of the block.
    #[inline(always)]
    fn block_row(&self, row: &Row<'_>) -> BlockRow {
        let mut out = [0.0; BLOCK];
        let to = row.first.saturating_sub(self.begin).min(BLOCK);
        let from = self.begin.saturating_sub(row.first).min(row.values.len());
        for (out, value) in out[to..].iter_mut().zip(&row.values[from..]) {
            *out = *value;
        }
        out
    }

    /// Subtracts the products with some columns of the panel from up to [`ROWS`] rows.
    #[inline(always)]
    fn subtract_part<S: Simd>(
        &self,
        simd: S,
        rows: &[Row<'_>],
        out: &mut [BlockRow],
        part: std::ops::Range<usize>,
    ) {
        // Place in the part where every row has begun.
        let place =
            |row: &Row<'_>| (row.first.max(self.first) - self.first).clamp(part.start, part.end);
        let common = rows.iter().map(place).max().unwrap_or(part.end);
        let common = if rows.len() == ROWS { common } else { part.end };
        let entries = |row: &'_ Row<'_>, from: usize, to: usize| -> std::ops::Range<usize> {
            let shift = |place: usize| (self.first + place).saturating_sub(row.first);
            shift(from)..shift(to)
        };
        for (row, out) in rows.iter().zip(out.iter_mut()) {
            let from = place(row).min(common);
            let left = [&row.values[entries(row, from, common)]];
            subtract_products(simd, left, &self.columns[from..common], std::array::from_mut(out));
        }
        if let (Ok(rows), Ok(out)) =
            (<&[Row<'_>; ROWS]>::try_from(rows), <&mut [BlockRow; ROWS]>::try_from(out))
        {
            let left =
                std::array::from_fn(|i| &rows[i].values[entries(&rows[i], common, part.end)]);
            subtract_products(simd, left, &self.columns[common..part.end], out);
        }
    }
}

/// Subtracts `left · columns` from some rows.
#[inline(always)]
fn subtract_products<S: Simd, const N: usize>(
    simd: S,
    left: [&[f64]; N],
    columns: &[BlockRow],
    out: &mut [BlockRow; N],
) {
    let count = columns.len();
    if count == 0 {
        return;
    }
    let left = left.map(|row| &row[..count]);
    for place in (0..BLOCK / S::F64_LANES).step_by(VECTORS) {
        let mut sums = [[simd.splat_f64s(0.0); VECTORS]; N];
        for i in 0..N {
            let known = S::as_simd_f64s(&out[i]).0;
            sums[i].copy_from_slice(&known[place..place + VECTORS]);
        }
        for k in 0..count {
            let column = &S::as_simd_f64s(&columns[k]).0[place..place + VECTORS];
            for i in 0..N {
                let factor = simd.splat_f64s(left[i][k]);
                for v in 0..VECTORS {
                    sums[i][v] = simd.negate_mul_add_e_f64s(factor, column[v], sums[i][v]);
                }
            }
        }
        for i in 0..N {
            let known = S::as_mut_simd_f64s(&mut out[i]).0;
            known[place..place + VECTORS].copy_from_slice(&sums[i]);
        }
    }
}

/// Subtracts `factor · other` from a row, from the vector with entry `from` on.
#[inline(always)]
fn subtract_row<S: Simd>(simd: S, row: &mut BlockRow, factor: f64, other: &BlockRow, from: usize) {
    let factor = simd.splat_f64s(factor);
    let (row, other) = (S::as_mut_simd_f64s(row).0, S::as_simd_f64s(other).0);
    for v in from / S::F64_LANES..BLOCK / S::F64_LANES {
        row[v] = simd.negate_mul_add_e_f64s(factor, other[v], row[v]);
    }
}

/// Cholesky's factor of a diagonal block.
struct Triangle {
    diagonal: BlockRow,
    /// `L_JJᵀ` without its diagonal.
    above: Vec<BlockRow>,
}

/// Factorisation of a diagonal block; `None` where it is not positive definite.
struct DiagonalBlock<'a, 'b> {
    rows: &'a mut [Row<'b>],
    panel: &'a Panel,
}

impl WithSimd for DiagonalBlock<'_, '_> {
    type Output = Option<Triangle>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Option<Triangle> {
        let rows = self.panel.remainders(simd, self.rows);
        let size = rows.len();
        let mut above = vec![[0.0; BLOCK]; size];
        for (r, row) in rows.iter().enumerate() {
            (0..=r).for_each(|c| above[c][r] = row[c]);
        }
        let mut diagonal = [1.0; BLOCK];
        for c in 0..size {
            let (done, below) = above.split_at_mut(c + 1);
            let row = &mut done[c];
            if !(row[c].is_finite() && row[c] > 0.0) {
                return None;
            }
            diagonal[c] = row[c].sqrt();
            row[..=c].fill(0.0);
            row[c + 1..].iter_mut().for_each(|v| *v /= diagonal[c]);
            for (r, other) in (c + 1..).zip(below) {
                subtract_row(simd, other, row[r], row, r);
            }
        }
        for (r, row) in self.rows.iter_mut().enumerate() {
            let from = row.first.max(self.panel.begin) - self.panel.begin;
            let end = row.values.len();
            let factor = (from..r).map(|c| above[c][r]).chain([diagonal[r]]);
            row.values[end - 1 - (r - from)..].iter_mut().zip(factor).for_each(|(v, l)| *v = l);
        }
        Some(Triangle { diagonal, above })
    }
}

/// Factorisation of rows below a diagonal block.
struct BlockBelow<'a, 'b> {
    rows: &'a mut [Row<'b>],
    panel: &'a Panel,
    diagonal: &'a Triangle,
}

impl WithSimd for BlockBelow<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let mut found = self.panel.remainders(simd, self.rows);
        let Triangle { diagonal, above } = self.diagonal;
        for rows in found.chunks_mut(ROWS) {
            for c in 0..BLOCK {
                for row in &mut *rows {
                    row[c] /= diagonal[c];
                    subtract_row(simd, row, row[c], &above[c], c);
                }
            }
        }
        let begin = self.panel.begin;
        for (row, found) in self.rows.iter_mut().zip(&found) {
            let to = row.first.saturating_sub(begin).min(BLOCK);
            let from = begin.saturating_sub(row.first).min(row.values.len());
            let entries = row.values[from..].iter_mut().zip(&found[to..]);
            entries.for_each(|(value, found)| *value = *found);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_close, noise};

    /// Cholesky's factorisation, an entry after another.
    fn factorise_by_entries(matrix: &mut SkylineMatrix) -> bool {
        let SkylineMatrix { first, start, values } = matrix;
        for i in 0..first.len() {
            for j in first[i]..=i {
                let entry = |row: usize, column: usize| values[start[row] + column - first[row]];
                let shared = first[i].max(first[j])..j;
                let rest = entry(i, j) - shared.map(|k| entry(i, k) * entry(j, k)).sum::<f64>();
                if i == j && (rest.is_nan() || rest <= 0.0) {
                    return false;
                }
                let value = if i == j { rest.sqrt() } else { rest / entry(j, j) };
                values[start[i] + j - first[i]] = value;
            }
        }
        true
    }

    /// A positive definite matrix whose rows begin anywhere: in bands, at the diagonal, in groups
    /// of six and at the left edge.
    fn matrix(rows: usize, band: usize) -> SkylineMatrix {
        let places = noise(rows as u64, rows);
        let first = |row: usize| match row % 97 {
            0 => row,
            1 => 0,
            2..50 => (row - row % 6).saturating_sub(band),
            _ => row.saturating_sub((places[row].abs() * band as f64) as usize),
        };
        let mut matrix = SkylineMatrix::new((0..rows).map(first).collect());
        matrix.values = noise(7, matrix.values.len());
        for row in 0..rows {
            matrix.values[matrix.start[row + 1] - 1] = 2.0 * rows as f64;
        }
        matrix
    }

    #[test]
    fn blocks_agree_with_entries_on_every_instruction_set() {
        for (rows, band) in [(1, 0), (5, 3), (48, 60), (49, 20), (331, 90), (700, 900)] {
            let mut expected = matrix(rows, band);
            assert!(factorise_by_entries(&mut expected));
            for arch in crate::simd::instruction_sets() {
                let mut found = matrix(rows, band);
                assert!(factorise(&mut found, arch));
                assert_close("factor", &found.values, &expected.values, 1e-12);
            }
        }
    }

    /// The last pivot of a matrix of which one eigenvalue is negative.
    #[test]
    fn an_indefinite_matrix_is_refused_in_any_block() {
        for row in [0, 47, 48, 200] {
            let mut indefinite = matrix(201, 40);
            let diagonal = indefinite.start[row + 1] - 1;
            indefinite.values[diagonal] = -1.0;
            assert!(!factorise(&mut indefinite, Arch::new()), "{row}");
            indefinite.values[diagonal] = f64::NAN;
            assert!(!factorise(&mut indefinite, Arch::new()), "{row}");
        }
    }

    #[test]
    fn the_number_of_threads_changes_no_byte() {
        let with = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let mut matrix = matrix(500, 300);
            assert!(pool.expect("a pool").install(|| factorise(&mut matrix, Arch::new())));
            matrix.values
        };
        assert_eq!(with(1), with(4));
    }
}

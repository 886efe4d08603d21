//! Large symmetric systems whose entries lie near the diagonal: skyline storage, Cholesky
//! factorisation, and an order of the unknowns that keeps the profile narrow.

mod cholesky;

use pulp::Arch;
use std::collections::VecDeque;

/// Partial sums of an inner product, so that it compiles to vector instructions.
const LANES: usize = 8;

/// The lower triangle of a symmetric matrix, every row from its first entry to the diagonal
/// (Jennings 1966). Cholesky's factor has its entries in the same places.
#[derive(Clone, Debug)]
pub struct SkylineMatrix {
    /// Column of the first entry of every row.
    first: Vec<usize>,
    /// Offset of every row among the values, and their number at the end.
    start: Vec<usize>,
    values: Vec<f64>,
}

impl SkylineMatrix {
    /// A matrix of zeros; `first[i] <= i` is the column in which row `i` begins.
    pub fn new(first: Vec<usize>) -> Self {
        let mut start = Vec::with_capacity(first.len() + 1);
        start.push(0);
        let mut end = 0;
        for (row, first) in first.iter().enumerate() {
            end += row + 1 - first;
            start.push(end);
        }
        Self { first, start, values: vec![0.0; end] }
    }

    /// Adds to the entry of a row and a column between the row's first one and the diagonal.
    pub fn add(&mut self, row: usize, column: usize, value: f64) {
        self.values[self.start[row] + column - self.first[row]] += value;
    }

    /// The values of all rows in turn, for every group of rows that ends before one of `ends`.
    pub fn split(&mut self, ends: impl Iterator<Item = usize>) -> Vec<&mut [f64]> {
        let mut rest = self.values.as_mut_slice();
        let mut begin = 0;
        let mut out = Vec::new();
        for end in ends {
            let (group, after) = rest.split_at_mut(self.start[end] - begin);
            out.push(group);
            (rest, begin) = (after, self.start[end]);
        }
        out
    }

    /// Solves `A x = b` in place by Cholesky's factorisation, which replaces `A`. Returns whether
    /// `A` was positive definite; if not, `b` holds nothing useful.
    pub fn solve(&mut self, b: &mut [f64]) -> bool {
        let is_definite = self.factorise();
        if is_definite {
            self.substitute(b);
        }
        is_definite
    }

    /// Solves `A x = b` in place where [`factorise`](Self::factorise) has replaced `A`.
    pub fn substitute(&self, b: &mut [f64]) {
        for i in 0..b.len() {
            let row = &self.values[self.start[i]..self.start[i + 1]];
            let (left, diagonal) = (&row[..row.len() - 1], row[row.len() - 1]);
            b[i] = (b[i] - dot(left, &b[self.first[i]..i])) / diagonal;
        }
        for i in (0..b.len()).rev() {
            let row = &self.values[self.start[i]..self.start[i + 1]];
            b[i] /= row[row.len() - 1];
            let known = b[i];
            b[self.first[i]..i].iter_mut().zip(row).for_each(|(b, l)| *b -= l * known);
        }
    }

    /// Replaces `A` by Cholesky's factor; returns whether it was positive definite.
    pub fn factorise(&mut self) -> bool {
        cholesky::factorise(self, Arch::new())
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut lanes = [0.0; LANES];
    let (a_parts, b_parts) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = a_parts.remainder().iter().zip(b_parts.remainder()).map(|(x, y)| x * y);
    let rest: f64 = rest.sum();
    for (x, y) in a_parts.zip(b_parts) {
        for i in 0..LANES {
            lanes[i] += x[i] * y[i];
        }
    }
    lanes.iter().sum::<f64>() + rest
}

/// Reverse Cuthill-McKee (1969) order of nodes by their `neighbours`: breadth first from the ends
/// of chains, nodes with few neighbours first.
pub fn reverse_cuthill_mckee(neighbours: &[Vec<usize>]) -> Vec<usize> {
    let blocks = neighbours.len();
    let mut by_degree: Vec<usize> = (0..blocks).collect();
    by_degree.sort_by_key(|b| neighbours[*b].len());
    let mut is_placed = vec![false; blocks];
    let mut order = Vec::with_capacity(blocks);
    for begin in by_degree {
        if is_placed[begin] {
            continue;
        }
        let reached = breadth_first(neighbours, begin, &is_placed);
        let end = reached.last().copied().unwrap_or(begin);
        let component = breadth_first(neighbours, end, &is_placed);
        component.iter().for_each(|b| is_placed[*b] = true);
        order.extend(component);
    }
    order.reverse();
    order
}

fn breadth_first(neighbours: &[Vec<usize>], begin: usize, is_placed: &[bool]) -> Vec<usize> {
    let mut is_reached = is_placed.to_vec();
    let mut queue = VecDeque::from([begin]);
    let mut order = Vec::new();
    is_reached[begin] = true;
    while let Some(block) = queue.pop_front() {
        order.push(block);
        let mut next: Vec<usize> =
            neighbours[block].iter().copied().filter(|b| !is_reached[*b]).collect();
        next.sort_by_key(|b| (neighbours[*b].len(), *b));
        next.iter().for_each(|b| is_reached[*b] = true);
        queue.extend(next);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::{assert_close, noise};

    #[test]
    fn a_system_is_solved_and_an_indefinite_one_refused() {
        let n = 37;
        let m = noise(1, n * n);
        // Row i begins at most nine columns before the diagonal, every seventh one at zero.
        let first: Vec<usize> =
            (0..n).map(|i| if i % 7 == 0 { 0 } else { i.saturating_sub(9) }).collect();
        let entry = |i: usize, j: usize| {
            let (i, j) = (i.max(j), i.min(j));
            match (i == j, j >= first[i]) {
                (true, _) => 15.0 + m[i * n + i],
                (false, true) => m[i * n + j],
                (false, false) => 0.0,
            }
        };
        let mut a = SkylineMatrix::new(first.clone());
        for i in 0..n {
            (first[i]..=i).for_each(|j| a.add(i, j, entry(i, j)));
        }
        let x = noise(2, n);
        let mut b: Vec<f64> = (0..n).map(|i| (0..n).map(|j| entry(i, j) * x[j]).sum()).collect();
        assert!(a.solve(&mut b));
        assert_close("solution", &b, &x, 1e-9);
        let mut indefinite = SkylineMatrix::new(vec![0, 0]);
        for (row, column, value) in [(0, 0, 1.0), (1, 0, 2.0), (1, 1, 1.0)] {
            indefinite.add(row, column, value);
        }
        assert!(!indefinite.solve(&mut [1.0, 1.0]));
    }
}

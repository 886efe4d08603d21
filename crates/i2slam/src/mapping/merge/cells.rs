//! Who lies beside whom: Gaussians of one size in one cell of space.

use super::united::{average, distances, log_area};
use i2slam_radiance::gaussian::GaussianMap;
use rayon::slice::ParallelSliceMut;
use std::ops::Range;

/// A place in space at a size, and who is there.
pub(super) type Member = (u64, u32);

/// All that are kept, by cell.
pub(super) fn cells(map: &GaussianMap, keep: &[bool], edge: f32) -> Vec<Member> {
    let kept = keep.iter().enumerate().filter(|(_, keep)| **keep);
    let mut cells: Vec<Member> = kept.map(|(i, _)| (cell(map, i, edge), i as u32)).collect();
    cells.par_sort_unstable();
    cells
}

/// The cell of a Gaussian among those of its size, within a doubling.
fn cell(map: &GaussianMap, index: usize, edge: f32) -> u64 {
    let size = (0.5 * log_area(map, index) / std::f32::consts::LN_2).round();
    let part = |v: f32, bits: u32| (v.floor() as i64 as u64) & ((1 << bits) - 1);
    let edge = edge * size.exp2();
    let place = map.means[index].iter().fold(0, |key, v| key << 18 | part(v / edge, 18));
    place << 10 | part(size, 10)
}

/// Cells of two and more, with how much their colours differ.
pub(super) fn groups(map: &GaussianMap, cells: &[Member]) -> Vec<(f32, Range<usize>)> {
    let mut groups = Vec::new();
    let mut start = 0;
    for members in cells.chunk_by(|a, b| a.0 == b.0) {
        let end = start + members.len();
        if members.len() > 1 {
            groups.push((contrast(map, members), start..end));
        }
        start = end;
    }
    groups
}

/// Weighted variance of the stored colours.
fn contrast(map: &GaussianMap, members: &[Member]) -> f32 {
    let mean = average(map, members, |i| map.colours[i]);
    average(map, members, |i| distances(map.colours[i], mean)).iter().sum()
}

//! Normal equations of a block of residuals.

use super::Equations;
use super::block::{Row, groups};
use i2slam_compute::simd::Lanes;
use pulp::Simd;

/// Products that are summed at once.
const TILE: usize = 4;

/// Adds `jᵀ j` and `jᵀ r` of a block, where `rows` are the derivatives `j` by `unknowns` (in
/// increasing order) and last the residuals `r`, all times the root of their weights.
#[inline(always)]
pub(super) fn add_products<S: Simd>(
    simd: S,
    rows: &[&Row],
    unknowns: &[usize],
    equations: &mut Equations,
) {
    let Some(last) = rows.len().checked_sub(1) else { return };
    for (i, &a) in unknowns.iter().enumerate() {
        for j in (i..=last).step_by(TILE) {
            let sums = products(simd, rows[i], &[0, 1, 2, 3].map(|k| rows[(j + k).min(last)]));
            for (k, &sum) in sums.iter().enumerate().take(last + 1 - j) {
                match unknowns.get(j + k) {
                    Some(&b) => equations.hessian[a][b] += f64::from(sum),
                    None => equations.gradient[a] += f64::from(sum),
                }
            }
        }
    }
}

#[inline(always)]
fn products<S: Simd>(simd: S, row: &Row, others: &[&Row; TILE]) -> [f32; TILE] {
    let mut sums = [Lanes::zero(simd); TILE];
    for group in 0..groups::<S>() {
        let value = Lanes::load_group(simd, row, group);
        for k in 0..TILE {
            sums[k] = value.mul_add(Lanes::load_group(simd, others[k], group), sums[k]);
        }
    }
    let mut totals = [0.0; TILE];
    for k in 0..TILE {
        totals[k] = sums[k].reduce_sum();
    }
    totals
}

//! The plain lane of the encoding.

use super::Level;
use i2slam_geometry::Real;

/// Corner `c` of eight: bit `k` says which side along axis `k`.
fn side(c: usize, k: usize) -> u32 {
    (c >> k & 1) as u32
}

/// The cell of `x` (in the unit cube): its first node, and the fraction within.
fn cell<T: Real>(level: &Level, x: [T; 3]) -> ([u32; 3], [T; 3]) {
    let p = x.map(|x| x.max(T::zero()).min(T::one()) * T::of(level.scale) + T::of(0.5));
    let node = p.map(|p| p.floor().to_f64() as u32);
    (node, std::array::from_fn(|k| p[k] - p[k].floor()))
}

/// Weight of corner `c`, leaving out axis `without`.
fn weight<T: Real>(fraction: &[T; 3], c: usize, without: Option<usize>) -> T {
    let factor = |k: usize| if side(c, k) == 1 { fraction[k] } else { T::one() - fraction[k] };
    (0..3).filter(|k| Some(*k) != without).fold(T::one(), |w, k| w * factor(k))
}

/// First number of the entry of corner `c`.
fn entry(level: &Level, node: [u32; 3], c: usize, features: usize) -> usize {
    let corner = std::array::from_fn(|k| node[k] + side(c, k));
    (level.first + level.index(corner)) * features
}

/// The features of `x`, level by level.
pub(crate) fn encode<T: Real>(
    levels: &[Level],
    features: usize,
    table: &[T],
    x: [T; 3],
    out: &mut [T],
) {
    for (level, out) in levels.iter().zip(out.chunks_mut(features)) {
        let (node, fraction) = cell(level, x);
        out.fill(T::zero());
        for c in 0..8 {
            let at = entry(level, node, c, features);
            let w = weight(&fraction, c, None);
            (0..features).for_each(|f| out[f] += w * table[at + f]);
        }
    }
}

/// Adds `∂L/∂table` to `table_gradient` when given; returns `∂L/∂x`.
pub(crate) fn pull_back<T: Real>(
    levels: &[Level],
    features: usize,
    table: &[T],
    x: [T; 3],
    cotangent: &[T],
    mut table_gradient: Option<&mut [T]>,
) -> [T; 3] {
    let mut dx = [T::zero(); 3];
    for (level, d) in levels.iter().zip(cotangent.chunks(features)) {
        let (node, fraction) = cell(level, x);
        for c in 0..8 {
            let at = entry(level, node, c, features);
            let w = weight(&fraction, c, None);
            if let Some(gradient) = &mut table_gradient {
                (0..features).for_each(|f| gradient[at + f] += w * d[f]);
            }
            let value: T = (0..features).map(|f| d[f] * table[at + f]).sum();
            for k in 0..3 {
                let sign = T::of(f64::from(2 * side(c, k)) - 1.0) * T::of(level.scale);
                dx[k] += sign * weight(&fraction, c, Some(k)) * value;
            }
        }
    }
    dx
}

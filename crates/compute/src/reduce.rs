//! Parallel sums whose order does not depend on the number of threads.

use rayon::prelude::*;

/// Map fixed chunks of `0..count` in parallel, then fold the results in order of the chunks.
pub fn reduce_in_order<A: Send>(
    count: usize,
    chunk: usize,
    map: impl Fn(std::ops::Range<usize>) -> A + Sync,
    mut fold: impl FnMut(A),
) {
    let chunks = count.div_ceil(chunk);
    let parts: Vec<A> =
        (0..chunks).into_par_iter().map(|i| map(i * chunk..((i + 1) * chunk).min(count))).collect();
    parts.into_iter().for_each(&mut fold);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_every_index_once() {
        let mut total = 0;
        reduce_in_order(1001, 64, |range| range.sum::<usize>(), |part| total += part);
        assert_eq!(total, 1000 * 1001 / 2);
    }
}

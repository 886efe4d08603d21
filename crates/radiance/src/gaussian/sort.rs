//! Sorting by depth: a parallel radix sort, least significant digit first, that keeps the order
//! of equal keys.
//!
//! An item is a key in the upper half of a `u64` and what it belongs to in the lower half.
//! Items of one pass are scattered to places that no two threads share; relaxed atomic stores
//! say so without `unsafe` and cost what plain stores cost.

use rayon::prelude::*;
use std::sync::atomic::{AtomicU32, AtomicU64, Ordering::Relaxed};

/// Bits of one digit, at most.
const DIGIT_BITS: u32 = 11;
/// Items that one thread takes at least.
const CHUNK: usize = 8192;

/// The item of a positive depth and an index: ordered by depth.
pub(crate) fn item(depth: f32, index: u32) -> u64 {
    (u64::from(depth.to_bits()) << 32) | u64::from(index)
}

pub(crate) fn index(item: u64) -> usize {
    (item & 0xffff_ffff) as usize
}

/// Buffers of the sort.
#[derive(Default)]
pub(crate) struct Sorter {
    front: Vec<AtomicU64>,
    back: Vec<AtomicU64>,
    /// One row of counts, then places, per chunk.
    places: Vec<AtomicU32>,
}

impl Sorter {
    /// Sorts `items` by their upper halves, stably.
    pub(crate) fn sort(&mut self, items: &mut [u64]) {
        let key = |item: &u64| (item >> 32) as u32;
        let low = items.iter().map(key).min().unwrap_or(0);
        let high = items.iter().map(key).max().unwrap_or(0);
        let bits = u32::BITS - (high - low).leading_zeros();
        if bits == 0 {
            return;
        }
        let passes = bits.div_ceil(DIGIT_BITS);
        let width = bits.div_ceil(passes);
        let chunk = items.len().div_ceil(rayon::current_num_threads()).max(CHUNK);
        self.load(items);
        for pass in 0..passes {
            let shift = pass * width;
            let digit = |item: u64| ((((item >> 32) as u32) - low) >> shift) & ((1 << width) - 1);
            scatter(&self.front, &self.back, &mut self.places, chunk, 1 << width, digit);
            std::mem::swap(&mut self.front, &mut self.back);
        }
        items.iter_mut().zip(&self.front).for_each(|(to, from)| *to = from.load(Relaxed));
    }

    fn load(&mut self, items: &[u64]) {
        self.front.truncate(items.len());
        self.front.iter().zip(items).for_each(|(to, from)| to.store(*from, Relaxed));
        let loaded = self.front.len();
        self.front.extend(items[loaded..].iter().map(|item| AtomicU64::new(*item)));
        self.back.resize_with(items.len(), AtomicU64::default);
    }
}

/// One pass: items of `from` in order of their digit, equal digits in order, into `to`.
fn scatter(
    from: &[AtomicU64],
    to: &[AtomicU64],
    places: &mut Vec<AtomicU32>,
    chunk: usize,
    digits: usize,
    digit: impl Fn(u64) -> u32 + Sync,
) {
    let chunks = from.len().div_ceil(chunk);
    places.resize_with(chunks * digits, AtomicU32::default);
    let rows = || places.par_chunks(digits).zip(from.par_chunks(chunk));
    rows().for_each(|(row, items)| {
        row.iter().for_each(|count| count.store(0, Relaxed));
        items.iter().for_each(|item| {
            take(&row[digit(item.load(Relaxed)) as usize]);
        });
    });
    let mut next = 0;
    for d in 0..digits {
        for c in 0..chunks {
            let place = &places[c * digits + d];
            let count = place.load(Relaxed);
            place.store(next, Relaxed);
            next += count;
        }
    }
    rows().for_each(|(row, items)| {
        items.iter().for_each(|item| {
            let item = item.load(Relaxed);
            to[take(&row[digit(item) as usize]) as usize].store(item, Relaxed);
        });
    });
}

/// The value, which is counted up. Only one thread may use the counter.
#[inline(always)]
pub(crate) fn take(counter: &AtomicU32) -> u32 {
    let value = counter.load(Relaxed);
    counter.store(value + 1, Relaxed);
    value
}

#[cfg(test)]
mod tests {
    use super::*;

    fn depths(count: usize, levels: usize) -> Vec<u64> {
        let noise = i2slam_check::noise(7, count);
        (0..count)
            .map(|i| {
                let level = ((noise[i] + 1.0) * 0.5 * levels as f64) as u32;
                item(0.5 + level as f32 / 64.0, i as u32)
            })
            .collect()
    }

    #[test]
    fn agrees_with_a_stable_sort() {
        let mut sorter = Sorter::default();
        for (count, levels) in [(0, 1), (1, 1), (5, 1), (1000, 7), (40_000, 300), (70_001, 1 << 20)]
        {
            let mut items = depths(count, levels);
            let mut expected = items.clone();
            expected.sort_by_key(|item| item >> 32);
            sorter.sort(&mut items);
            assert_eq!(items, expected, "{count} items on {levels} levels");
        }
    }
}

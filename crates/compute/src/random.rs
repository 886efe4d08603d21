//! Reproducible random numbers.

/// SplitMix64 (Steele, Lea and Flood 2014): the same seed gives the same numbers everywhere.
#[derive(Clone, Debug)]
pub struct Random {
    state: u64,
}

impl Random {
    /// A generator for `seed`.
    pub fn new(seed: u64) -> Self {
        Self { state: seed }
    }

    /// The next 64 bits.
    pub fn bits(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// A number in `[0, 1)`.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// An index in `0..count`. `count` must not be zero.
    pub fn below(&mut self, count: usize) -> usize {
        ((u128::from(self.bits()) * count as u128) >> 64) as usize
    }

    /// `size` different indices in `0..count`.
    ///
    /// # Panics
    /// If there are not so many.
    pub fn distinct_below(&mut self, count: usize, size: usize) -> Vec<usize> {
        assert!(size <= count, "{size} of {count} indices");
        let mut chosen = Vec::with_capacity(size);
        while chosen.len() < size {
            let index = self.below(count);
            if !chosen.contains(&index) {
                chosen.push(index);
            }
        }
        chosen
    }

    /// Puts `items` in random order (Fisher and Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for i in (1..items.len()).rev() {
            items.swap(i, self.below(i + 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_seed_gives_the_same_numbers() {
        let draw = |seed| (0..8).map(|_| 0).scan(Random::new(seed), |r, _: i32| Some(r.bits()));
        assert!(draw(3).eq(draw(3)));
        assert!(!draw(3).eq(draw(4)));
    }

    #[test]
    fn indices_cover_their_range() {
        let mut random = Random::new(1);
        let mut seen = [0; 5];
        for _ in 0..1000 {
            seen[random.below(5)] += 1;
        }
        assert!(seen.iter().all(|&n| n > 100));
    }

    #[test]
    fn indices_of_a_sample_differ_and_none_is_favoured() {
        let mut random = Random::new(1);
        let mut seen = [0; 5];
        for _ in 0..1000 {
            let sample = random.distinct_below(5, 3);
            assert!(sample[0] != sample[1] && sample[0] != sample[2] && sample[1] != sample[2]);
            sample.iter().for_each(|index| seen[*index] += 1);
        }
        assert!(seen.iter().all(|&n: &i32| (n - 600).abs() < 75), "{seen:?}");
    }
}

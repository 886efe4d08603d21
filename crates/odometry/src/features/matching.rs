//! Matching of the features of two pictures.

use super::aliked::Features;
use crate::track::patch::dot;

/// Distance of a match over that of the second best, at most.
const MAX_DISTANCE_RATIO: f32 = 0.95;

/// Squared distance of descriptors that are equal but for rounding.
const MIN_SQUARED_DISTANCE: f32 = 1e-5;
/// Distance from the best match beyond which the second best shows another point [px of the
/// larger picture that features are found in].
const MIN_ELSEWHERE: f64 = 10.0;

/// A feature of one picture that looks like a feature of another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FeatureMatch {
    pub(super) first: usize,
    pub(super) second: usize,
    /// Distance over that of the second best.
    pub(super) ratio: f32,
}

/// Largest and second largest product of a feature with others.
#[derive(Clone, Copy)]
struct Best {
    index: usize,
    most: f32,
    second_index: usize,
    second: f32,
}

impl Best {
    const NONE: Self =
        Self { index: usize::MAX, most: -1.0, second_index: usize::MAX, second: -1.0 };

    fn add(&mut self, index: usize, product: f32) {
        if product > self.most {
            (self.second_index, self.second) = (self.index, self.most);
            (self.index, self.most) = (index, product);
        } else if product > self.second {
            (self.second_index, self.second) = (index, product);
        }
    }

    /// Ratio of both distances; 1 where both are nothing but rounding.
    fn ratio(&self) -> f32 {
        let distance = |product: f32| (2.0 - 2.0 * product).max(MIN_SQUARED_DISTANCE).sqrt();
        distance(self.most) / distance(self.second)
    }
}

/// Matches of two pictures, and for comparison what looks alike and does not match.
#[derive(Clone, Debug, Default)]
pub(super) struct Matches {
    /// Mutually best matches that pass the ratio test, most distinct first.
    pub(super) distinct: Vec<FeatureMatch>,
    /// Features of the first picture, and those elsewhere than their best match that are second best.
    pub(super) second_best: Vec<(usize, usize)>,
}

/// Matches the features of two pictures.
pub(super) fn match_features(first: &Features, second: &Features) -> Matches {
    let (mut here, mut there) = (vec![Best::NONE; first.len()], vec![Best::NONE; second.len()]);
    for (own, theirs) in first.by_size().into_iter().zip(second.by_size()) {
        for i in own {
            for j in theirs.clone() {
                let product = dot(&first.descriptors[i], &second.descriptors[j]);
                here[i].add(j, product);
                there[j].add(i, product);
            }
        }
    }
    let of = |(i, best): (usize, &Best)| {
        let back = there.get(best.index)?;
        let ratio = best.ratio().max(back.ratio());
        let is_match = back.index == i && ratio < MAX_DISTANCE_RATIO;
        is_match.then_some(FeatureMatch { first: i, second: best.index, ratio })
    };
    let mut distinct: Vec<FeatureMatch> = here.iter().enumerate().filter_map(of).collect();
    distinct.sort_by(|a, b| a.ratio.total_cmp(&b.ratio).then(a.first.cmp(&b.first)));
    let elsewhere = |(i, best): (usize, &Best)| {
        let (a, b) = (second.positions.get(best.index)?, second.positions.get(best.second_index)?);
        let distance = (a[0] - b[0]).hypot(a[1] - b[1]);
        (distance > second.pixel * MIN_ELSEWHERE).then_some((i, best.second_index))
    };
    Matches { distinct, second_best: here.iter().enumerate().filter_map(elsewhere).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::features::aliked::Descriptor;
    use i2slam_check::noise;

    fn features(seed: u64, count: usize) -> Features {
        let length = size_of::<Descriptor>() / size_of::<f32>();
        let numbers = noise(seed, count * length);
        let descriptor = |n: &[f64]| {
            let norm = n.iter().map(|v| v * v).sum::<f64>().sqrt();
            std::array::from_fn(|i| (n[i] / norm) as f32)
        };
        Features::of_larger(
            vec![[0.0; 2]; count],
            numbers.chunks_exact(length).map(descriptor).collect(),
        )
    }

    #[test]
    fn equal_features_match_and_repeated_ones_do_not() {
        let first = features(1, 30);
        let mut second = features(2, 30);
        for i in 0..10 {
            second.descriptors[2 * i] = first.descriptors[i];
        }
        // The first feature is seen twice.
        second.descriptors[29] = first.descriptors[0];
        let found = match_features(&first, &second).distinct;
        let planted = found.iter().filter(|m| m.first < 10 && m.second == 2 * m.first);
        assert_eq!(planted.count(), 9);
        assert!(found.iter().all(|m| m.first > 0), "what is seen twice is matched: {found:?}");
        assert!(found.windows(2).all(|pair| pair[0].ratio <= pair[1].ratio));
    }
}

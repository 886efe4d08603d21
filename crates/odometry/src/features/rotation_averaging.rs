//! Orientations of photographs from the rotations between pairs of them, and the pairs that contradict.
//!
//! Robust averaging from a spanning tree of the pairs with most matches (Chatterjee and Govindu 2013, by
//! turns instead of all at once). Patterns that look the same from two sides match, but contradict the way
//! around.

use i2slam_compute::Random;
use i2slam_geometry::{Rotation, Vec3};
use std::collections::BTreeMap;

/// Width of the loss of the angles by which pairs contradict (Geman and McClure) [rad].
const LOSS_WIDTH: f64 = 0.15;
/// Angle by which the pairs of a triangle may contradict [rad].
const MAX_TRIANGLE_ERROR: f64 = 0.5;
/// Spanning trees that are tried.
const TREES: usize = 200;
/// Rounds over all photographs.
const MAX_ROUNDS: usize = 200;
/// Change of all orientations at which they have converged [rad].
const CONVERGED_CHANGE: f64 = 1e-6;

/// Rotation between two photographs, by their indices.
#[derive(Clone, Copy, Debug)]
pub(super) struct RelativeRotation {
    pub(super) first: usize,
    pub(super) second: usize,
    pub(super) second_from_first: Rotation<f64>,
    /// Square of the number of matches that agree.
    pub(super) weight: f64,
}

/// Orientation `camera_from_world` of each of `count` photographs, and the number of the connected part that
/// it belongs to; each part has a world of its own.
pub(super) fn average_rotations(
    count: usize,
    pairs: &[RelativeRotation],
) -> Vec<(usize, Rotation<f64>)> {
    let pairs = &weighted_by_triangles(count, pairs);
    let mut found = best_spanning_tree(count, pairs);
    for _ in 0..MAX_ROUNDS {
        let mut change: f64 = 0.0;
        for of in 0..count {
            let own = found[of].1;
            let (mut sum, mut weights) = (Vec3::zero(), 0.0);
            for (predicted, weight) in predictions(&found, pairs, of) {
                let off = (predicted * own.inverse()).log();
                let ratio = off.norm() / LOSS_WIDTH;
                let weight = weight / ((1.0 + ratio * ratio) * (1.0 + ratio * ratio));
                (sum, weights) = (sum + off * weight, weights + weight);
            }
            if weights > 0.0 {
                let step = sum * (1.0 / weights);
                change = change.max(step.norm());
                found[of].1 = Rotation::exp(step) * own;
            }
        }
        if change < CONVERGED_CHANGE {
            break;
        }
    }
    found
}

/// The pairs, each with the share of its weight that triangles of pairs confirm (Zach, Klopschitz and
/// Pollefeys 2010); all of it where there is none.
fn weighted_by_triangles(count: usize, pairs: &[RelativeRotation]) -> Vec<RelativeRotation> {
    let mut around: Vec<BTreeMap<usize, (Rotation<f64>, f64)>> = vec![BTreeMap::new(); count];
    for RelativeRotation { first, second, second_from_first, weight } in pairs {
        around[*first].insert(*second, (*second_from_first, *weight));
        around[*second].insert(*first, (second_from_first.inverse(), *weight));
    }
    let weighted = |pair: &RelativeRotation| {
        let (mut agreeing, mut all) = (1.0, 1.0);
        for (third, (third_from_first, a)) in &around[pair.first] {
            let Some((third_from_second, b)) = around[pair.second].get(third) else { continue };
            let way_around = third_from_second.inverse() * *third_from_first;
            let off = (way_around.inverse() * pair.second_from_first).log().norm();
            let weight = a.min(*b).min(pair.weight);
            all += weight;
            agreeing += if off < MAX_TRIANGLE_ERROR { weight } else { 0.0 };
        }
        RelativeRotation { weight: pair.weight * agreeing / all, ..*pair }
    };
    pairs.iter().map(weighted).collect()
}

/// Orientations of one photograph that its pairs predict, and their weights.
fn predictions<'a>(
    found: &'a [(usize, Rotation<f64>)],
    pairs: &'a [RelativeRotation],
    of: usize,
) -> impl Iterator<Item = (Rotation<f64>, f64)> + 'a {
    pairs.iter().filter_map(move |pair| {
        let RelativeRotation { first, second, second_from_first, weight } = *pair;
        if second == of {
            Some((second_from_first * found[first].1, weight))
        } else if first == of {
            Some((second_from_first.inverse() * found[second].1, weight))
        } else {
            None
        }
    })
}

/// Orientations along that one of many spanning trees, drawn with heavy pairs preferred, with which most
/// pairs agree.
fn best_spanning_tree(count: usize, pairs: &[RelativeRotation]) -> Vec<(usize, Rotation<f64>)> {
    let mut random = Random::new(count as u64);
    let mut best = spanning_tree(count, pairs);
    let mut most = agreeing_weight(&best, pairs);
    for _ in 0..TREES {
        let drawn = |pair: &RelativeRotation| RelativeRotation {
            weight: pair.weight * random.uniform(),
            ..*pair
        };
        let tree = spanning_tree(count, &pairs.iter().map(drawn).collect::<Vec<_>>());
        let weight = agreeing_weight(&tree, pairs);
        if weight > most {
            (best, most) = (tree, weight);
        }
    }
    best
}

/// Weight of the pairs that agree with orientations.
fn agreeing_weight(found: &[(usize, Rotation<f64>)], pairs: &[RelativeRotation]) -> f64 {
    let agrees = |pair: &&RelativeRotation| {
        let between = found[pair.second].1 * found[pair.first].1.inverse();
        (between.inverse() * pair.second_from_first).log().norm() < MAX_TRIANGLE_ERROR
    };
    pairs.iter().filter(agrees).map(|pair| pair.weight).sum()
}

/// Orientations along the pairs with most matches.
fn spanning_tree(count: usize, pairs: &[RelativeRotation]) -> Vec<(usize, Rotation<f64>)> {
    let mut found: Vec<Option<(usize, Rotation<f64>)>> = vec![None; count];
    for part in 0..count {
        if found[part].is_some() {
            continue;
        }
        found[part] = Some((part, Rotation::identity()));
        let leads_on = |pair: &&RelativeRotation, found: &[Option<(usize, Rotation<f64>)>]| {
            found[pair.first].is_some() != found[pair.second].is_some()
        };
        while let Some(pair) = pairs
            .iter()
            .filter(|pair| leads_on(pair, &found))
            .max_by(|a, b| a.weight.total_cmp(&b.weight))
        {
            let RelativeRotation { first, second, second_from_first, .. } = *pair;
            match (found[first], found[second]) {
                (Some((part, r)), None) => found[second] = Some((part, second_from_first * r)),
                (None, Some((part, r))) => {
                    found[first] = Some((part, second_from_first.inverse() * r));
                }
                _ => break,
            }
        }
    }
    found.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::noise;

    /// Photographs in a ring of 20 degrees; a pair with a wrong rotation contradicts the way around.
    #[test]
    fn a_wrong_rotation_among_right_ones_stands_out() {
        let own = |i: usize| Rotation::exp(Vec3::new(0.0, 0.35 * i as f64, 0.0));
        let numbers = noise(4, 200);
        let mut pairs = Vec::new();
        for first in 0..12_usize {
            for gap in 1..3 {
                let (second, n) = (first + gap, &numbers[6 * first + 3 * (gap - 1)..]);
                let off = Rotation::exp(Vec3::new(n[0], n[1], n[2]) * 0.02);
                let second_from_first = off * own(second) * own(first).inverse();
                if second < 12 {
                    pairs.push(RelativeRotation { first, second, second_from_first, weight: 60.0 });
                }
            }
        }
        let wrong = Rotation::exp(Vec3::new(0.1, 0.3, 0.0));
        pairs.push(RelativeRotation {
            first: 1,
            second: 9,
            second_from_first: wrong,
            weight: 100.0,
        });
        let found = average_rotations(12, &pairs);
        let residual = |pair: &RelativeRotation| {
            let between = found[pair.second].1 * found[pair.first].1.inverse();
            (between.inverse() * pair.second_from_first).log().norm()
        };
        let (wrong, right) = pairs.split_last().expect("pairs");
        assert!(
            right.iter().all(|pair| residual(pair) < 0.2),
            "{:?}",
            right.iter().map(residual).collect::<Vec<_>>()
        );
        assert!(residual(wrong) > 1.0, "{}", residual(wrong));
        assert!(found.iter().all(|(part, _)| *part == 0));
    }
}

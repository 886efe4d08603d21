//! Repair of missing or non-increasing time stamps.

/// Increasing time stamps.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct RepairedTimestamps {
    /// One for every frame [s].
    pub(super) seconds: Vec<f64>,
    /// Frames whose own stamp was missing or not increasing, and is interpolated.
    pub(super) repaired: Vec<usize>,
}

/// Keeps the longest increasing subsequence and interpolates all other stamps. `None` if no more
/// than half of all are increasing.
pub(super) fn repaired(stamps: &[Option<f64>]) -> Option<RepairedTimestamps> {
    let good = longest_increasing(stamps);
    if 2 * good.len() <= stamps.len() || good.is_empty() {
        return None;
    }
    let known: Vec<(usize, f64)> = good.iter().filter_map(|i| Some((*i, stamps[*i]?))).collect();
    let seconds = (0..stamps.len()).map(|frame| interpolate(&known, frame)).collect();
    let repaired = (0..stamps.len()).filter(|frame| good.binary_search(frame).is_err()).collect();
    Some(RepairedTimestamps { seconds, repaired })
}

/// Indices of the longest increasing subsequence.
fn longest_increasing(stamps: &[Option<f64>]) -> Vec<usize> {
    // For every length, the end of the subsequence whose last stamp is the smallest.
    let mut ends: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = vec![None; stamps.len()];
    let value = |index: usize| stamps[index].unwrap_or(f64::INFINITY);
    for index in (0..stamps.len()).filter(|index| value(*index).is_finite()) {
        let length = ends.partition_point(|end| value(*end) < value(index));
        before[index] = length.checked_sub(1).map(|shorter| ends[shorter]);
        ends.truncate(ends.len().max(length));
        match ends.get_mut(length) {
            Some(end) => *end = index,
            None => ends.push(index),
        }
    }
    let mut indices: Vec<usize> =
        std::iter::successors(ends.last().copied(), |index| before[*index]).collect();
    indices.reverse();
    indices
}

/// Stamp of a frame, interpolated linearly or extrapolated from the nearest two known ones.
fn interpolate(known: &[(usize, f64)], frame: usize) -> f64 {
    let behind = known.partition_point(|(k, _)| *k <= frame);
    match known.get(behind.saturating_sub(1)) {
        Some((k, stamp)) if *k == frame => return *stamp,
        _ => {}
    }
    let second = behind.clamp(1, known.len().saturating_sub(1).max(1));
    match (known.get(second - 1), known.get(second)) {
        (Some((a, from)), Some((b, to))) => {
            from + (to - from) * (frame as f64 - *a as f64) / (*b as f64 - *a as f64)
        }
        (Some((_, only)), None) => *only,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(stamps: &[f64]) -> Option<(Vec<f64>, Vec<usize>)> {
        let stamps: Vec<Option<f64>> = stamps.iter().map(|s| s.is_finite().then_some(*s)).collect();
        repaired(&stamps).map(|stamps| (stamps.seconds, stamps.repaired))
    }

    #[test]
    fn good_stamps_stay_and_others_are_interpolated() {
        assert_eq!(of(&[0.0, 1.0, 2.5]), Some((vec![0.0, 1.0, 2.5], vec![])));
        // Missing, far ahead, behind, and the same twice.
        assert_eq!(of(&[0.0, f64::NAN, 4.0]), Some((vec![0.0, 2.0, 4.0], vec![1])));
        assert_eq!(of(&[0.0, 99.0, 4.0, 6.0]), Some((vec![0.0, 2.0, 4.0, 6.0], vec![1])));
        assert_eq!(of(&[3.0, 4.0, -1.0, 6.0]), Some((vec![3.0, 4.0, 5.0, 6.0], vec![2])));
        let (twice, bad) = of(&[0.0, 1.0, 1.0, 3.0]).expect("three of four");
        assert!(twice.windows(2).all(|pair| pair[0] < pair[1]) && bad.len() == 1, "{twice:?}");
    }

    #[test]
    fn stamps_at_the_ends_are_extrapolated() {
        let (seconds, bad) = of(&[f64::NAN, 1.0, 1.5, 2.0, f64::NAN]).expect("three of five");
        assert_eq!((seconds, bad), (vec![0.5, 1.0, 1.5, 2.0, 2.5], vec![0, 4]));
    }

    #[test]
    fn mostly_bad_stamps_are_refused() {
        assert_eq!(of(&[1.0, f64::NAN]), None);
        assert_eq!(of(&[4.0, 3.0, 2.0, 1.0]), None);
        assert_eq!(of(&[]), None);
        assert_eq!(of(&[7.0]), Some((vec![7.0], vec![])));
    }
}

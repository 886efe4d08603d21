//! Stamps of frames, where some have none or a wrong one.

/// Stamps that rise.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Stamps {
    /// One for every frame [s].
    pub(super) seconds: Vec<f64>,
    /// Frames whose own was missing or did not rise, so that it was put between those of others.
    pub(super) bad: Vec<usize>,
}

/// The stamps that rise, the longest such row of them; others are put evenly between these. `None`
/// where no more than half of all rise.
pub(super) fn mended(stamps: &[Option<f64>]) -> Option<Stamps> {
    let good = longest_rise(stamps);
    if 2 * good.len() <= stamps.len() || good.is_empty() {
        return None;
    }
    let known: Vec<(usize, f64)> = good.iter().filter_map(|i| Some((*i, stamps[*i]?))).collect();
    let seconds = (0..stamps.len()).map(|frame| at(&known, frame)).collect();
    let bad = (0..stamps.len()).filter(|frame| good.binary_search(frame).is_err()).collect();
    Some(Stamps { seconds, bad })
}

/// Places of the longest row of stamps that rise, in order.
fn longest_rise(stamps: &[Option<f64>]) -> Vec<usize> {
    // Of every length of row, the place where the one with the lowest end ends.
    let mut ends: Vec<usize> = Vec::new();
    let mut before: Vec<Option<usize>> = vec![None; stamps.len()];
    let value = |place: usize| stamps[place].unwrap_or(f64::INFINITY);
    for place in (0..stamps.len()).filter(|place| value(*place).is_finite()) {
        let length = ends.partition_point(|end| value(*end) < value(place));
        before[place] = length.checked_sub(1).map(|shorter| ends[shorter]);
        ends.truncate(ends.len().max(length));
        match ends.get_mut(length) {
            Some(end) => *end = place,
            None => ends.push(place),
        }
    }
    let mut row: Vec<usize> =
        std::iter::successors(ends.last().copied(), |place| before[*place]).collect();
    row.reverse();
    row
}

/// The stamp of a frame on the line through the known ones on both its sides, or the nearest two.
fn at(known: &[(usize, f64)], frame: usize) -> f64 {
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
        mended(&stamps).map(|stamps| (stamps.seconds, stamps.bad))
    }

    #[test]
    fn good_stamps_stay_and_bad_ones_go_between_them() {
        assert_eq!(of(&[0.0, 1.0, 2.5]), Some((vec![0.0, 1.0, 2.5], vec![])));
        // Missing, far ahead, behind, and the same twice.
        assert_eq!(of(&[0.0, f64::NAN, 4.0]), Some((vec![0.0, 2.0, 4.0], vec![1])));
        assert_eq!(of(&[0.0, 99.0, 4.0, 6.0]), Some((vec![0.0, 2.0, 4.0, 6.0], vec![1])));
        assert_eq!(of(&[3.0, 4.0, -1.0, 6.0]), Some((vec![3.0, 4.0, 5.0, 6.0], vec![2])));
        let (twice, bad) = of(&[0.0, 1.0, 1.0, 3.0]).expect("three of four");
        assert!(twice.windows(2).all(|pair| pair[0] < pair[1]) && bad.len() == 1, "{twice:?}");
    }

    #[test]
    fn at_the_ends_the_line_goes_on() {
        let (seconds, bad) = of(&[f64::NAN, 1.0, 1.5, 2.0, f64::NAN]).expect("three of five");
        assert_eq!((seconds, bad), (vec![0.5, 1.0, 1.5, 2.0, 2.5], vec![0, 4]));
    }

    #[test]
    fn stamps_of_which_most_are_bad_are_none() {
        assert_eq!(of(&[1.0, f64::NAN]), None);
        assert_eq!(of(&[4.0, 3.0, 2.0, 1.0]), None);
        assert_eq!(of(&[]), None);
        assert_eq!(of(&[7.0]), Some((vec![7.0], vec![])));
    }
}

//! Which picture is shown when: dropped, shuffled and frozen frames.

use super::{Degradation, refuse};
use crate::error::SyntheticError;
use crate::rng::stream;
use std::ops::Range;

/// Purpose number of the random streams of dropped and of shuffled frames.
const DROPPED: u64 = 41;
const SHUFFLED: u64 = 43;

/// One written frame, by indices into the source. All three are equal unless frames are frozen or
/// shuffled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Shown {
    /// The frame whose time stamps it has.
    pub(super) stamp: usize,
    /// The frame whose colour and depth it shows.
    pub(super) picture: usize,
    /// The frame whose true pose it has: where the camera was when a shuffled picture was taken, and
    /// where it is while a frozen one stays.
    pub(super) pose: usize,
}

/// The frames to be written of a source of `frames` frames.
pub(super) fn order(what: &Degradation, frames: usize) -> Result<Vec<Shown>, SyntheticError> {
    let kept = (0..frames).filter(|&frame| !drops(what, frame));
    let mut order: Vec<Shown> =
        kept.map(|frame| Shown { stamp: frame, picture: frame, pose: frame }).collect();
    if order.is_empty() {
        return refuse("dropped frames", "all", "a frame must be left");
    }
    for range in &what.shuffled {
        shuffle(&mut order, range, what.seed);
    }
    for i in 0..order.len() {
        if !what.frozen.iter().any(|range| range.contains(&order[i].stamp)) {
            continue;
        }
        let Some(before) = i.checked_sub(1) else {
            let expected = "a frame before the range, whose picture it repeats";
            return refuse("frozen frames", format!("from {} on", order[i].stamp), expected);
        };
        order[i].picture = order[before].picture;
    }
    Ok(order)
}

fn drops(what: &Degradation, frame: usize) -> bool {
    let chance = stream(what.seed, DROPPED, frame as u64).uniform();
    let by_chance = frame > 0 && chance < what.drop_share;
    by_chance || what.dropped.iter().any(|range| range.contains(&frame))
}

/// Puts the pictures of a range into a random order that is not the one they had.
fn shuffle(order: &mut [Shown], range: &Range<usize>, seed: u64) {
    let inside = |shown: &Shown| range.contains(&shown.stamp);
    let Some(first) = order.iter().position(inside) else { return };
    let count = order[first..].iter().take_while(|shown| inside(shown)).count();
    let chosen = &mut order[first..first + count];
    let before: Vec<usize> = chosen.iter().map(|shown| shown.picture).collect();
    let mut after = before.clone();
    let mut random = stream(seed, SHUFFLED, range.start as u64);
    while count > 1 && after == before {
        random.shuffle(&mut after);
    }
    for (shown, picture) in chosen.iter_mut().zip(after) {
        (shown.picture, shown.pose) = (picture, picture);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pictures(what: &Degradation) -> Vec<usize> {
        order(what, 9).expect("frames").iter().map(|shown| shown.picture).collect()
    }

    #[test]
    fn frozen_frames_show_the_last_picture_that_is_left() {
        let what = Degradation {
            dropped: Vec::from([3..4, 3..4]),
            frozen: Vec::from([4..6, 8..9]),
            ..Degradation::default()
        };
        assert_eq!(pictures(&what), [0, 1, 2, 2, 2, 6, 7, 7]);
        let shown = order(&what, 9).expect("frames");
        assert_eq!(shown[3], Shown { stamp: 4, picture: 2, pose: 4 });
        let first = Degradation { frozen: Vec::from([0..2, 0..2]), ..Degradation::default() };
        let error = order(&first, 9).expect_err("no picture before").to_string();
        assert!(error.contains("from 0 on") && error.contains("a frame before"), "{error}");
    }

    #[test]
    fn shuffled_frames_are_all_there_with_their_poses_and_in_another_order() {
        for seed in 0..20 {
            let shuffled = Vec::from([2..7, 2..2]);
            let what = Degradation { seed, shuffled, ..Degradation::default() };
            let found = pictures(&what);
            assert!(found != (0..9).collect::<Vec<_>>(), "seed {seed}");
            assert_eq!((&found[..2], &found[7..]), (&[0, 1][..], &[7, 8][..]));
            let mut sorted = found;
            sorted.sort_unstable();
            assert_eq!(sorted, (0..9).collect::<Vec<_>>());
            let shown = order(&what, 9).expect("frames");
            assert!(shown.iter().enumerate().all(|(i, s)| s.stamp == i && s.pose == s.picture));
        }
        let pair = Degradation { shuffled: Vec::from([4..6, 4..4]), ..Degradation::default() };
        assert_eq!(pictures(&pair), [0, 1, 2, 3, 5, 4, 6, 7, 8]);
    }
}

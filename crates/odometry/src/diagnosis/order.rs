//! Shuffled frames: pictures whose order contradicts the motion between them.

use crate::diagnosis::motion::{Step, length};

/// Steps turn back if the angle between them has at most this cosine, ...
const REVERSAL_COSINE: f64 = -0.5;
/// ... and both are at least this long, as a ratio of the width: less is the tremor of a hand.
const MIN_REVERSAL: f64 = 0.008;
/// Frames between reversals of one range, at most.
const MAX_DISTANCE: usize = 4;
/// Reversals of a range, at least: two neighbours that changed places cause two.
const MIN_REVERSALS: usize = 2;
/// Reversals that are looked at together, which bounds the time.
const MAX_REVERSALS: usize = 24;
/// Length of the path through the range over that in the best order, at least: two neighbours that
/// changed places make it 5/3 as long.
const MIN_RATIO: f64 = 1.5;
/// Rounds of exchanges.
const MAX_ROUNDS: usize = 50;

/// First and last frames of ranges whose path is much shorter in another order. `frames` are those
/// with a pose, in order; `step` is the motion between two of them [px].
///
/// A camera turns back slowly against its frames; one whose pictures were shuffled jumps to and fro.
pub(crate) fn shuffled_ranges(
    frames: &[usize],
    width: usize,
    step: impl Fn(usize, usize) -> Step,
) -> Vec<[usize; 2]> {
    let steps: Vec<Step> = frames.windows(2).map(|pair| step(pair[0], pair[1])).collect();
    let shortest = MIN_REVERSAL * width as f64;
    let turns_back = |place: &usize| is_reversal(&steps[place - 1], &steps[*place], shortest);
    let reversals: Vec<usize> = (1..steps.len()).filter(turns_back).collect();
    let clusters = reversals.chunk_by(|a, b| b - a <= MAX_DISTANCE);
    let range = |cluster: &[usize]| {
        // Two frames before and behind the outermost reversals.
        let (first, last) = (cluster[0] - 1, cluster[cluster.len() - 1] + 1);
        let window = &frames[first.saturating_sub(1)..(last + 2).min(frames.len())];
        let distances: Vec<Vec<f64>> =
            window.iter().map(|a| window.iter().map(|b| length(&step(*a, *b))).collect()).collect();
        let best = shortest_order(&distances);
        let moved = || (0..best.len()).filter(|place| best[*place] != *place);
        // The ends of the window keep their places.
        let (first, last) = moved().next().zip(moved().next_back())?;
        let given: Vec<usize> = (first - 1..last + 2).collect();
        let gain =
            path_length(&distances, &given) / path_length(&distances, &best[first - 1..last + 2]);
        (gain >= MIN_RATIO).then_some([window[first], window[last]])
    };
    let parts = clusters.flat_map(|cluster| cluster.chunks(MAX_REVERSALS));
    let ranges = parts.filter(|part| part.len() >= MIN_REVERSALS).filter_map(range);
    let mut merged: Vec<[usize; 2]> = Vec::new();
    for [first, last] in ranges {
        match merged.last_mut() {
            Some(before) if first <= before[1] + 2 * MAX_DISTANCE => {
                before[1] = before[1].max(last)
            }
            _ => merged.push([first, last]),
        }
    }
    merged
}

/// Whether a long step turns back from the one before.
fn is_reversal(before: &Step, after: &Step, shortest: f64) -> bool {
    let product: f64 = before.iter().zip(after).map(|(a, b)| a * b).sum();
    let (a, b) = (length(before), length(after));
    a.min(b) > shortest && product < REVERSAL_COSINE * a * b
}

fn path_length(distances: &[Vec<f64>], order: &[usize]) -> f64 {
    order.windows(2).map(|pair| distances[pair[0]][pair[1]]).sum()
}

/// A short path through all places from the first to the last, by moves of single places and
/// reversals of parts until neither makes it shorter.
fn shortest_order(distances: &[Vec<f64>]) -> Vec<usize> {
    let count = distances.len();
    let mut best: Vec<usize> = (0..count).collect();
    let mut least = path_length(distances, &best);
    for _ in 0..MAX_ROUNDS {
        let before = least;
        for from in 1..count.saturating_sub(1) {
            for to in 1..count - 1 {
                let mut moved = best.clone();
                let place = moved.remove(from);
                moved.insert(to, place);
                let mut turned = best.clone();
                turned[from.min(to)..=from.max(to)].reverse();
                for order in [moved, turned] {
                    let length = path_length(distances, &order);
                    if length < least - 1e-9 {
                        (least, best) = (length, order);
                    }
                }
            }
        }
        if least >= before {
            break;
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(positions: &[[f64; 2]]) -> Vec<[usize; 2]> {
        let step = |a: usize, b: usize| {
            let move_by = |k: usize| positions[b][k] - positions[a][k];
            [0.0, 0.0, 0.0, move_by(0), move_by(1), 0.0]
        };
        shuffled_ranges(&(0..positions.len()).collect::<Vec<_>>(), 320, step)
    }

    /// Positions [px] on a curve, the frames of some places in another order.
    fn shown(order: &[(usize, usize)]) -> Vec<[f64; 2]> {
        let position = |i: usize| {
            let t = i as f64;
            [5.0 * t, 20.0 * (0.2 * t).sin()]
        };
        let source = |i: usize| order.iter().find(|(to, _)| *to == i).map_or(i, |(_, from)| *from);
        (0..30).map(|i| position(source(i))).collect()
    }

    #[test]
    fn a_shuffled_range_is_found() {
        let order = [(10, 13), (11, 10), (12, 14), (13, 11), (14, 12)];
        assert_eq!(found(&shown(&order)), [[10, 14]]);
        assert_eq!(found(&shown(&[(20, 21), (21, 20)])), [[20, 21]]);
        assert_eq!(found(&shown(&[])), [[0; 2]; 0]);
        // A whole sequence in the order of its numbers times 37, modulo 101.
        let all: Vec<[f64; 2]> = (0..101).map(|i| [f64::from(37 * i % 101), 0.0]).collect();
        let ranges = found(&all);
        assert!(ranges.len() == 1 && ranges[0][0] < 5 && ranges[0][1] > 95, "{ranges:?}");
    }

    #[test]
    fn a_shaken_camera_is_not_shuffled() {
        // To and fro over 60 px, nine frames a period; and a tremor of 1 px at the rate of frames.
        let shaken: Vec<[f64; 2]> =
            (0..40).map(|i| [30.0 * (0.7 * f64::from(i)).sin(), 0.3 * f64::from(i)]).collect();
        let trembling: Vec<[f64; 2]> =
            (0..40).map(|i| [f64::from(i % 2), 0.5 * f64::from(i)]).collect();
        assert_eq!(found(&shaken), [[0; 2]; 0]);
        assert_eq!(found(&trembling), [[0; 2]; 0]);
    }
}

//! Frozen frames: the same picture repeated while the camera goes on.

/// A repeated picture is frozen if the camera has moved by this factor of its next step meanwhile:
/// a camera that stands still starts no faster than it goes on.
const JUMP_RATIO: f64 = 1.5;
/// Shortest jump, as a ratio of the width.
const MIN_JUMP: f64 = 0.003;
/// Ratio of consecutive steps above which a stop is sudden, where the next picture is not known.
const SUDDEN_STOP_RATIO: f64 = 0.7;

/// First and last frames of runs of repeated pictures that are frozen. `length` is the motion
/// between two frames [px], `None` where one has no pose.
///
/// Exact repetitions alone prove nothing: a still camera without noise repeats its picture, too.
/// After a freeze the picture jumps by what the camera has moved meanwhile.
pub(crate) fn frozen_runs(
    is_repeat: &[bool],
    width: usize,
    length: impl Fn(usize, usize) -> Option<f64>,
) -> Vec<[usize; 2]> {
    let shortest = MIN_JUMP * width as f64;
    let is_frozen = |&[first, last]: &[usize; 2]| {
        let back = |n: usize| first.checked_sub(n);
        let jump = length(first - 1, last + 1);
        let before = back(2).and_then(|frame| length(frame, first - 1));
        match (jump, length(last + 1, last + 2).or(before)) {
            (Some(jump), Some(next)) => jump > JUMP_RATIO * next + shortest,
            _ => {
                let earlier = back(3).and_then(|frame| length(frame, frame + 1));
                before.zip(earlier).is_some_and(|(before, earlier)| {
                    before > shortest && before > SUDDEN_STOP_RATIO * earlier
                })
            }
        }
    };
    runs(is_repeat).into_iter().filter(is_frozen).collect()
}

/// First and last places of runs of true values.
pub(crate) fn runs(values: &[bool]) -> Vec<[usize; 2]> {
    let mut begin = 0;
    let placed = values.chunk_by(|a, b| a == b).map(|run| {
        begin += run.len();
        (run[0], [begin - run.len(), begin - 1])
    });
    placed.filter_map(|(is_true, run)| is_true.then_some(run)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frozen runs of a camera with these positions [px]; equal positions repeat the picture.
    fn frozen(positions: &[f64]) -> Vec<[usize; 2]> {
        let is_repeat: Vec<bool> =
            (0..positions.len()).map(|i| i > 0 && positions[i] == positions[i - 1]).collect();
        let length = |a: usize, b: usize| Some((positions.get(b)? - positions.get(a)?).abs());
        frozen_runs(&is_repeat, 320, length)
    }

    #[test]
    fn a_freeze_ends_with_a_jump() {
        let moving = |i: usize| 4.0 * i as f64;
        let shown = |i: usize| moving(if (5..8).contains(&i) { 4 } else { i });
        assert_eq!(frozen(&(0..12).map(shown).collect::<Vec<_>>()), [[5, 7]]);
        // One frame that is shown twice, and a freeze until the end.
        let shown = |i: usize| moving(if i == 5 { 4 } else { i.min(8) });
        assert_eq!(frozen(&(0..12).map(shown).collect::<Vec<_>>()), [[5, 5], [9, 11]]);
    }

    #[test]
    fn a_camera_that_rests_is_not_frozen() {
        // It stops and starts again, at once or slowly.
        let abrupt = [0.0, 4.0, 8.0, 8.0, 8.0, 8.0, 12.0, 16.0, 20.0];
        let smooth = [0.0, 3.0, 5.0, 6.0, 6.0, 6.0, 7.0, 9.0, 12.0, 12.9, 13.0, 13.0];
        assert_eq!(frozen(&abrupt), [[0; 2]; 0]);
        assert_eq!(frozen(&smooth), [[0; 2]; 0]);
        assert_eq!(frozen(&[1.0; 6]), [[0; 2]; 0]);
    }

    #[test]
    fn runs_have_first_and_last_places() {
        assert_eq!(runs(&[true, false, true, true]), [[0, 0], [2, 3]]);
        assert_eq!(runs(&[]), [[0; 2]; 0]);
    }
}

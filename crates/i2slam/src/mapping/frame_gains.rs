//! Exposure and white balance of frames from surface points that keyframes see, for a given response.
//!
//! Two keyframes differ in a channel by the gain `g = h(y₁) - h(y₂) - q (ln v(r₁) - ln v(r₂))` of their common
//! points ([`i2slam_formation::response_estimate`]). The gains `G` of all compared keyframes are the
//! minimum of
//!
//! ```text
//! Σ_pairs n_ij (G_i - G_j - g_ij)² + n° Σ_i (G_i - G°_i)²
//! ```
//!
//! with `n` the number of points, `n°` = 50, `G°` what is known so far, and the gauge frame fixed. Frames between
//! keyframes take over the change of their neighbours.

use i2slam_compute::{median, solve_positive_definite};
use i2slam_formation::response_estimate::ValuePair;
use i2slam_formation::{FrameTone, WhiteBalanceModel};
use std::collections::BTreeMap;

/// Weight that fixes the gauge frame.
const GAUGE_WEIGHT: f64 = 1e9;
/// Points that what is known of a frame counts as, and fewest points of a pair: fewer may all lie on one
/// edge or highlight.
const KNOWN_POINTS: f64 = 50.0;
const MIN_POINTS: usize = 50;

/// The common points of two frames in one channel.
pub(super) struct ChannelPairs<'a> {
    pub(super) frames: [usize; 2],
    pub(super) points: &'a [ValuePair],
}

/// Logarithmic gains of frames that have common points, in one channel. `known` gives what is known of a
/// frame so far, `log_linear` the logarithm of the linear value of a picture value; the vignetting is raised to
/// a power.
pub(super) fn solve_gains(
    pairs: &[ChannelPairs<'_>],
    (log_linear, vignetting_power): (impl Fn(f64) -> f64, f64),
    gauge_frame: usize,
    known: impl Fn(usize) -> f64,
) -> BTreeMap<usize, f64> {
    let difference = |pair: &ChannelPairs<'_>| {
        let of_point = |point: &ValuePair| {
            let [first, second] = point.values.map(&log_linear);
            first - second - vignetting_power * point.log_vignetting
        };
        Difference::median(pair.frames, pair.points.iter().map(of_point).collect())
    };
    let differences: Vec<Difference> = pairs.iter().filter_map(difference).collect();
    solve_differences(&differences, gauge_frame, known)
}

/// Difference of a value between two frames.
pub(super) struct Difference {
    frames: [usize; 2],
    value: f64,
    points: f64,
}

impl Difference {
    /// Median over the points that two frames have in common; `None` of too few.
    pub(super) fn median(frames: [usize; 2], mut of_points: Vec<f64>) -> Option<Self> {
        let points = of_points.len();
        let value = median(&mut of_points).filter(|_| points >= MIN_POINTS)?;
        Some(Self { frames, value, points: points as f64 })
    }
}

/// The value of every frame that differences tell of. `known` gives what is known of a frame so far.
pub(super) fn solve_differences(
    differences: &[Difference],
    gauge_frame: usize,
    known: impl Fn(usize) -> f64,
) -> BTreeMap<usize, f64> {
    let frames = differences.iter().flat_map(|difference| difference.frames);
    let mut places: BTreeMap<usize, usize> = frames.map(|frame| (frame, 0)).collect();
    places.values_mut().enumerate().for_each(|(place, value)| *value = place);
    let count = places.len();
    let (mut matrix, mut solution) = (vec![0.0; count * count], vec![0.0; count]);
    for (&frame, &place) in &places {
        let weight = if frame == gauge_frame { GAUGE_WEIGHT } else { KNOWN_POINTS };
        matrix[place * (count + 1)] += weight;
        solution[place] += weight * known(frame);
    }
    for &Difference { frames, value, points: weight } in differences {
        let [i, j] = frames.map(|frame| places[&frame]);
        for (a, b, sign) in [(i, i, 1.0), (j, j, 1.0), (i, j, -1.0), (j, i, -1.0)] {
            matrix[a * count + b] += sign * weight;
        }
        solution[i] += weight * value;
        solution[j] -= weight * value;
    }
    if !solve_positive_definite(&mut matrix, &mut solution) {
        return BTreeMap::new();
    }
    places.into_iter().map(|(frame, place)| (frame, solution[place])).collect()
}

/// Tones of all frames after those of some have changed to the gains of three channels: the others are
/// changed as their neighbours, in proportion to the distance between these.
pub(super) fn apply_gains(
    tones: &[FrameTone<f32>],
    gains: &[BTreeMap<usize, f64>; 3],
    model: WhiteBalanceModel,
) -> Vec<FrameTone<f32>> {
    let change = |frame: usize| -> Option<[f64; 3]> {
        let before = tones[frame].gains();
        let mut change = [0.0; 3];
        for (channel, change) in change.iter_mut().enumerate() {
            *change = gains[channel].get(&frame)? - f64::from(before[channel].ln());
        }
        Some(change)
    };
    let changes: BTreeMap<usize, [f64; 3]> =
        gains[0].keys().filter_map(|&frame| Some((frame, change(frame)?))).collect();
    let of_frame = |(frame, tone): (usize, &FrameTone<f32>)| {
        changed(tone, interpolate(&changes, frame).unwrap_or_default(), model)
    };
    tones.iter().enumerate().map(of_frame).collect()
}

fn interpolate(changes: &BTreeMap<usize, [f64; 3]>, frame: usize) -> Option<[f64; 3]> {
    let before = changes.range(..=frame).next_back();
    let after = changes.range(frame..).next();
    let ((first, a), (second, b)) = (before.or(after)?, after.or(before)?);
    let share =
        (frame.saturating_sub(*first)) as f64 / (second.saturating_sub(*first)).max(1) as f64;
    Some(std::array::from_fn(|c| a[c] + (b[c] - a[c]) * share))
}

fn changed(tone: &FrameTone<f32>, change: [f64; 3], model: WhiteBalanceModel) -> FrameTone<f32> {
    let [red, green, blue] = change;
    let [exposure, r, g, b] = tone.to_array();
    match model {
        WhiteBalanceModel::PerChannel => FrameTone {
            log_exposure: exposure + green as f32,
            log_white_balance: [r + (red - green) as f32, g, b + (blue - green) as f32],
        },
        WhiteBalanceModel::OneGain | WhiteBalanceModel::Fixed => {
            FrameTone { log_exposure: exposure + ((red + green + blue) / 3.0) as f32, ..*tone }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gains of four frames, the first being the gauge.
    const GAINS: [f64; 4] = [0.0, 0.7, -0.4, 1.1];

    /// Points of two frames by a response of squares, one in four of something else.
    fn points(frames: [usize; 2]) -> Vec<ValuePair> {
        let point = |i: i32| {
            let light = 0.02 + 0.00004 * f64::from(i) + if i % 4 == 0 { 0.05 } else { 0.0 };
            let shown = |frame: usize, light: f64| (light * GAINS[frame].exp()).sqrt();
            let first = shown(frames[0], 0.02 + 0.00004 * f64::from(i));
            ValuePair {
                values: [first, shown(frames[1], light)],
                deviations: [0.004; 2],
                log_vignetting: 0.0,
            }
        };
        (0..4000).map(point).collect()
    }

    #[test]
    fn gains_of_frames_are_found_but_for_those_without_points() {
        let frames = [[0, 1], [1, 2], [0, 2], [2, 3]];
        let points = frames.map(points);
        let mut pairs: Vec<ChannelPairs<'_>> = frames
            .iter()
            .zip(&points)
            .map(|(&frames, points)| ChannelPairs { frames, points })
            .collect();
        let log = |value: f64| 2.0 * value.ln();
        let found = solve_gains(&pairs, (log, 1.0), 0, |_| 0.5);
        for (frame, gain) in &found {
            // The gauge frame keeps what is known of it; of others this counts as fifty points of 4000.
            let due = GAINS[*frame] + 0.5;
            assert!((gain - due).abs() < 0.06, "{frame}: {gain} {due}");
        }
        pairs[3].points = &[];
        let found = solve_gains(&pairs, (log, 1.0), 0, |_| 0.0);
        assert!(!found.contains_key(&3) && (found[&1] - GAINS[1]).abs() < 0.06, "{found:?}");
        assert_eq!(solve_gains(&[], (log, 1.0), 0, |_| 0.0), BTreeMap::new());
    }

    #[test]
    fn frames_between_keyframes_change_as_these() {
        let tones = [FrameTone { log_exposure: 0.1, log_white_balance: [0.2, 0.0, -0.1] }; 6];
        let at = |change: [f64; 2]| BTreeMap::from([(1, 0.1 + change[0]), (4, 0.1 + change[1])]);
        let gains = [at([0.2 + 0.3, 0.2 + 0.6]), at([0.3, 0.6]), at([-0.1 + 0.4, -0.1 + 0.7])];
        let next = apply_gains(&tones, &gains, WhiteBalanceModel::PerChannel);
        let exposures: Vec<f32> = next.iter().map(|tone| tone.log_exposure).collect();
        for (exposure, due) in exposures.iter().zip([0.4, 0.4, 0.5, 0.6, 0.7, 0.7]) {
            assert!((exposure - due).abs() < 1e-6, "{exposures:?}");
        }
        for tone in &next {
            let [red, green, blue] = tone.log_white_balance;
            assert!(
                (red - 0.2).abs() < 1e-6 && green == 0.0 && (blue - 0.0).abs() < 1e-6,
                "{tone:?}"
            );
        }
        let one = apply_gains(&tones, &gains, WhiteBalanceModel::Fixed);
        assert!(one.iter().all(|tone| tone.log_white_balance == tones[0].log_white_balance));
        assert!((one[1].log_exposure - (0.1 + (0.3 + 0.3 + 0.4) / 3.0)).abs() < 1e-6, "{one:?}");
    }
}

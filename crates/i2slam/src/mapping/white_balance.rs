//! Whether white balance changes from frame to frame, from surface points that keyframes see.
//!
//! Of every compared keyframe the logarithms of red and blue over green are found twice, `a` and `b`, by
//! the points in the upper and the lower half of its pictures, both relative to their means. What the two
//! agree on is a change of white balance, half of what they differ by is the error of their mean:
//!
//! ```text
//! change² = mean(a b)        error² = mean((a - b)²) / 4
//! ```
//!
//! White balance counts as constant up to a change of twice the error: one for all frames then errs less
//! than one for each, which gloss and coloured shadows bend in both halves alike.

use super::context::MappingContext;
use super::frame_gains::{ChannelPairs, solve_gains};
use super::mapper::Mapper;
use super::response::{PairedValues, log_linear};
use super::surface_pairs::ComparedViews;
use i2slam_formation::{FrameTone, ResponseCurve, Vignetting, WhiteBalanceModel};
use std::collections::BTreeMap;

/// Change of white balance over its error up to which it counts as constant.
const MAX_CHANGE: f64 = 2.0;
/// Keyframes from which a constant white balance can be told.
const MIN_FRAMES: usize = 4;

/// Logarithms of red and blue over green, by frame.
type Balances = BTreeMap<usize, [f64; 2]>;

/// True if the compared keyframes have one white balance, as far as their pictures tell; `None` where they
/// do not.
pub(crate) fn is_white_balance_constant(
    context: &MappingContext<'_>,
    compared: &[ComparedViews],
    lens: Vignetting<f32>,
) -> Option<bool> {
    if context.config.formation.white_balance != WhiteBalanceModel::PerChannel {
        return None;
    }
    let points = PairedValues::new(compared, lens);
    let gauge = context.keyframes.first()?.frame;
    let curve = context.responses[0].curve();
    let [first, second] =
        [Half::Upper, Half::Lower].map(|half| balances(&points, &curve, gauge, half));
    let [change, error] = change_and_error(&first, &second)?;
    Some(change < MAX_CHANGE * error)
}

/// Gives all frames the white balance of the gauge frame, and the map the colours that it shows them with as
/// before. Returns whether it did: nothing changes where the map cannot follow.
pub(crate) fn equalize_white_balance(
    mapper: &mut dyn Mapper,
    context: &mut MappingContext<'_>,
) -> bool {
    let Some(gauge) = context.keyframes.first().map(|keyframe| keyframe.frame) else {
        return false;
    };
    let common = context.frames[gauge].tone.log_white_balance;
    let held = |tone: &FrameTone<f32>| FrameTone { log_white_balance: common, ..*tone };
    let colour = |frame: usize, colour: [f32; 3]| {
        let tone = &context.frames[frame].tone;
        std::array::from_fn(|c| colour[c] + tone.log_white_balance[c] - common[c])
    };
    if !mapper.change_radiance(context, &colour, 1.0) {
        return false;
    }
    context.frames.iter_mut().for_each(|frame| frame.tone = held(&frame.tone));
    true
}

/// Half of a picture.
#[derive(Clone, Copy)]
enum Half {
    Upper,
    Lower,
}

/// White balance of every frame, by the points of one half of the pictures.
fn balances(
    points: &PairedValues,
    curve: &ResponseCurve<f32>,
    gauge_frame: usize,
    half: Half,
) -> Balances {
    let gains: [BTreeMap<usize, f64>; 3] = std::array::from_fn(|channel| {
        let pairs = points.frames.iter().zip(&points.points[channel]);
        let pairs: Vec<ChannelPairs<'_>> = pairs
            .map(|(&frames, points)| {
                // In the order of rows of the first picture.
                let (upper, lower) = points.split_at(points.len() / 2);
                let points = match half {
                    Half::Upper => upper,
                    Half::Lower => lower,
                };
                ChannelPairs { frames, points }
            })
            .collect();
        solve_gains(&pairs, |value| log_linear(curve, channel, value), gauge_frame, |_| 0.0)
    });
    let [red, green, blue] = &gains;
    let of_frame = |(frame, green): (&usize, &f64)| {
        Some((*frame, [red.get(frame)? - green, blue.get(frame)? - green]))
    };
    green.iter().filter_map(of_frame).collect()
}

/// Standard deviations over frames of the change that two halves agree on, and of the error of their mean;
/// `None` of too few frames.
fn change_and_error(first: &Balances, second: &Balances) -> Option<[f64; 2]> {
    let common = |(frame, a): (&usize, &[f64; 2])| Some([*a, *second.get(frame)?]);
    let both: Vec<[[f64; 2]; 2]> = first.iter().filter_map(common).collect();
    let count = both.len() as f64;
    let mean = |half: usize, c: usize| both.iter().map(|v| v[half][c]).sum::<f64>() / count;
    let (mut change, mut error) = (0.0, 0.0);
    for c in 0..2 {
        let means = [mean(0, c), mean(1, c)];
        for halves in &both {
            let [a, b] = [0, 1].map(|half| halves[half][c] - means[half]);
            change += a * b;
            error += 0.25 * (a - b).powi(2);
        }
    }
    let deviation = |sum: f64| (sum.max(0.0) / (2.0 * (count - 1.0))).sqrt();
    (both.len() >= MIN_FRAMES).then(|| [deviation(change), deviation(error)])
}

#[cfg(test)]
mod tests {
    use super::super::surface_pairs::tests::{compared_views, curve};
    use super::*;

    /// Change and error of seven views whose logarithm of red is `amplitude` times the cosine of their number.
    fn found(amplitude: f32) -> [f64; 2] {
        let lens = Vignetting::default();
        let points = PairedValues::new(&compared_views(7, &lens, amplitude / 0.3), lens);
        let [first, second] =
            [Half::Upper, Half::Lower].map(|half| balances(&points, &curve(), 0, half));
        change_and_error(&first, &second).expect("seven frames")
    }

    #[test]
    fn a_change_of_white_balance_is_told_from_error() {
        let [change, error] = found(0.0);
        assert!(change < MAX_CHANGE * error && error < 0.005, "{change} {error}");
        for amplitude in [0.03, 0.1] {
            let [change, error] = found(amplitude);
            // The deviation of seven cosines is 0.80; red has all of it, blue nothing.
            let due = 0.80 * f64::from(amplitude) / 2.0_f64.sqrt();
            assert!(change > MAX_CHANGE * error, "{amplitude}: {change} {error}");
            assert!((change / due - 1.0).abs() < 0.2, "{amplitude}: {change} {due}");
        }
    }

    #[test]
    fn few_frames_tell_nothing() {
        let few: Balances = (0..3).map(|frame| (frame, [0.0; 2])).collect();
        assert_eq!(change_and_error(&few, &few), None);
    }
}

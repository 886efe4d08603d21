//! Change of white balance from frame to frame, by surface points that keyframes see.
//!
//! Two keyframes differ in ln (red/green) by
//!
//! ```text
//! r = h_red(y₁) - h_red(y₂) - h_green(y₁) + h_green(y₂)
//! ```
//!
//! at their common points, with `h` the logarithm of the linear value of a picture value `y`; exposure and
//! vignetting cancel. Those of all keyframes are found by least squares, as [gains](super::frame_gains) are,
//! twice: `a` from the first and `b` from the second half of the points of each pair, in the order of rows,
//! both relative to their means; ln (blue/green) likewise. What `a` and `b` agree on is a change of white
//! balance, half of what they differ by is the error of their mean:
//!
//! ```text
//! change² = mean(a b)        error² = mean((a - b)²) / 4
//! ```
//!
//! All channels have one found curve, and channels that span different ranges of light differ from it by a
//! power, nearly. One whose power is `1 + k` times that of green makes a constant white balance follow the
//! exposure, ln (channel/green) = `k` ln exposure. Where nothing but such a line changes, white balance is
//! constant, and the channels are raised to the powers that make it so.

use super::context::MappingContext;
use super::frame_gains::{Difference, solve_differences};
use super::response::COMPARED;
use super::surface_pairs::{ComparedViews, SamplePair};
use i2slam_formation::{ResponseCurve, WhiteBalanceModel};
use std::collections::BTreeMap;

/// Change of white balance over its error from which on it counts as one: gloss and coloured shadows bend
/// both halves alike.
const MIN_CHANGE: f64 = 1.5;
/// Largest `k`: twice that of the measured response of `synth`. Beyond, white balance changes as exposure
/// does, as on the way from a lamp to a window.
const MAX_POWER_DIFFERENCE: f64 = 0.05;
/// Change of powers that is not worth another response.
const MIN_POWER_CHANGE: f64 = 0.002;
/// Keyframes from which on a constant white balance can be told.
const MIN_FRAMES: usize = 6;
const RED: usize = 0;
const GREEN: usize = 1;
const BLUE: usize = 2;

/// Powers of the channels, and what is known of white balance with them.
#[derive(Debug, PartialEq)]
pub(super) struct ChannelBalance {
    /// To which the linear values of channels that are alike are to be raised.
    pub(super) powers: [f64; 3],
    /// `None` where pictures do not tell, or it is not sought.
    pub(super) is_constant: Option<bool>,
}

/// The powers of the channels by which white balance is constant, given the curve of channels that are
/// alike; those of before where pictures tell nothing new. `log_exposure` as in [`find_white_balance`].
pub(super) fn balance_channels(
    context: &MappingContext<'_>,
    (compared, alike): (&[ComparedViews], &ResponseCurve<f32>),
    log_exposure: &BTreeMap<usize, f64>,
    gauge_frame: usize,
) -> ChannelBalance {
    let is_free = context.config.formation.white_balance == WhiteBalanceModel::PerChannel;
    let find = || find_white_balance(compared, alike, log_exposure, gauge_frame);
    next_balance(context.channel_powers, is_free.then(find).flatten())
}

fn next_balance(known: [f64; 3], course: Option<WhiteBalanceCourse>) -> ChannelBalance {
    let powers = match course {
        Some(WhiteBalanceCourse::Constant { powers }) => powers,
        Some(WhiteBalanceCourse::Changing) => [1.0; 3],
        None => known,
    };
    let is_near =
        powers.iter().zip(known).all(|(next, known)| (next - known).abs() < MIN_POWER_CHANGE);
    ChannelBalance {
        powers: if is_near { known } else { powers },
        is_constant: course.map(|course| course != WhiteBalanceCourse::Changing),
    }
}

/// Course of the white balance from keyframe to keyframe.
#[derive(Clone, Copy, Debug, PartialEq)]
enum WhiteBalanceCourse {
    /// It is the same in all, once the linear values of the channels are raised to these powers.
    Constant {
        powers: [f64; 3],
    },
    Changing,
}

/// Course of the white balance over the compared keyframes; `None` where their pictures do not tell.
/// `log_exposure` has the logarithms of their exposures; none where these are too much alike.
fn find_white_balance(
    compared: &[ComparedViews],
    curve: &ResponseCurve<f32>,
    log_exposure: &BTreeMap<usize, f64>,
    gauge_frame: usize,
) -> Option<WhiteBalanceCourse> {
    let changes = [RED, BLUE].map(|channel| Changes::new(compared, curve, channel, gauge_frame));
    let frames = changes.iter().map(|changes| changes.0.len()).min()?;
    if frames < MIN_FRAMES {
        return None;
    }
    if is_constant(&changes) {
        return Some(WhiteBalanceCourse::Constant { powers: [1.0; 3] });
    }
    let slopes = changes.each_ref().map(|changes| changes.slope(log_exposure));
    let [Some(red), Some(blue)] = slopes else { return Some(WhiteBalanceCourse::Changing) };
    let without = [(0, red), (1, blue)].map(|(i, k)| changes[i].without(k, log_exposure));
    let is_small = red.abs().max(blue.abs()) <= MAX_POWER_DIFFERENCE;
    if !(is_small && is_constant(&without)) {
        return Some(WhiteBalanceCourse::Changing);
    }
    let powers = [red, 0.0, blue].map(|k| (1.0 + k).recip());
    // The power in common stays.
    let mean = powers.iter().sum::<f64>() / 3.0;
    Some(WhiteBalanceCourse::Constant { powers: powers.map(|power| power / mean) })
}

/// True if red and blue over green change by no more than their errors.
fn is_constant(changes: &[Changes; 2]) -> bool {
    let mean = |of: fn(&Changes) -> f64| 0.5 * changes.iter().map(of).sum::<f64>();
    mean(Changes::square) < MIN_CHANGE.powi(2) * mean(Changes::squared_error)
}

/// Logarithms of a channel over green in frames, around their means, by either half of the points.
struct Changes(BTreeMap<usize, [f64; 2]>);

impl Changes {
    fn new(
        compared: &[ComparedViews],
        curve: &ResponseCurve<f32>,
        channel: usize,
        gauge_frame: usize,
    ) -> Self {
        let of_half = |half: usize| -> BTreeMap<usize, f64> {
            let difference = |views: &ComparedViews| {
                let (first, second) = views.points.split_at(views.points.len() / 2);
                let points = if half == 0 { first } else { second };
                let of_points = points.iter().filter_map(|pair| contrast(pair, curve, channel));
                Difference::median(views.frames, of_points.collect())
            };
            let differences: Vec<Difference> = compared.iter().filter_map(difference).collect();
            solve_differences(&differences, gauge_frame, |_| 0.0)
        };
        let [first, second] = [0, 1].map(of_half);
        let both = first.iter().filter_map(|(frame, a)| Some((*frame, [*a, *second.get(frame)?])));
        let both: BTreeMap<usize, [f64; 2]> = both.collect();
        let mean = |half: usize| both.values().map(|v| v[half]).sum::<f64>() / both.len() as f64;
        let means = [mean(0), mean(1)];
        let centred =
            |(frame, v): (&usize, &[f64; 2])| (*frame, [v[0] - means[0], v[1] - means[1]]);
        Self(both.iter().map(centred).collect())
    }

    /// Square of the change that both halves agree on.
    fn square(&self) -> f64 {
        self.0.values().map(|[a, b]| a * b).sum::<f64>() / self.0.len() as f64
    }

    /// Square of the error of the halves' mean.
    fn squared_error(&self) -> f64 {
        self.0.values().map(|[a, b]| 0.25 * (a - b).powi(2)).sum::<f64>() / self.0.len() as f64
    }

    /// Changes for each change of the logarithm of exposure; `None` where exposures of frames are unknown
    /// or all the same.
    fn slope(&self, log_exposure: &BTreeMap<usize, f64>) -> Option<f64> {
        let exposure = self.centred_exposure(log_exposure)?;
        let square: f64 = exposure.values().map(|e| e * e).sum();
        let both = self.0.iter().map(|(frame, [a, b])| 0.5 * (a + b) * exposure[frame]);
        (square > 0.0).then(|| both.sum::<f64>() / square)
    }

    /// Those that do not follow the exposure with a slope.
    fn without(&self, slope: f64, log_exposure: &BTreeMap<usize, f64>) -> Self {
        let exposure = self.centred_exposure(log_exposure).unwrap_or_default();
        let followed = |frame: &usize| slope * exposure.get(frame).copied().unwrap_or(0.0);
        let rest = |(frame, v): (&usize, &[f64; 2])| (*frame, v.map(|v| v - followed(frame)));
        Self(self.0.iter().map(rest).collect())
    }

    /// Exposure of the frames about its mean; `None` if that of one is unknown.
    fn centred_exposure(
        &self,
        log_exposure: &BTreeMap<usize, f64>,
    ) -> Option<BTreeMap<usize, f64>> {
        let known = self.0.keys().map(|frame| Some((*frame, *log_exposure.get(frame)?)));
        let known = known.collect::<Option<BTreeMap<usize, f64>>>()?;
        let mean = known.values().sum::<f64>() / known.len() as f64;
        Some(known.into_iter().map(|(frame, exposure)| (frame, exposure - mean)).collect())
    }
}

/// Difference of ln (channel/green) between the two pictures of a point; `None` where one is badly exposed.
fn contrast(pair: &SamplePair, curve: &ResponseCurve<f32>, channel: usize) -> Option<f64> {
    let channels = [channel, GREEN];
    let is_exposed = |value: f32| (COMPARED[0]..=COMPARED[1]).contains(&value);
    let are_exposed = pair.iter().all(|s| channels.iter().all(|&c| is_exposed(s.values[c])));
    are_exposed.then(|| {
        let log =
            |picture: usize, c: usize| curve.log_linear(c, f64::from(pair[picture].values[c]));
        log(0, channel) - log(1, channel) - log(0, GREEN) + log(1, GREEN)
    })
}

#[cfg(test)]
mod tests {
    use super::super::surface_pairs::tests::{Gains, compared_views};
    use super::super::view::tests::curve;
    use super::*;
    use i2slam_formation::{CameraResponse, NodeSpacing, StartCurve, Vignetting};

    fn views(count: usize, stops: f32, red: f32) -> Vec<ComparedViews> {
        let lens = Vignetting { coefficients: [-0.3, 0.0, 0.0] };
        compared_views(count, &lens, Gains { stops, red })
    }

    /// Logarithms of the exposures of [`views`].
    fn log_exposure(stops: f32) -> BTreeMap<usize, f64> {
        let of_view = |at: usize| f64::from(stops) * 2.0_f64.ln() * (3.0 * at as f64).sin();
        (0..7).map(|at| (at, of_view(at))).collect()
    }

    fn course(compared: &[ComparedViews], stops: f32) -> Option<WhiteBalanceCourse> {
        find_white_balance(compared, &curve(), &log_exposure(stops), 0)
    }

    const CONSTANT: WhiteBalanceCourse = WhiteBalanceCourse::Constant { powers: [1.0; 3] };

    #[test]
    fn a_change_of_white_balance_is_told_from_exposure() {
        for stops in [0.0, 1.2] {
            assert_eq!(course(&views(7, stops, 0.0), stops), Some(CONSTANT));
            for red in [0.03, 0.1] {
                let compared = views(7, stops, red);
                assert_eq!(course(&compared, stops), Some(WhiteBalanceCourse::Changing));
                let found = Changes::new(&compared, &curve(), RED, 0).square().sqrt();
                // The deviation of seven cosines.
                let due = 0.74 * f64::from(red);
                assert!((found / due - 1.0).abs() < 0.15, "{stops} {red}: {found} {due}");
            }
        }
    }

    /// The true response, but for the powers of its channels.
    fn bent_by(powers: [f64; 3]) -> ResponseCurve<f32> {
        CameraResponse::new(3, StartCurve::Shoulder, NodeSpacing::Power(2.2))
            .raised_by_channel(&powers)
            .curve()
    }

    fn bent(red: f64, blue: f64) -> ResponseCurve<f32> {
        bent_by([red, 1.0, blue])
    }

    #[test]
    fn a_white_balance_that_follows_the_exposure_is_that_of_a_wrong_response() {
        let (compared, exposure) = (views(7, 1.2, 0.0), log_exposure(1.2));
        let find = |curve: &ResponseCurve<f32>, exposure| {
            find_white_balance(&compared, curve, exposure, 0)
        };
        let found = find(&bent(1.04, 0.97), &exposure);
        let Some(WhiteBalanceCourse::Constant { powers }) = found else { panic!("{found:?}") };
        let due = [1.0 / 1.04, 1.0, 1.0 / 0.97];
        for (power, due) in powers.iter().zip(due) {
            // The mean of the three is 1.
            assert!((power / powers[1] - due).abs() < 0.006, "{powers:?}");
        }
        assert!((powers.iter().sum::<f64>() / 3.0 - 1.0).abs() < 1e-9);
        // With these powers there is nothing left to change.
        let balanced = bent_by([1.04 * powers[0], powers[1], 0.97 * powers[2]]);
        let found = find(&balanced, &exposure);
        let Some(WhiteBalanceCourse::Constant { powers }) = found else { panic!("{found:?}") };
        assert!(powers.iter().all(|power| (power - 1.0).abs() < MIN_POWER_CHANGE), "{powers:?}");
        // Farther apart than channels are, of exposures that tell nothing, or of a change besides.
        let changing = Some(WhiteBalanceCourse::Changing);
        assert_eq!(find(&bent(1.1, 1.0), &exposure), changing);
        assert_eq!(find(&bent(1.04, 0.97), &BTreeMap::new()), changing);
        let drifting = views(7, 1.2, 0.03);
        assert_eq!(find_white_balance(&drifting, &bent(1.04, 0.97), &exposure, 0), changing);
    }

    #[test]
    fn powers_of_channels_do_not_outlast_what_they_were_found_by() {
        let [known, next] = [[0.98, 1.0, 1.02], [0.97, 1.0, 1.03]];
        let powers = |course| next_balance(known, course).powers;
        assert_eq!(powers(None), known);
        assert_eq!(powers(Some(WhiteBalanceCourse::Changing)), [1.0; 3]);
        assert_eq!(powers(Some(CONSTANT)), [1.0; 3]);
        let constant = |powers| Some(WhiteBalanceCourse::Constant { powers });
        assert_eq!(powers(constant(next)), next);
        assert_eq!(powers(constant(known.map(|power| power + 0.001))), known);
    }

    #[test]
    fn few_frames_tell_nothing() {
        assert_eq!(course(&views(5, 0.3, 0.1), 0.3), None);
        let mut apart = views(7, 0.3, 0.1);
        apart.iter_mut().for_each(|views| views.points.truncate(60));
        assert_eq!(course(&apart, 0.3), None);
        assert_eq!(course(&[], 0.3), None);
    }
}

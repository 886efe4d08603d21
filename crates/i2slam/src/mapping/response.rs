//! Response of the camera, from surface points that keyframes of different exposure show.
//!
//! Steps on its nodes adapt a response to pictures slowly, and hardly at all where few pixels are: close
//! to white. The comparison of pictures finds its shape at once ([`i2slam_formation::response_estimate`]);
//! radiance and exposures are then taken over from the former one, so that the map shows the pictures
//! as before.

use super::blur_pairs::BlurredView;
use super::context::MappingContext;
use super::frame_gains::{ChannelPairs, apply_gains, solve_gains};
use super::log_light::{FoundVignetting, log_range};
use super::mapper::Mapper;
use super::response_by_blur::{possible_responses, power_by_blur, shape_by_blur};
use super::response_change::ResponseChange;
use super::surface_pairs::{BlurredSample, ComparedViews, MAX_VALUE, PLACE_DEVIATION, SamplePair};
use super::white_balance::{ChannelBalance, balance_channels};
use crate::config::{Config, ResponseScope};
use crate::reconstruction::FrameEstimate;
use i2slam_formation::response_estimate::{
    ResponseEstimate, TIED, ValuePair, deviation_by_response, estimate,
};
use i2slam_formation::{
    CameraResponse, FrameTone, ResponseCurve, StartCurve, Vignetting, WhiteBalanceModel,
};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Picture values that are compared: darker ones are steps of 8 bits, brighter ones clipped.
pub(super) const COMPARED: [f32; 2] = [0.08, MAX_VALUE];
/// Darkest picture value that counts for the shape of the response, which weighs noise: black has no
/// logarithm.
const MIN_VALUE: f32 = 1.0 / 255.0;
/// Standard deviation of a pixel in a plain area.
const VALUE_DEVIATION: f64 = 0.003;
/// Ratio of the residuals' deviation by the former response to that by the found one from which it
/// replaces it. Pictures of one exposure tell neither from the other.
const MIN_IMPROVEMENT: f64 = 1.02;
/// Range of exposures [stops] from which their differences outweigh what gloss and blur do to the same
/// points.
const MIN_EXPOSURE_RANGE: f64 = 0.5;
/// Frames from which one whose gain is wrong may be left out at either end of that range.
const MANY_FRAMES: usize = 5;
/// Ratio of the stops that a response spans to those of the start curve, at most: the bound of the power by
/// blur, beyond which the geometry is wrong.
const MAX_RANGE_RATIO: f64 = 2.5;
/// Picture values between which the former response is trusted; beyond, linear values are shifted.
pub(super) const TRUSTED: [f32; 2] = [0.05, 0.97];

/// True if a configuration has one response for all frames that is to be found.
pub(crate) fn finds_response(config: &Config) -> bool {
    config.formation.tone
        && config.formation.response_scope == ResponseScope::Sequence
        && config.parameters.frames.response_prior > 0.0
}

/// Response and white balance, as far as a comparison of keyframes has found them.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FoundTone {
    /// A response was found. Its nodes are not to be stepped any more: steps go on to raise its power.
    pub(crate) has_response: bool,
    /// True if white balance is constant, false if it changes; `None` where nothing was decided.
    pub(crate) has_constant_white_balance: Option<bool>,
    /// Powers of the response's channels; `None` where they stay as they were.
    pub(crate) channel_powers: Option<[f64; 3]>,
}

/// Finds the response of all frames and whether their white balance is constant, and takes map and tones
/// over to both. Nothing changes where the pictures do not tell, or the map cannot follow.
pub(crate) fn find_tone(
    mapper: &mut dyn Mapper,
    context: &mut MappingContext<'_>,
    (compared, blurred): (&[ComparedViews], &[BlurredView]),
    lens: Vignetting<f32>,
) -> FoundTone {
    let former = context.responses[0].curve();
    let lens = FoundVignetting::new(lens, &former);
    let gauge = context.keyframes.first().map_or(0, |keyframe| keyframe.frame);
    let points = PairedValues::new(compared, lens);
    let NextResponse { response: next, is_found, balance } =
        NextResponse::new(context, (compared, &points), (blurred, lens), gauge);
    let ChannelBalance { powers, is_constant } = balance;
    let is_decided_anew = is_constant.is_some() && !context.has_found_white_balance;
    // Alignment holds white balance back: where it changes, points tell it each time.
    let is_changing = is_constant == Some(false);
    let has_same_model = white_balance_model(context, is_constant) == context.white_balance;
    if next.is_none() && !is_decided_anew && !is_changing && has_same_model {
        return FoundTone::default();
    }
    let curve = next.as_ref().map_or_else(|| former.clone(), CameraResponse::curve);
    let change = ResponseChange::new(former, curve.clone());
    let tones = tones_by_points(context, (&points, &curve), &change, (is_constant, gauge));
    if tones.iter().any(|tone| tone.to_array().iter().any(|value| !value.is_finite())) {
        return FoundTone::default();
    }
    let colour =
        |frame: usize, colour| change.colour(&context.frames[frame].tone, &tones[frame], colour);
    if !mapper.change_radiance(context, &colour, change.stretch) {
        return FoundTone::default();
    }
    context.frames.iter_mut().zip(tones).for_each(|(frame, tone)| frame.tone = tone);
    next.into_iter().for_each(|next| context.responses[0] = next);
    FoundTone {
        has_response: is_found,
        has_constant_white_balance: is_constant,
        channel_powers: Some(powers),
    }
}

/// White balance of frames where it was found to be constant or not; as before where nothing was decided.
fn white_balance_model(
    context: &MappingContext<'_>,
    is_constant: Option<bool>,
) -> WhiteBalanceModel {
    match is_constant {
        Some(true) => WhiteBalanceModel::Fixed,
        Some(false) => WhiteBalanceModel::PerChannel,
        None => context.white_balance,
    }
}

/// Exposure and white balance of all frames behind a response that takes the place of the former one.
fn tones_by_points(
    context: &MappingContext<'_>,
    (points, curve): (&PairedValues, &ResponseCurve<f32>),
    change: &ResponseChange,
    (has_constant_white_balance, gauge_frame): (Option<bool>, usize),
) -> Vec<FrameTone<f32>> {
    let stretched = |frame: &FrameEstimate| {
        let tone = change.tone(&frame.tone);
        // That of the gauge frame.
        let log_white_balance = [0.0; 3];
        let is_constant = has_constant_white_balance == Some(true);
        if is_constant { FrameTone { log_white_balance, ..tone } } else { tone }
    };
    let stretched: Vec<FrameTone<f32>> = context.frames.iter().map(stretched).collect();
    let gains = points.gains(curve, gauge_frame, &stretched);
    apply_gains(&stretched, &gains, white_balance_model(context, has_constant_white_balance))
}

/// The response that takes the place of the former one.
struct NextResponse {
    /// `None` where the former one stays.
    response: Option<CameraResponse<f32>>,
    /// True if its shape or its power was found this time.
    is_found: bool,
    balance: ChannelBalance,
}

impl NextResponse {
    fn new(
        context: &MappingContext<'_>,
        (compared, points): (&[ComparedViews], &PairedValues),
        (blurred, lens): (&[BlurredView], FoundVignetting),
        gauge_frame: usize,
    ) -> Self {
        let former = context.channel_powers;
        let alike = with_channel_powers(&context.responses[0], former.map(f64::recip));
        let found = next_response(context, &alike, (points, blurred), lens, gauge_frame);
        let is_found = found.is_some();
        let base = found.unwrap_or(alike);
        // Responses that are not found have no powers of their channels, and one curve has one power.
        let is_known = (is_found || context.has_found_response) && base.nodes.len() == 3;
        let curve = base.curve();
        let log_exposures =
            if is_known { points.log_exposures(&curve, gauge_frame) } else { BTreeMap::new() };
        let balance = balance_channels(context, (compared, &curve), &log_exposures, gauge_frame);
        let is_next = is_found || balance.powers != former;
        let response = is_next.then(|| with_channel_powers(&base, balance.powers));
        Self { response, is_found, balance }
    }
}

/// A response whose channels span different ranges.
fn with_channel_powers(response: &CameraResponse<f32>, powers: [f64; 3]) -> CameraResponse<f32> {
    if powers == [1.0; 3] { response.clone() } else { response.raised_by_channel(&powers) }
}

/// The response after one whose channels are alike: its shape by points that frames of different exposure
/// show, unless blur contradicts it, its power by blur; `None` where pictures tell neither.
fn next_response(
    context: &MappingContext<'_>,
    response: &CameraResponse<f32>,
    (points, blurred): (&PairedValues, &[BlurredView]),
    lens: FoundVignetting,
    gauge_frame: usize,
) -> Option<CameraResponse<f32>> {
    let found = points.estimate(response.start(), gauge_frame);
    let by_points = found.as_ref().and_then(|found| points.better_response(response, found));
    let given = by_points.clone().unwrap_or_else(|| response.clone());
    let others = possible_responses(response, found.as_ref());
    // Motions that tell no power, or one that is refused, do not decide on the shape either.
    let by_blur = shape_by_blur(blurred, given, others, lens).and_then(|shape| {
        let power = power_by_blur(blurred, &shape, lens)?;
        Some((shape, power))
    });
    let (shape, power) = match by_blur {
        Some((shape, power)) => (shape, Some(power)),
        None => (by_points?, None),
    };
    // A power that was found before stays where blur tells none this time.
    let kept = log_range(&response.curve(), TIED) / log_range(&shape.curve(), TIED);
    let power = power.or_else(|| context.has_found_response.then_some(kept));
    let next = shape.raised(power.unwrap_or(1.0));
    is_plausible(&next).then_some(next)
}

/// True if a response spans about as many stops as the start curve: points of wrong poses bend it without
/// bound.
fn is_plausible(response: &CameraResponse<f32>) -> bool {
    let start = CameraResponse::<f32>::new(1, response.start(), response.spacing()).curve();
    let spanned = TRUSTED.map(f64::from);
    let ratio = log_range(&response.curve(), spanned) / log_range(&start, spanned);
    (1.0 / MAX_RANGE_RATIO..MAX_RANGE_RATIO).contains(&ratio)
}

/// Range of the exposures of frames, but for the longest and the shortest where there are many.
fn range_in_stops(gains: &[BTreeMap<usize, f64>; 3]) -> f64 {
    let mut green: Vec<f64> = gains[1].values().copied().collect();
    green.sort_unstable_by(f64::total_cmp);
    let left_out = usize::from(green.len() > MANY_FRAMES);
    let [Some(most), Some(least)] = [green.iter().nth_back(left_out), green.get(left_out)] else {
        return 0.0;
    };
    (most - least) / 2.0_f64.ln()
}

/// Picture values of the points that pairs of frames see, by channel.
struct PairedValues {
    lens: FoundVignetting,
    frames: Vec<[usize; 2]>,
    /// Those that are not clipped.
    all: [Vec<Vec<ValuePair>>; 3],
    /// Those of [`COMPARED`].
    points: [Vec<Vec<ValuePair>>; 3],
}

impl PairedValues {
    fn new(compared: &[ComparedViews], lens: FoundVignetting) -> Self {
        let within = |values: [f32; 2]| {
            std::array::from_fn(|channel| {
                let pairs = |views: &ComparedViews| {
                    let pair = |points: &SamplePair| value_pair(points, (channel, values), lens);
                    views.points.iter().filter_map(pair).collect()
                };
                compared.par_iter().map(pairs).collect()
            })
        };
        let frames = compared.iter().map(|views| views.frames).collect();
        Self { lens, frames, all: within([MIN_VALUE, COMPARED[1]]), points: within(COMPARED) }
    }

    /// The response by the points; `None` of too few, or where exposures are too much alike to tell.
    fn estimate(&self, start: StartCurve, gauge_frame: usize) -> Option<ResponseEstimate> {
        // n (n - 1)/2 pairs of n views: each view is compared with n - 1 others, by half of its points.
        let pairs = self.frames.len() as f64;
        let repeats = (2.0 * pairs).sqrt() / 2.0;
        let found = estimate(&self.all.concat(), repeats, start)?;
        let curve = found.response.camera_response(3, start).curve();
        let gains = self.gains(&curve, gauge_frame, &[]);
        (range_in_stops(&gains) >= MIN_EXPOSURE_RANGE).then_some(found)
    }

    /// The response that was found if it explains the points better than the former one.
    fn better_response(
        &self,
        response: &CameraResponse<f32>,
        found: &ResponseEstimate,
    ) -> Option<CameraResponse<f32>> {
        let next = found.response.camera_response(response.nodes.len(), response.start());
        let former = response.curve();
        let before = self.deviation(&former, self.lens.power(&former))?;
        let after = self.deviation(&next.curve(), found.vignetting_power)?;
        (before > MIN_IMPROVEMENT * after).then_some(next)
    }

    /// Deviation of the points by a response and a power of the vignetting, the mean over the channels that
    /// have some.
    fn deviation(&self, curve: &ResponseCurve<f32>, vignetting_power: f64) -> Option<f64> {
        let of_channel =
            |c: usize| deviation_by_response(&self.points[c], (curve, c), vignetting_power);
        let all: Vec<f64> = (0..3).filter_map(of_channel).collect();
        (!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64)
    }

    /// Logarithms of the exposures of frames by a response; none where they are too much alike to tell it.
    fn log_exposures(
        &self,
        curve: &ResponseCurve<f32>,
        gauge_frame: usize,
    ) -> BTreeMap<usize, f64> {
        let gains = self.gains(curve, gauge_frame, &[]);
        let is_observable = range_in_stops(&gains) >= MIN_EXPOSURE_RANGE;
        let [_, green, _] = gains;
        if is_observable { green } else { BTreeMap::new() }
    }

    /// Gains of the frames by a response; `tones` are those known so far.
    fn gains(
        &self,
        curve: &ResponseCurve<f32>,
        gauge_frame: usize,
        tones: &[FrameTone<f32>],
    ) -> [BTreeMap<usize, f64>; 3] {
        let vignetting_power = self.lens.power(curve);
        std::array::from_fn(|channel| {
            let pairs = self.frames.iter().zip(&self.points[channel]);
            let pairs: Vec<ChannelPairs<'_>> =
                pairs.map(|(&frames, points)| ChannelPairs { frames, points }).collect();
            let log = |value| curve.log_linear(channel, value);
            let known = |frame: usize| {
                tones.get(frame).map_or(0.0, |tone| f64::from(tone.gains()[channel].ln()))
            };
            solve_gains(&pairs, (log, vignetting_power), gauge_frame, known)
        })
    }
}

/// A point in one channel; `None` where a picture value is not between two.
fn value_pair(
    points: &SamplePair,
    (channel, [low, high]): (usize, [f32; 2]),
    lens: FoundVignetting,
) -> Option<ValuePair> {
    let [first, second] = points.each_ref().map(|sample| sample.values[channel]);
    let is_exposed = [first, second].iter().all(|v| (low..=high).contains(v));
    let deviation = |sample: &BlurredSample| {
        let of_value = VALUE_DEVIATION / sample.blur.max(1.0).sqrt();
        of_value.hypot(PLACE_DEVIATION * f64::from(sample.slopes[channel]))
    };
    is_exposed.then(|| ValuePair {
        values: [first, second].map(f64::from),
        deviations: [deviation(&points[0]), deviation(&points[1])],
        log_vignetting: lens.log_at(points[0].squared_radius)
            - lens.log_at(points[1].squared_radius),
    })
}

#[cfg(test)]
mod tests {
    use super::super::surface_pairs::tests::{Gains, compared_views};
    use super::super::view::tests::curve;
    use super::*;
    use i2slam_formation::NodeSpacing;

    fn response(start: StartCurve) -> CameraResponse<f32> {
        CameraResponse::new(3, start, NodeSpacing::Power(2.5))
    }

    /// Range over picture values of the distance [stops] between two curves' linear values.
    fn apart(first: &ResponseCurve<f32>, second: &ResponseCurve<f32>) -> f32 {
        let distance = |v: i32| {
            let y = v as f32 / 100.0;
            (first.inverse(0, y) / second.inverse(0, y)).log2()
        };
        let all: Vec<f32> = (25..=75).map(distance).collect();
        let bound = |of: fn(f32, f32) -> f32| all.iter().copied().reduce(of).expect("values");
        bound(f32::max) - bound(f32::min)
    }

    #[test]
    fn pictures_of_different_exposure_tell_the_response() {
        let lens = Vignetting { coefficients: [-0.3, 0.0, 0.0] };
        let found = FoundVignetting::new(lens, &curve());
        let points =
            PairedValues::new(&compared_views(7, &lens, Gains { stops: 1.2, red: 0.36 }), found);
        let mut former = response(StartCurve::Shoulder);
        former.nodes = response(StartCurve::Srgb).nodes;
        let better = |former: &CameraResponse<f32>| {
            points.better_response(former, &points.estimate(former.start(), 0)?)
        };
        let found = better(&former).expect("better than sRGB").curve();
        let [before, after] = [former.curve(), found].map(|c| apart(&c, &curve()));
        assert!(after < 0.15 && before > 0.5, "{before} {after}");
        let known = response(StartCurve::Shoulder);
        assert!(better(&known).is_none(), "the true one was replaced");
    }

    #[test]
    fn a_response_that_spans_many_more_stops_is_not_taken_over() {
        let raised = |power| response(StartCurve::Shoulder).raised(power);
        assert!([0.7, 1.0, 1.6].iter().all(|power| is_plausible(&raised(*power))));
        assert!([0.2, 4.0].iter().all(|power| !is_plausible(&raised(*power))));
    }

    #[test]
    fn pictures_of_one_exposure_change_nothing() {
        let lens = Vignetting::default();
        let found = FoundVignetting::new(lens, &curve());
        let points =
            PairedValues::new(&compared_views(7, &lens, Gains { stops: 0.0, red: 0.0 }), found);
        assert!(points.estimate(StartCurve::Srgb, 0).is_none());
    }
}

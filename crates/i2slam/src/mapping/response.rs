//! Response of the camera, from surface points that keyframes of different exposure show.
//!
//! Steps on its nodes adapt a response to pictures slowly, and hardly at all where few pixels are: close
//! to white. The comparison of pictures finds its shape at once ([`i2slam_formation::response_estimate`]);
//! radiance and exposures are then taken over from the former one, so that the map shows the pictures
//! as before.

use super::blur_pairs::{BlurredView, MovedPixel};
use super::context::MappingContext;
use super::frame_gains::{ChannelPairs, apply_gains, solve_gains};
use super::mapper::Mapper;
use super::response_change::ResponseChange;
use super::surface_pairs::{BlurredSample, ComparedViews, MAX_VALUE, PLACE_DEVIATION, SamplePair};
use super::view::{MomentSamples, PictureSample};
use super::white_balance::{ChannelBalance, balance_channels};
use crate::config::{Config, ResponseScope};
use crate::reconstruction::FrameEstimate;
use i2slam_formation::blur_estimate::{
    BlurredPicture, BlurredPixel, MOMENTS, SHARP_PICTURES, estimate_power,
};
use i2slam_formation::response_estimate::{TIED, ValuePair, deviation_by_response, estimate};
use i2slam_formation::{CameraResponse, FrameTone, ResponseCurve, Vignetting, WhiteBalanceModel};
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
/// Picture values of blurred pixels and of what they saw.
const BLUR_COMPARED: [f32; 2] = [0.06, 0.97];
/// Standard deviation of the logarithm of the power that start curve and pictures of different exposure
/// leave: sRGB, a measured response and Reinhard's are 1.08, 1.16 and 0.86 of the start curve.
const PRIOR_DEVIATION: f64 = 0.15;
/// Error of the power by blur beyond its scatter, as that of interpolation. Powers of known responses are
/// within 0.6 % in two rendered rooms, 4 % below in a third, 5 and 8 % below in two path-traced ones.
const POWER_ERROR: f64 = 0.05;
/// Distance of the power by blur from what is known without, in standard deviations, at most.
const MAX_POWER_DEVIATIONS: f64 = 2.0;
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
    let gauge = context.keyframes.first().map_or(0, |keyframe| keyframe.frame);
    let points = PairedValues::new(compared, lens);
    let NextResponse { response: next, is_found, balance } =
        NextResponse::new(context, (compared, &points), (blurred, lens), gauge);
    let ChannelBalance { powers, is_constant } = balance;
    let curve = next.as_ref().map_or_else(|| former.clone(), CameraResponse::curve);
    let model = match is_constant {
        Some(true) => WhiteBalanceModel::Fixed,
        Some(false) => WhiteBalanceModel::PerChannel,
        None => context.white_balance,
    };
    let is_decided_anew = is_constant.is_some() && !context.has_found_white_balance;
    // Alignment holds white balance back: where it changes, points tell it each time.
    let is_changing = is_constant == Some(false);
    if next.is_none() && !is_decided_anew && !is_changing && model == context.white_balance {
        return FoundTone::default();
    }
    let change = ResponseChange::new(former, curve.clone());
    let stretched = |frame: &FrameEstimate| {
        let tone = change.tone(&frame.tone);
        // That of the gauge frame.
        let log_white_balance = [0.0; 3];
        if is_constant == Some(true) { FrameTone { log_white_balance, ..tone } } else { tone }
    };
    let stretched: Vec<FrameTone<f32>> = context.frames.iter().map(stretched).collect();
    let gains = points.gains(&curve, gauge, &stretched);
    let tones = apply_gains(&stretched, &gains, model);
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
        (blurred, lens): (&[BlurredView], Vignetting<f32>),
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
/// show, its power by blur; `None` where pictures tell neither.
fn next_response(
    context: &MappingContext<'_>,
    response: &CameraResponse<f32>,
    (points, blurred): (&PairedValues, &[BlurredView]),
    lens: Vignetting<f32>,
    gauge_frame: usize,
) -> Option<CameraResponse<f32>> {
    let shape = points.better_response(response, gauge_frame);
    let power = power_by_blur(blurred, shape.as_ref().unwrap_or(response), lens);
    if shape.is_none() && power.is_none() {
        return None;
    }
    // A power that was found before stays where blur tells none this time.
    let former = response.curve();
    let kept =
        |shape: &CameraResponse<f32>| log_range(&former, TIED) / log_range(&shape.curve(), TIED);
    let has_power = context.has_found_response;
    let power = power.or_else(|| shape.as_ref().filter(|_| has_power).map(kept));
    let next = shape.as_ref().unwrap_or(response).raised(power.unwrap_or(1.0));
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

/// The power to which linear values are to be raised: between that of the start curve and that by blur, by
/// what is known of both; `None` without blur.
fn power_by_blur(
    blurred: &[BlurredView],
    response: &CameraResponse<f32>,
    lens: Vignetting<f32>,
) -> Option<f64> {
    let curve = response.curve();
    let start = CameraResponse::<f32>::new(1, response.start(), response.spacing()).curve();
    let power = log_range(&curve, TIED) / log_range(&start, TIED);
    let found = estimate_power(&blurred_pixels(blurred, &curve, lens))?;
    let log_power = (power * found.power).ln();
    let variance = (found.deviation / found.power).powi(2) + POWER_ERROR.powi(2);
    let total = PRIOR_DEVIATION.powi(2) + variance;
    // Farther from the start curve's than both deviations allow: the motion is wrong.
    let is_plausible = log_power.abs() < MAX_POWER_DEVIATIONS * total.sqrt();
    is_plausible.then(|| (log_power * PRIOR_DEVIATION.powi(2) / total).exp() / power)
}

/// Distance of the logarithms of the linear values of two picture values, the mean over channels.
pub(super) fn log_range(curve: &ResponseCurve<f32>, [low, high]: [f64; 2]) -> f64 {
    let range = |channel| log_linear(curve, channel, high) - log_linear(curve, channel, low);
    (0..3).map(range).sum::<f64>() / 3.0
}

fn blurred_pixels(
    blurred: &[BlurredView],
    curve: &ResponseCurve<f32>,
    lens: Vignetting<f32>,
) -> Vec<BlurredPicture> {
    let pixel = |moved: &MovedPixel, channel: usize| {
        let logs = |of: &[MomentSamples; SHARP_PICTURES]| {
            let [first, second] = of.each_ref().map(|s| log_lights(curve, lens, s, channel));
            Some([first?, second?])
        };
        Some(BlurredPixel { blurred: logs(&moved.blurred)?, sharp: logs(&moved.sharp)? })
    };
    let picture = |view: &BlurredView| BlurredPicture {
        channels: std::array::from_fn(|channel| {
            view.pixels.iter().filter_map(|moved| pixel(moved, channel)).collect()
        }),
    };
    blurred.par_iter().map(picture).collect()
}

/// [`log_light`] at the moments of an exposure; `None` where one is badly exposed.
pub(super) fn log_lights(
    curve: &ResponseCurve<f32>,
    lens: Vignetting<f32>,
    samples: &[PictureSample; MOMENTS],
    channel: usize,
) -> Option<[f64; MOMENTS]> {
    let mut logs = [0.0; MOMENTS];
    for (log, sample) in logs.iter_mut().zip(samples) {
        *log = log_light(curve, lens, sample, channel)?;
    }
    Some(logs)
}

/// Logarithm of the light of a sample behind the lens; `None` where it is badly exposed.
fn log_light(
    curve: &ResponseCurve<f32>,
    lens: Vignetting<f32>,
    sample: &PictureSample,
    channel: usize,
) -> Option<f64> {
    let value = sample.values[channel];
    let is_exposed = (BLUR_COMPARED[0]..=BLUR_COMPARED[1]).contains(&value);
    let light = || {
        log_linear(curve, channel, f64::from(value)) - log_vignetting(lens, sample.squared_radius)
    };
    is_exposed.then(light)
}

pub(super) fn log_linear(curve: &ResponseCurve<f32>, channel: usize, value: f64) -> f64 {
    f64::from(curve.inverse(channel, value as f32).max(f32::MIN_POSITIVE)).ln()
}

fn log_vignetting(lens: Vignetting<f32>, squared_radius: f64) -> f64 {
    f64::from(lens.at(squared_radius as f32)).ln()
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
    frames: Vec<[usize; 2]>,
    /// Those that are not clipped.
    all: [Vec<Vec<ValuePair>>; 3],
    /// Those of [`COMPARED`].
    points: [Vec<Vec<ValuePair>>; 3],
}

impl PairedValues {
    fn new(compared: &[ComparedViews], lens: Vignetting<f32>) -> Self {
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
        Self { frames, all: within([MIN_VALUE, COMPARED[1]]), points: within(COMPARED) }
    }

    /// The response that explains the points better than the former one; `None` where none does, or
    /// exposures are too much alike to tell.
    fn better_response(
        &self,
        response: &CameraResponse<f32>,
        gauge_frame: usize,
    ) -> Option<CameraResponse<f32>> {
        let former = response.curve();
        // n (n - 1)/2 pairs of n views: each view is compared with n - 1 others, by half of its points.
        let pairs = self.frames.len() as f64;
        let repeats = (2.0 * pairs).sqrt() / 2.0;
        let found = estimate(&self.all.concat(), repeats, response.start())?;
        let next = found.response.camera_response(response.nodes.len(), response.start());
        let gains = self.gains(&next.curve(), gauge_frame, &[]);
        let is_observable = range_in_stops(&gains) >= MIN_EXPOSURE_RANGE;
        // Of the power that the vignetting has.
        let fitted = next.raised(found.vignetting_power.recip()).curve();
        let [before, after] = [&former, &fitted].map(|curve| self.deviation(curve));
        (is_observable && before? > MIN_IMPROVEMENT * after?).then_some(next)
    }

    /// Deviation of the points by a response, the mean over the channels that have some.
    fn deviation(&self, curve: &ResponseCurve<f32>) -> Option<f64> {
        let of_channel = |c: usize| deviation_by_response(&self.points[c], (curve, c));
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
        std::array::from_fn(|channel| {
            let pairs = self.frames.iter().zip(&self.points[channel]);
            let pairs: Vec<ChannelPairs<'_>> =
                pairs.map(|(&frames, points)| ChannelPairs { frames, points }).collect();
            let log = |value| log_linear(curve, channel, value);
            let known = |frame: usize| {
                tones.get(frame).map_or(0.0, |tone| f64::from(tone.gains()[channel].ln()))
            };
            solve_gains(&pairs, log, gauge_frame, known)
        })
    }
}

/// A point in one channel; `None` where a picture value is not between two.
fn value_pair(
    points: &SamplePair,
    (channel, [low, high]): (usize, [f32; 2]),
    lens: Vignetting<f32>,
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
        log_vignetting: log_vignetting(lens, points[0].squared_radius)
            - log_vignetting(lens, points[1].squared_radius),
    })
}

#[cfg(test)]
mod tests {
    use super::super::blur_pairs::moved_pixels;
    use super::super::surface_pairs::tests::{Gains, compared_views};
    use super::super::view::tests::{CAMERA, curve, exposed_view};
    use super::*;
    use i2slam_formation::{NodeSpacing, StartCurve};
    use i2slam_geometry::{Pose, Tangent};

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
        let points =
            PairedValues::new(&compared_views(7, &lens, Gains { stops: 1.2, red: 0.36 }), lens);
        let mut former = response(StartCurve::Shoulder);
        former.nodes = response(StartCurve::Srgb).nodes;
        let found = points.better_response(&former, 0).expect("better than sRGB").curve();
        let [before, after] = [former.curve(), found].map(|c| apart(&c, &curve()));
        assert!(after < 0.15 && before > 0.5, "{before} {after}");
        let known = response(StartCurve::Shoulder);
        assert!(points.better_response(&known, 0).is_none(), "the true one was replaced");
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
        let points =
            PairedValues::new(&compared_views(7, &lens, Gains { stops: 0.0, red: 0.0 }), lens);
        assert!(points.better_response(&response(StartCurve::Srgb), 0).is_none());
    }

    #[test]
    fn blur_tells_the_power_of_linear_values() {
        let lens = Vignetting { coefficients: [-0.3, 0.0, 0.0] };
        let view = |at: f64, rotation: [f64; 3], log_exposure: f32| {
            let pose = Pose::identity().retract(Tangent::from_array([at, 0.0, 0.0, 0.0, 0.0, 0.0]));
            let [x, y, z] = rotation;
            let velocity = Tangent::from_array([0.0, 0.0, 0.0, x, y, z]);
            let tone = FrameTone { log_exposure, ..FrameTone::default() };
            exposed_view(pose, velocity, &tone, &lens, 0)
        };
        let sharp = [0.0, -0.03].map(|at| view(at, [0.0; 3], 0.0));
        let motions = [[0.0, 0.2, 0.0], [0.25, 0.0, 0.0], [0.15, -0.15, 0.1], [-0.1, 0.2, 0.0]];
        let blurred = (0..4).map(|k| {
            let moved = view(0.05 * k as f64, motions[k], 0.3 * k as f32);
            BlurredView { pixels: moved_pixels(&moved, &sharp, &CAMERA, None) }
        });
        let blurred: Vec<BlurredView> = blurred.collect();
        let known = response(StartCurve::Shoulder);
        for wrong in [0.9, 1.0, 1.1] {
            let power = power_by_blur(&blurred, &known.raised(wrong), lens).expect("blur");
            assert!((power * wrong - 1.0).abs() < 0.08, "{wrong}: {power}");
        }
        assert_eq!(power_by_blur(&blurred[..3], &known, lens), None);
        assert_eq!(power_by_blur(&blurred, &known.raised(3.0), lens), None);
    }
}

//! Shape and power of the response from motion blur.
//!
//! Steps on nodes bend a response, and so do points of exposures that are little apart. A blurred picture is a
//! mean of the light that sharper ones of mostly another exposure show, which a bent response contradicts.
//! Blur alone tells the power of linear values ([`i2slam_formation::blur_estimate::estimate_power`]).

use super::blur_pairs::{BlurredView, MovedPixel};
use super::log_light::{FoundVignetting, LogLight, log_range};
use super::view::MomentSamples;
use i2slam_formation::blur_estimate::{
    BlurredPicture, BlurredPixel, MOMENTS, PowerEstimate, SHARP_PICTURES, estimate_power,
};
use i2slam_formation::response_estimate::{ResponseEstimate, TIED};
use i2slam_formation::{CameraResponse, ResponseCurve};
use rayon::prelude::*;

/// Standard deviation of the logarithm of the power that start curve and pictures of different exposure
/// leave: the ranges of sRGB, a measured response and Reinhard's are 0.92, 0.88 and 1.16 of the start curve's.
const PRIOR_DEVIATION: f64 = 0.15;
/// Error of the power by blur beyond its scatter, as that of interpolation. Powers of known responses are
/// within 0.6 % in two rendered rooms, 4 % below in a third, 5 and 8 % below in two path-traced ones.
const POWER_ERROR: f64 = 0.05;
/// Distance of the power by blur from what is known without, in standard deviations, at most.
const MAX_POWER_DEVIATIONS: f64 = 2.0;
/// Shares of the way from the start curve to the shape by points, of shapes that blur decides between.
const SHARES: [f64; 2] = [1.0, 0.5];
/// Pixels of each picture that decide between shapes, about: estimates of the power take most of the time.
const DECIDING_PIXELS: usize = 500;
/// Standard deviations by which the residuals of another response are smaller where it is taken.
const MIN_DEVIATIONS: f64 = 2.0;

/// Responses that blur decides between: the former one, the start curve, and those on the way from there to
/// the shape by points.
pub(super) fn possible_responses(
    former: &CameraResponse<f32>,
    by_points: Option<&ResponseEstimate>,
) -> Vec<CameraResponse<f32>> {
    let (curves, start) = (former.nodes.len(), former.start());
    let started = CameraResponse::new(curves, start, former.spacing());
    let interpolated = |found: &ResponseEstimate| {
        SHARES.map(|share| found.interpolated(share, start).camera_response(curves, start))
    };
    let all = [former.clone(), started].into_iter();
    all.chain(by_points.into_iter().flat_map(interpolated)).collect()
}

/// The response that explains blur best: a given one, unless another leaves less unexplained by more than
/// chance, or blur contradicts the given one at any power; `None` where blur contradicts all, or tells nothing.
pub(super) fn shape_by_blur(
    blurred: &[BlurredView],
    given: CameraResponse<f32>,
    others: Vec<CameraResponse<f32>>,
    lens: FoundVignetting,
) -> Option<CameraResponse<f32>> {
    let explain = |response: &CameraResponse<f32>| {
        estimate_power(&blurred_pictures(blurred, &response.curve(), (lens, DECIDING_PIXELS)))
    };
    let by_given = explain(&given);
    let is_better = |found: &PowerEstimate| {
        by_given.as_ref().is_none_or(|by_given| {
            let [log_ratio, deviation] = found.log_residual_ratio(by_given);
            log_ratio < -MIN_DEVIATIONS * deviation
        })
    };
    let others = others.into_iter().filter_map(|other| Some((explain(&other)?, other)));
    let best = others
        .filter(|(found, _)| is_better(found))
        .min_by(|(a, _), (b, _)| a.log_residual_ratio(b)[0].total_cmp(&0.0));
    best.map(|(_, response)| response).or_else(|| by_given.is_some().then_some(given))
}

/// The power to which linear values are to be raised: between that of the start curve and that by blur, by
/// what is known of both; `None` without blur.
pub(super) fn power_by_blur(
    blurred: &[BlurredView],
    response: &CameraResponse<f32>,
    lens: FoundVignetting,
) -> Option<f64> {
    let curve = response.curve();
    let start = CameraResponse::<f32>::new(1, response.start(), response.spacing()).curve();
    let power = log_range(&curve, TIED) / log_range(&start, TIED);
    let found = estimate_power(&blurred_pictures(blurred, &curve, (lens, usize::MAX)))?;
    let log_power = (power * found.power).ln();
    let variance = (found.deviation / found.power).powi(2) + POWER_ERROR.powi(2);
    let total = PRIOR_DEVIATION.powi(2) + variance;
    // Farther from the start curve's than both deviations allow: the motion is wrong.
    let is_plausible = log_power.abs() < MAX_POWER_DEVIATIONS * total.sqrt();
    is_plausible.then(|| (log_power * PRIOR_DEVIATION.powi(2) / total).exp() / power)
}

/// Logarithms of the light of about so many pixels of each picture, evenly taken.
fn blurred_pictures(
    blurred: &[BlurredView],
    curve: &ResponseCurve<f32>,
    (lens, pixels): (FoundVignetting, usize),
) -> Vec<BlurredPicture> {
    let light = LogLight::new(curve, lens);
    let pixel = |moved: &MovedPixel, channel: usize| {
        let logs = |of: &[MomentSamples; SHARP_PICTURES]| {
            let [first, second] = of.each_ref().map(|samples| light.at_moments(samples, channel));
            Some([first?, second?])
        };
        let value = f64::from(moved.blurred[0][MOMENTS / 2].values[channel]);
        let slope = curve.log_linear_slope(channel, value);
        Some(BlurredPixel { blurred: logs(&moved.blurred)?, sharp: logs(&moved.sharp)?, slope })
    };
    let picture = |view: &BlurredView| {
        let stride = (view.pixels.len() / pixels).max(1);
        let taken = |channel| {
            let taken = view.pixels.iter().step_by(stride);
            taken.filter_map(|moved| pixel(moved, channel)).collect()
        };
        BlurredPicture { channels: std::array::from_fn(taken) }
    };
    blurred.par_iter().map(picture).collect()
}

#[cfg(test)]
mod tests {
    use super::super::blur_pairs::moved_pixels;
    use super::super::view::tests::{CAMERA, exposed_view};
    use super::*;
    use i2slam_formation::{FrameTone, NodeSpacing, StartCurve, Vignetting};
    use i2slam_geometry::{Pose, Tangent};

    const LENS: Vignetting<f32> = Vignetting { coefficients: [-0.3, 0.0, 0.0] };

    /// A response, and the curve that it started as.
    fn response(curve: StartCurve, start: StartCurve) -> CameraResponse<f32> {
        let of = |start| CameraResponse::new(3, start, NodeSpacing::Power(2.5));
        let mut response = of(start);
        response.nodes = of(curve).nodes;
        response
    }

    /// That of the views.
    fn known() -> CameraResponse<f32> {
        response(StartCurve::Shoulder, StartCurve::Srgb)
    }

    fn lens() -> FoundVignetting {
        FoundVignetting::new(LENS, &known().curve())
    }

    /// Four blurred views beside two sharp ones.
    fn blurred_views() -> Vec<BlurredView> {
        let view = |at: f64, rotation: [f64; 3], log_exposure: f32| {
            let pose = Pose::identity().retract(Tangent::from_array([at, 0.0, 0.0, 0.0, 0.0, 0.0]));
            let [x, y, z] = rotation;
            let velocity = Tangent::from_array([0.0, 0.0, 0.0, x, y, z]);
            let tone = FrameTone { log_exposure, ..FrameTone::default() };
            exposed_view(pose, velocity, &tone, &LENS, 0)
        };
        let sharp = [0.0, -0.03].map(|at| view(at, [0.0; 3], 0.0));
        let motions = [[0.0, 0.2, 0.0], [0.25, 0.0, 0.0], [0.15, -0.15, 0.1], [-0.1, 0.2, 0.0]];
        let blurred = (0..4).map(|k| {
            let moved = view(0.05 * k as f64, motions[k], 0.3 * k as f32);
            BlurredView { pixels: moved_pixels(&moved, &sharp, &CAMERA, None) }
        });
        blurred.collect()
    }

    /// The start curve spans 0.92 of the range of the known response.
    #[test]
    fn blur_tells_the_power_of_linear_values() {
        let blurred = blurred_views();
        for wrong in [0.9, 1.0, 1.1] {
            let power = power_by_blur(&blurred, &known().raised(wrong), lens()).expect("blur");
            assert!((power * wrong - 1.0).abs() < 0.03, "{wrong}: {power}");
        }
        assert_eq!(power_by_blur(&blurred[..3], &known(), lens()), None);
    }

    #[test]
    fn a_power_far_from_that_of_the_start_curve_is_refused() {
        let response = response(StartCurve::Shoulder, StartCurve::Identity);
        assert_eq!(power_by_blur(&blurred_views(), &response, lens()), None);
    }

    #[test]
    fn blur_tells_which_response_is_true() {
        let blurred = blurred_views();
        let [started, bent] =
            [StartCurve::Srgb, StartCurve::Identity].map(|curve| response(curve, StartCurve::Srgb));
        for given in [known(), started.clone(), bent.clone()] {
            let others = vec![started.clone(), bent.clone(), known()];
            let found = shape_by_blur(&blurred, given.clone(), others, lens()).expect("blur");
            assert_eq!(found.nodes, known().nodes, "{given:?}");
        }
        assert!(shape_by_blur(&blurred[..3], bent, vec![known()], lens()).is_none());
    }

    /// A power changes no residual.
    #[test]
    fn a_response_that_explains_as_much_is_not_taken() {
        let found = shape_by_blur(&blurred_views(), known(), vec![known().raised(1.1)], lens());
        assert_eq!(found.expect("blur").nodes, known().nodes);
    }
}

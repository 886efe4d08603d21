//! Shape and power of the response from motion blur.
//!
//! Steps on nodes bend a response, and so do points of exposures that are little apart. Blurred pictures, which
//! are means of the light of sharp ones of mostly another exposure, contradict; they alone tell the power of
//! linear values ([`i2slam_formation::blur_estimate::estimate_power`]).

use super::blur_pairs::{BlurredView, MovedPixel};
use super::log_light::{RaisedVignetting, log_lights, log_range};
use super::view::MomentSamples;
use i2slam_formation::blur_estimate::{
    BlurredPicture, BlurredPixel, MOMENTS, SHARP_PICTURES, estimate_power,
};
use i2slam_formation::response_estimate::{ResponseEstimate, TIED};
use i2slam_formation::{CameraResponse, ResponseCurve, Vignetting};
use rayon::prelude::*;

/// Standard deviation of the logarithm of the power that start curve and pictures of different exposure
/// leave: the ranges of sRGB, a measured response and Reinhard's are 0.92, 0.88 and 1.16 of the start curve's.
const PRIOR_DEVIATION: f64 = 0.15;
/// Error of the power by blur beyond its scatter, as that of interpolation. Powers of known responses are
/// within 0.6 % in two rendered rooms, 4 % below in a third, 5 and 8 % below in two path-traced ones.
const POWER_ERROR: f64 = 0.05;
/// Distance of the power by blur from what is known without, in standard deviations, at most.
const MAX_POWER_DEVIATIONS: f64 = 2.0;
/// Parts of the way from the start curve to the shape by points that blur decides between.
const PARTS: [f64; 2] = [1.0, 0.5];
/// Of the blurred pixels, those that decide: one of so many.
const DECIDING_PIXELS: usize = 4;

/// The response that explains blur best: the former one, the start curve, or one on the way from there to the
/// shape by points; `None` where blur tells none of them.
pub(super) fn shape_by_blur(
    blurred: &[BlurredView],
    response: &CameraResponse<f32>,
    found: Option<&ResponseEstimate>,
    lens: Vignetting<f32>,
) -> Option<CameraResponse<f32>> {
    let former = response.curve();
    let (curves, start) = (response.nodes.len(), response.start());
    let parts = found.into_iter().flat_map(|found| PARTS.map(|share| found.part(share, start)));
    let parts = parts.map(|part| part.camera_response(curves, start));
    let started = CameraResponse::new(curves, start, response.spacing());
    let residual = |response: &CameraResponse<f32>| {
        let curve = response.curve();
        let lens = RaisedVignetting::new(lens, &former, &curve);
        let pictures = blurred_pixels((blurred, DECIDING_PIXELS), &curve, lens);
        Some(estimate_power(&pictures)?.residual)
    };
    // Of equal residuals the first is taken: the former response stays.
    let all = [response.clone(), started].into_iter().chain(parts);
    let all = all.filter_map(|response| Some((residual(&response)?, response)));
    all.min_by(|(a, _), (b, _)| a.total_cmp(b)).map(|(_, response)| response)
}

/// The power to which linear values are to be raised: between that of the start curve and that by blur, by
/// what is known of both; `None` without blur. The vignetting comes with the response that it was found with.
pub(super) fn power_by_blur(
    blurred: &[BlurredView],
    response: &CameraResponse<f32>,
    (lens, found_with): (Vignetting<f32>, &ResponseCurve<f32>),
) -> Option<f64> {
    let curve = response.curve();
    let lens = RaisedVignetting::new(lens, found_with, &curve);
    let start = CameraResponse::<f32>::new(1, response.start(), response.spacing()).curve();
    let power = log_range(&curve, TIED) / log_range(&start, TIED);
    let found = estimate_power(&blurred_pixels((blurred, 1), &curve, lens))?;
    let log_power = (power * found.power).ln();
    let variance = (found.deviation / found.power).powi(2) + POWER_ERROR.powi(2);
    let total = PRIOR_DEVIATION.powi(2) + variance;
    // Farther from the start curve's than both deviations allow: the motion is wrong.
    let is_plausible = log_power.abs() < MAX_POWER_DEVIATIONS * total.sqrt();
    is_plausible.then(|| (log_power * PRIOR_DEVIATION.powi(2) / total).exp() / power)
}

/// Logarithms of the light of one of every `stride` pixels.
fn blurred_pixels(
    (blurred, stride): (&[BlurredView], usize),
    curve: &ResponseCurve<f32>,
    lens: RaisedVignetting,
) -> Vec<BlurredPicture> {
    let pixel = |moved: &MovedPixel, channel: usize| {
        let logs = |of: &[MomentSamples; SHARP_PICTURES]| {
            let [first, second] = of.each_ref().map(|s| log_lights(curve, lens, s, channel));
            Some([first?, second?])
        };
        let value = moved.blurred[0][MOMENTS / 2].values[channel];
        let light = curve.inverse(channel, value);
        let slope = f64::from((light * curve.slope(channel, light)).max(f32::MIN_POSITIVE)).recip();
        Some(BlurredPixel { blurred: logs(&moved.blurred)?, sharp: logs(&moved.sharp)?, slope })
    };
    let picture = |view: &BlurredView| BlurredPicture {
        channels: std::array::from_fn(|channel| {
            let pixels = view.pixels.iter().step_by(stride);
            pixels.filter_map(|moved| pixel(moved, channel)).collect()
        }),
    };
    blurred.par_iter().map(picture).collect()
}

#[cfg(test)]
mod tests {
    use super::super::blur_pairs::moved_pixels;
    use super::super::view::tests::{CAMERA, exposed_view};
    use super::*;
    use i2slam_formation::{FrameTone, NodeSpacing, StartCurve};
    use i2slam_geometry::{Pose, Tangent};

    const LENS: Vignetting<f32> = Vignetting { coefficients: [-0.3, 0.0, 0.0] };

    fn response(start: StartCurve) -> CameraResponse<f32> {
        CameraResponse::new(3, start, NodeSpacing::Power(2.5))
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

    #[test]
    fn blur_tells_the_power_of_linear_values() {
        let blurred = blurred_views();
        let known = response(StartCurve::Shoulder);
        for wrong in [0.9, 1.0, 1.1] {
            let lens = (LENS, &known.curve());
            let power = power_by_blur(&blurred, &known.raised(wrong), lens).expect("blur");
            assert!((power * wrong - 1.0).abs() < 0.08, "{wrong}: {power}");
        }
        let lens = (LENS, &known.curve());
        assert_eq!(power_by_blur(&blurred[..3], &known, lens), None);
        assert_eq!(power_by_blur(&blurred, &known.raised(3.0), lens), None);
    }

    #[test]
    fn blur_refuses_a_bent_response() {
        let (blurred, known) = (blurred_views(), response(StartCurve::Shoulder));
        let mut bent = known.clone();
        bent.nodes = response(StartCurve::Srgb).nodes;
        let found = shape_by_blur(&blurred, &bent, None, LENS).expect("blur");
        assert_eq!(found.nodes, known.nodes);
        assert!(shape_by_blur(&blurred[..3], &bent, None, LENS).is_none());
    }
}

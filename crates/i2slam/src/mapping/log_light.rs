//! Logarithms of the light that picture values stand for.

use super::view::PictureSample;
use i2slam_formation::blur_estimate::MOMENTS;
use i2slam_formation::response_estimate::TIED;
use i2slam_formation::{ResponseCurve, Vignetting};

/// Picture values of blurred pixels and of what they saw.
const BLUR_COMPARED: [f32; 2] = [0.06, 0.97];

/// Distance of the logarithms of the linear values of two picture values, the mean over channels.
pub(super) fn log_range(curve: &ResponseCurve<f32>, [low, high]: [f64; 2]) -> f64 {
    let range = |channel| log_linear(curve, channel, high) - log_linear(curve, channel, low);
    (0..3).map(range).sum::<f64>() / 3.0
}

/// Vignetting, raised to a power: that which was found has the power of the response that it was found with.
#[derive(Clone, Copy)]
pub(super) struct RaisedVignetting {
    pub(super) found: Vignetting<f32>,
    pub(super) power: f64,
}

impl RaisedVignetting {
    /// That behind a response, found with another one.
    pub(super) fn new(
        found: Vignetting<f32>,
        found_with: &ResponseCurve<f32>,
        curve: &ResponseCurve<f32>,
    ) -> Self {
        Self { found, power: log_range(curve, TIED) / log_range(found_with, TIED) }
    }
}

/// [`log_light`] at the moments of an exposure; `None` where one is badly exposed.
pub(super) fn log_lights(
    curve: &ResponseCurve<f32>,
    lens: RaisedVignetting,
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
    lens: RaisedVignetting,
    sample: &PictureSample,
    channel: usize,
) -> Option<f64> {
    let value = sample.values[channel];
    let is_exposed = (BLUR_COMPARED[0]..=BLUR_COMPARED[1]).contains(&value);
    let light = || {
        let shading = lens.power * log_vignetting(lens.found, sample.squared_radius);
        log_linear(curve, channel, f64::from(value)) - shading
    };
    is_exposed.then(light)
}

pub(super) fn log_linear(curve: &ResponseCurve<f32>, channel: usize, value: f64) -> f64 {
    f64::from(curve.inverse(channel, value as f32).max(f32::MIN_POSITIVE)).ln()
}

pub(super) fn log_vignetting(lens: Vignetting<f32>, squared_radius: f64) -> f64 {
    f64::from(lens.at(squared_radius as f32)).ln()
}

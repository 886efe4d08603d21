//! Logarithms of the light that picture values stand for.

use super::view::PictureSample;
use i2slam_formation::blur_estimate::MOMENTS;
use i2slam_formation::response_estimate::TIED;
use i2slam_formation::{ResponseCurve, Vignetting};

/// Picture values of blurred pixels and of what they saw.
const BLUR_COMPARED: [f32; 2] = [0.06, 0.97];

/// Distance of the logarithms of the linear values of two picture values, the mean over channels.
pub(super) fn log_range(curve: &ResponseCurve<f32>, [low, high]: [f64; 2]) -> f64 {
    let range = |channel| curve.log_linear(channel, high) - curve.log_linear(channel, low);
    (0..3).map(range).sum::<f64>() / 3.0
}

/// Vignetting as it was found, which has the power of the response that it was found with.
#[derive(Clone, Copy)]
pub(super) struct FoundVignetting {
    lens: Vignetting<f32>,
    /// [`log_range`] of that response.
    log_range: f64,
}

impl FoundVignetting {
    pub(super) fn new(lens: Vignetting<f32>, found_with: &ResponseCurve<f32>) -> Self {
        Self { lens, log_range: log_range(found_with, TIED) }
    }

    /// Logarithm of the light at a squared radius over that at the centre.
    pub(super) fn log_at(&self, squared_radius: f64) -> f64 {
        f64::from(self.lens.at(squared_radius as f32)).ln()
    }

    /// Power to which it is to be raised behind another response.
    pub(super) fn power(&self, curve: &ResponseCurve<f32>) -> f64 {
        log_range(curve, TIED) / self.log_range
    }
}

/// Logarithms of the light that samples of pictures stand for.
pub(super) struct LogLight<'a> {
    curve: &'a ResponseCurve<f32>,
    lens: FoundVignetting,
    vignetting_power: f64,
}

impl<'a> LogLight<'a> {
    pub(super) fn new(curve: &'a ResponseCurve<f32>, lens: FoundVignetting) -> Self {
        Self { curve, lens, vignetting_power: lens.power(curve) }
    }

    /// Those at the moments of an exposure, in one channel; `None` where one is badly exposed.
    pub(super) fn at_moments(
        &self,
        samples: &[PictureSample; MOMENTS],
        channel: usize,
    ) -> Option<[f64; MOMENTS]> {
        let mut logs = [0.0; MOMENTS];
        for (log, sample) in logs.iter_mut().zip(samples) {
            let value = sample.values[channel];
            if !(BLUR_COMPARED[0]..=BLUR_COMPARED[1]).contains(&value) {
                return None;
            }
            let shading = self.vignetting_power * self.lens.log_at(sample.squared_radius);
            *log = self.curve.log_linear(channel, f64::from(value)) - shading;
        }
        Some(logs)
    }
}

//! From one response to another whose pictures are the same.

use super::log_light::log_range;
use super::response::TRUSTED;
use i2slam_formation::{FrameTone, ResponseCurve};

/// Picture values whose distance in stops tells by how much exposures are stretched.
const STRETCHED: [f64; 2] = [0.2, 0.8];

/// From linear values by one response to those by another that gives the same picture.
pub(super) struct ResponseChange {
    former: ResponseCurve<f32>,
    found: ResponseCurve<f32>,
    /// Stops by the found response over stops by the former one.
    pub(super) stretch: f32,
}

impl ResponseChange {
    pub(super) fn new(former: ResponseCurve<f32>, found: ResponseCurve<f32>) -> Self {
        let stretch = (log_range(&found, STRETCHED) / log_range(&former, STRETCHED)) as f32;
        Self { former, found, stretch }
    }

    /// Logarithm of a linear value. Where the former response is not trusted, that of the nearest value
    /// that is, with the same distance.
    fn log_linear(&self, channel: usize, log: f32) -> f32 {
        let [low, high] = TRUSTED.map(|y| self.former.inverse(channel, y).ln());
        let held = log.clamp(low, high);
        let value = self.former.evaluate(channel, held.exp());
        self.found.inverse(channel, value).max(f32::MIN_POSITIVE).ln() + (log - held)
    }

    /// Log radiance that a frame shows with its next tone as it showed `colour` with the former one.
    pub(super) fn colour(
        &self,
        former: &FrameTone<f32>,
        next: &FrameTone<f32>,
        colour: [f32; 3],
    ) -> [f32; 3] {
        let [former, next] = [former, next].map(|tone| tone.gains().map(f32::ln));
        std::array::from_fn(|channel| {
            self.log_linear(channel, colour[channel] + former[channel]) - next[channel]
        })
    }

    /// The tone whose stops are stretched.
    pub(super) fn tone(&self, tone: &FrameTone<f32>) -> FrameTone<f32> {
        FrameTone::from_array(tone.to_array().map(|value| self.stretch * value))
    }
}

#[cfg(test)]
mod tests {
    use super::super::view::tests::curve;
    use super::*;
    use i2slam_formation::{CameraResponse, NodeSpacing, StartCurve};

    fn srgb() -> ResponseCurve<f32> {
        CameraResponse::new(3, StartCurve::Srgb, NodeSpacing::Power(2.5)).curve()
    }

    #[test]
    fn pictures_stay_as_they_were() {
        let change = ResponseChange::new(srgb(), curve());
        let tone = FrameTone { log_exposure: 0.7, log_white_balance: [0.1, 0.0, -0.2] };
        for value in [0.07_f32, 0.2, 0.5, 0.8, 0.95] {
            let gains = tone.gains();
            let colour: [f32; 3] =
                std::array::from_fn(|c| (srgb().inverse(c, value) / gains[c]).ln());
            let next_tone = change.tone(&tone);
            let (next, gains) = (change.colour(&tone, &next_tone, colour), next_tone.gains());
            for channel in 0..3 {
                let shown = curve().evaluate(channel, next[channel].exp() * gains[channel]);
                assert!((shown - value).abs() < 2e-3, "{value}: {shown}");
            }
        }
    }
}

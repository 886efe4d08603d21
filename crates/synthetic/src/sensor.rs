//! From radiance to the bytes of a picture: gains, noise, response.

use crate::response::Response;
use crate::rng::{gaussian, stream};
use crate::spec::{NoiseSpec, WhiteBalanceSpec};
use i2slam_geometry::Image;

/// Model of a colour sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Exposure `Δt = 2^EV`.
    pub exposure: f64,
    /// Gains of red, green and blue.
    pub white_balance: [f64; 3],
    /// The camera response.
    pub response: Response,
}

impl Sensor {
    /// The picture value of a radiance in a channel, without noise.
    pub fn picture_value(&self, radiance: f32, channel: usize) -> f32 {
        let gain = (self.exposure * self.white_balance[channel]) as f32;
        self.response.apply(radiance * gain, channel)
    }

    /// The picture of a radiance image, in `[0, 1]`, without noise.
    pub fn picture(&self, radiance: &Image<f32>) -> Image<f32> {
        let mut out = radiance.clone();
        for channel in 0..3 {
            for value in out.plane_mut(channel) {
                *value = self.picture_value(*value, channel);
            }
        }
        out
    }

    /// The picture with noise of variance `read² + shot x` on exposed values `x`.
    pub fn noisy_picture(
        &self,
        radiance: &Image<f32>,
        noise: &NoiseSpec,
        seed: u64,
        frame: usize,
    ) -> Image<f32> {
        let mut out = radiance.clone();
        let mut random = stream(seed, 21, frame as u64);
        for channel in 0..3 {
            let gain = (self.exposure * self.white_balance[channel]) as f32;
            for value in out.plane_mut(channel) {
                let exposed = with_noise(*value * gain, noise, gaussian(&mut random));
                *value = self.response.apply(exposed, channel);
            }
        }
        out
    }
}

/// An exposed value with `normal`, a draw of the normal distribution, as its noise.
pub(crate) fn with_noise(exposed: f32, noise: &NoiseSpec, normal: f64) -> f32 {
    let variance = noise.read.powi(2) + noise.shot * f64::from(exposed.max(0.0));
    exposed + (variance.sqrt() * normal) as f32
}

/// Gains of red, green and blue at a time [s]: red rises by a sine while blue falls.
pub fn white_balance_at(spec: &WhiteBalanceSpec, time: f64) -> [f64; 3] {
    let swing = spec.drift * (std::f64::consts::TAU * time / spec.period).sin();
    [swing.exp2(), 1.0, (-swing).exp2()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_variance_it_is_told() {
        let noise = NoiseSpec { read: 0.01, shot: 0.002 };
        let mut random = stream(1, 1, 1);
        let draws = (0..40_000).map(|_| f64::from(with_noise(0.5, &noise, gaussian(&mut random))));
        let draws: Vec<f64> = draws.collect();
        let mean = draws.iter().sum::<f64>() / draws.len() as f64;
        let variance = draws.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / draws.len() as f64;
        assert!((mean - 0.5).abs() < 1e-3 && (variance / 0.0011 - 1.0).abs() < 0.04, "{variance}");
    }

    #[test]
    fn white_balance_drifts_around_one_and_leaves_green() {
        let spec = WhiteBalanceSpec { drift: 0.5, period: 4.0 };
        let [red, green, blue] = white_balance_at(&spec, 1.0);
        assert!((red - 2.0_f64.sqrt()).abs() < 1e-12 && green == 1.0);
        assert!((red * blue - 1.0).abs() < 1e-12);
        assert_eq!(white_balance_at(&spec, 0.0), [1.0; 3]);
    }
}

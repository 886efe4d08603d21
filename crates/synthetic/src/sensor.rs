//! The camera sensor: exposure control, white balance, noise and response.

use crate::rgb::encode;
use crate::rgb::luminance;
use crate::rng::{gaussian, stream};
use crate::spec::ExposureSpec;
use crate::spec::{NoiseSpec, WhiteBalanceSpec};
use i2slam_compute::median;
use i2slam_geometry::Image;

/// Exposure, white balance and response of a frame.
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

/// A camera response, from exposed values (0 is black, no upper limit) to `[0, 1]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Response {
    /// Reinhard's `(x / (1 + x))^(1/2.2)` (HDR-NeRF; the paper's appendix).
    #[default]
    Reinhard,
    /// The sRGB encoding (IEC 61966-2-1), clipped at 1.
    Srgb,
    /// As measured on consumer cameras: a toe, a soft shoulder and channels that differ a little.
    /// With `y = srgb(1 - exp(-1.25 x))` and a contrast `k` of the channel, `y + k (3y² - 2y³ -
    /// y)`.
    Measured,
}

/// Contrast of red, green and blue in [`Response::Measured`].
const CONTRAST: [f32; 3] = [0.30, 0.24, 0.18];

impl Response {
    /// Its name in a specification.
    pub fn name(self) -> &'static str {
        match self {
            Self::Reinhard => "reinhard",
            Self::Srgb => "srgb",
            Self::Measured => "measured",
        }
    }

    /// The picture value of an exposed value in a channel (0 red, 1 green, 2 blue).
    pub fn apply(self, exposed: f32, channel: usize) -> f32 {
        let x = exposed.max(0.0);
        match self {
            Self::Reinhard => (x / (1.0 + x)).powf(1.0 / 2.2),
            Self::Srgb => encode(x.min(1.0)),
            Self::Measured => {
                let y = encode(1.0 - (-1.25 * x).exp());
                y + CONTRAST[channel.min(2)] * (y * y * (3.0 - 2.0 * y) - y)
            }
        }
    }

    /// The exposed value of a picture value: the inverse of [`apply`](Self::apply) by bisection
    /// in stops. Values out of reach give the upper end of the search, 2^12.
    pub fn invert(self, value: f32, channel: usize) -> f32 {
        if value <= 0.0 {
            return 0.0;
        }
        let (mut low, mut high) = (-24.0_f32, 12.0_f32);
        for _ in 0..48 {
            let middle = 0.5 * (low + high);
            if self.apply(middle.exp2(), channel) < value { low = middle } else { high = middle }
        }
        (0.5 * (low + high)).exp2()
    }

    /// The formula, for documentation of a sequence.
    pub fn formula(self) -> &'static str {
        match self {
            Self::Reinhard => "LDR = round(255*(x/(x+1))**(1/2.2))",
            Self::Srgb => "LDR = round(255*srgb(min(x, 1)))",
            Self::Measured => {
                "LDR = round(255*(y + k*(3*y**2 - 2*y**3 - y))), y = srgb(1 - exp(-1.25*x)), \
                 k = 0.30 (red), 0.24 (green), 0.18 (blue)"
            }
        }
    }
}

/// `raw EV = log2(CRF⁻¹(½) / median Y)`: the picture of the median grey would be half of white.
/// A black picture gives `None`.
pub fn raw_exposure_value(radiance: &Image<f32>, response: Response) -> Option<f64> {
    let (red, green, blue) = (radiance.plane(0), radiance.plane(1), radiance.plane(2));
    let grey = (0..radiance.pixels()).map(|i| luminance([red[i], green[i], blue[i]]));
    let mut grey: Vec<f32> = grey.filter(|y| y.is_finite()).collect();
    let median = median(&mut grey)?;
    (median > 0.0).then(|| f64::from(response.invert(0.5, 1) / median).log2())
}

/// The causal low pass `EV_i = EV_{i-1} + (raw_i - EV_{i-1}) / smoothing`, `EV_0 = raw_0`.
#[derive(Clone, Debug, Default)]
pub struct AutoExposure {
    value: Option<f64>,
}

impl AutoExposure {
    /// The exposure value of the next frame.
    pub fn next(&mut self, raw: Option<f64>, spec: &ExposureSpec) -> f64 {
        let next = match (self.value, raw) {
            (None, raw) => raw.unwrap_or(0.0),
            (Some(value), Some(raw)) if spec.automatic => value + (raw - value) / spec.smoothing,
            (Some(value), _) => value,
        };
        self.value = Some(next);
        next
    }
}

/// The line `SV = a 2^EV + b` from exposure to the open share of the frame interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShutterRule {
    /// Slope.
    pub a: f64,
    /// Share at zero exposure.
    pub b: f64,
}

impl ShutterRule {
    /// The line on which the smallest and largest exposure of a sequence open the shutter for
    /// `shutter_minimum` and `shutter_maximum`; without a spread, always their middle.
    pub fn new(exposure_values: &[f64], spec: &ExposureSpec) -> Self {
        let (low, high) = (spec.shutter_minimum, spec.shutter_maximum);
        let gains = exposure_values.iter().map(|ev| ev.exp2());
        let (least, most) = gains.fold((f64::INFINITY, 0.0_f64), |(a, b), g| (a.min(g), b.max(g)));
        let spread = most - least;
        if spread.is_nan() || spread <= 1e-6 * most {
            return Self { a: 0.0, b: 0.5 * (low + high) };
        }
        let a = (high - low) / spread;
        Self { a, b: low - a * least }
    }

    /// The open share of the frame interval at an exposure value.
    pub fn share(&self, exposure_value: f64) -> f64 {
        self.a * exposure_value.exp2() + self.b
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_has_the_specified_variance() {
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

    const ALL: [Response; 3] = [Response::Reinhard, Response::Srgb, Response::Measured];

    #[test]
    fn responses_rise_from_black_to_white() {
        for response in ALL {
            for channel in 0..3 {
                assert_eq!(response.apply(0.0, channel), 0.0);
                assert!(response.apply(1e6, channel) > 0.999);
                let values = (0..400).map(|i| response.apply(0.01 * i as f32, channel));
                let values: Vec<f32> = values.collect();
                assert!(values.windows(2).all(|pair| pair[1] >= pair[0]));
            }
        }
    }

    #[test]
    fn inversion_returns_to_the_exposed_value() {
        for response in ALL {
            for exposed in [0.003, 0.1, 0.5, 0.95] {
                let back = response.invert(response.apply(exposed, 1), 1);
                assert!((back / exposed - 1.0).abs() < 1e-3, "{response:?} {exposed} {back}");
            }
        }
    }

    #[test]
    fn reinhard_is_the_formula_of_the_appendix() {
        let middle = 0.5_f32.powf(2.2) / (1.0 - 0.5_f32.powf(2.2));
        assert!((Response::Reinhard.apply(middle, 0) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn the_median_grey_becomes_half_of_white() {
        let mut image = Image::<f32>::new(5, 1, 3);
        for (i, v) in [0.1, 9.0, 0.4, 0.05, 2.0].into_iter().enumerate() {
            (0..3).for_each(|c| image.plane_mut(c)[i] = v);
        }
        for response in [Response::Reinhard, Response::Srgb, Response::Measured] {
            let ev = raw_exposure_value(&image, response).expect("light");
            let shown = response.apply(0.4 * ev.exp2() as f32, 1);
            assert!((shown - 0.5).abs() < 1e-4, "{response:?} {shown}");
        }
        assert!(raw_exposure_value(&Image::new(4, 4, 3), Response::Reinhard).is_none());
    }

    #[test]
    fn exposure_follows_by_a_third() {
        let (mut auto, spec) = (AutoExposure::default(), ExposureSpec::default());
        let raw = [1.0, 4.0, 4.0];
        let values = raw.map(|r| auto.next(Some(r), &spec));
        for (value, expected) in values.into_iter().zip([1.0, 2.0, 8.0 / 3.0]) {
            assert!((value - expected).abs() < 1e-12);
        }
        assert_eq!(auto.next(None, &spec), values[2], "a black frame keeps it");
        let fixed = ExposureSpec { automatic: false, ..spec };
        assert_eq!(auto.next(Some(9.0), &fixed), values[2]);
    }

    #[test]
    fn without_a_spread_of_exposures_the_shutter_takes_the_middle() {
        let spec = ExposureSpec::default();
        assert!((ShutterRule::new(&[0.5, 0.5], &spec).share(0.5) - 0.55).abs() < 1e-12);
    }
}

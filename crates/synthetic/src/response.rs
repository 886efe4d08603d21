//! Camera responses: exposed linear values to picture values.

use crate::rgb::encode;

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
    /// in stops. What the response cannot reach gives the end of the search, 2^12.
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

#[cfg(test)]
mod tests {
    use super::*;

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
}

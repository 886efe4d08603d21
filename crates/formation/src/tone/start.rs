//! The curve that a response starts from.

use serde::{Deserialize, Serialize};

/// The initial camera response.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum StartCurve {
    /// The sRGB encoding (IEC 61966-2-1), for photographs.
    #[default]
    Srgb,
    /// A straight line, for pictures that are linear already.
    Identity,
    /// sRGB with a soft shoulder, as cameras and tone-mapped video have.
    Shoulder,
}

/// `k` of Reinhard's curve `x (1 + k) / (1 + k x)` in [`StartCurve::Shoulder`]: the picture value ½
/// lies at x = 0.05 and 0.87 at x = 0.35, so that radiance far above a white wall is not clipped.
const SHOULDER: f64 = 4.0;

impl StartCurve {
    /// The picture value in [0, 1] of a linear value in [0, 1].
    pub fn evaluate(&self, x: f64) -> f64 {
        match self {
            Self::Srgb => encode_srgb(x),
            Self::Shoulder => encode_srgb(x * (1.0 + SHOULDER) / (1.0 + SHOULDER * x)),
            Self::Identity => x,
        }
    }
}

/// IEC 61966-2-1.
fn encode_srgb(x: f64) -> f64 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

//! The curve that a response starts from.

/// The camera response assumed before any picture has been explained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum StartCurve {
    /// The sRGB encoding curve (IEC 61966-2-1): photographs and most video.
    #[default]
    Srgb,
    /// Pictures that are linear already.
    Identity,
    /// `x^(1/2.2)`, as in HDR-NeRF's and the paper's synthetic data.
    Gamma22,
    /// The sRGB encoding of Reinhard's `s(x) = x (1 + k) / (1 + k x)`, `k = 4`: a soft shoulder.
    /// Display value ½ lies at x = 0.05 and 0.87 at x = 0.35, so that radiance far above a white
    /// wall still has a place in [0, 1] instead of the flat of the leaky clip.
    Shoulder,
}

/// Knee of [`StartCurve::Shoulder`].
const SHOULDER: f64 = 4.0;

impl StartCurve {
    /// The picture value in [0, 1] of a linear value in [0, 1].
    pub fn evaluate(&self, x: f64) -> f64 {
        match self {
            Self::Srgb => encode_srgb(x),
            Self::Shoulder => encode_srgb(x * (1.0 + SHOULDER) / (1.0 + SHOULDER * x)),
            Self::Identity => x,
            Self::Gamma22 => x.powf(1.0 / 2.2),
        }
    }
}

/// IEC 61966-2-1.
fn encode_srgb(x: f64) -> f64 {
    if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 }
}

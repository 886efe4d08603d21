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
}

impl StartCurve {
    /// The picture value in [0, 1] of a linear value in [0, 1].
    pub fn evaluate(&self, x: f64) -> f64 {
        match self {
            Self::Srgb if x <= 0.003_130_8 => 12.92 * x,
            Self::Srgb => 1.055 * x.powf(1.0 / 2.4) - 0.055,
            Self::Identity => x,
            Self::Gamma22 => x.powf(1.0 / 2.2),
        }
    }
}

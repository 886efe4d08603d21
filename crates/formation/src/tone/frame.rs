//! Exposure and white balance of one frame.

use i2slam_geometry::Real;
use serde::{Deserialize, Serialize};

/// The gains of one frame, as logarithms so that they stay positive.
///
/// Gauge: only the product of radiance, exposure and white balance is seen. A session fixes it
/// by leaving the exposure of frame 0 at 1 and by a [`WhiteBalanceModel`].
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct FrameTone<T> {
    /// ln Δt, the exposure relative to frame 0 (gain included).
    pub log_exposure: T,
    /// ln of the white-balance gains, R, G, B (eq. 10).
    pub log_white_balance: [T; 3],
}

/// Gradient with respect to the fields of [`FrameTone`].
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub struct FrameToneGradient<T> {
    /// With respect to ln Δt.
    pub log_exposure: T,
    /// With respect to the logarithms of the white-balance gains, R, G, B.
    pub log_white_balance: [T; 3],
}

impl<T: Real> FrameTone<T> {
    /// `exposure · white_balance_c` of R, G, B.
    pub fn gains(&self) -> [T; 3] {
        self.log_white_balance.map(|w| (self.log_exposure + w).exp())
    }

    /// Δt, the exposure relative to frame 0.
    pub fn exposure(&self) -> T {
        self.log_exposure.exp()
    }

    /// As `[log_exposure, log_white_balance R, G, B]`.
    pub fn to_array(self) -> [T; 4] {
        let [r, g, b] = self.log_white_balance;
        [self.log_exposure, r, g, b]
    }

    /// From `[log_exposure, log_white_balance R, G, B]`.
    pub fn from_array([log_exposure, r, g, b]: [T; 4]) -> Self {
        Self { log_exposure, log_white_balance: [r, g, b] }
    }
}

impl<T: Real> FrameToneGradient<T> {
    /// As `[log_exposure, log_white_balance R, G, B]`.
    pub fn to_array(self) -> [T; 4] {
        let [r, g, b] = self.log_white_balance;
        [self.log_exposure, r, g, b]
    }
}

/// Which of the three white-balance gains are free.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum WhiteBalanceModel {
    /// Red and blue gains; green is 1.
    #[default]
    PerChannel,
    /// One gain for all channels (the paper's monochromatic WB).
    OneGain,
    /// None: brightness is the exposure alone.
    Fixed,
}

impl WhiteBalanceModel {
    /// Projects a gradient with respect to `log_white_balance` onto the free gains; a shared gain
    /// gets the sum of the three.
    pub fn project_gradient<T: Real>(&self, d_log_white_balance: &mut [T; 3]) {
        match self {
            Self::PerChannel => d_log_white_balance[1] = T::zero(),
            Self::OneGain => {
                let [r, g, b] = *d_log_white_balance;
                *d_log_white_balance = [r + g + b; 3];
            }
            Self::Fixed => *d_log_white_balance = [T::zero(); 3],
        }
    }
}

//! The controller: a line through metered light, behind a low pass, within a range.

use super::metering::{Meter, Metering};

/// An exposure controller, as that of a camera: the exposure of frame i is
///
/// ```text
/// ln Δt_i = clamp(a + b y_i),   y_i = y_{i-1} + (1 - exp(-(t_i - t_{i-1})/τ)) (m_i - y_{i-1})
/// ```
///
/// with m the logarithm of metered light; a still view is exposed by `a + b m`. b = -1 makes every
/// view equally bright, b = 0 is a constant exposure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AutoExposure {
    /// Statistic of the light that is metered.
    pub meter: Meter,
    /// a, the logarithm of the exposure where the metered light is 1.
    pub offset: f64,
    /// b, change of the logarithm of exposure by that of metered light, -1 to 0.
    pub slope: f64,
    /// τ [s]; zero follows at once.
    pub time_constant: f64,
    /// Least and largest logarithm of an exposure.
    pub range: [f64; 2],
}

impl AutoExposure {
    /// Logarithm of the exposure of a view that has been looked at for long.
    pub fn settled(&self, metering: &Metering) -> f64 {
        self.exposed(metering.get(self.meter))
    }

    /// Exposures along a flight, which begins settled.
    pub const fn follow(self) -> ExposureFollower {
        let smoothed = LowPass::new(self.time_constant);
        ExposureFollower { controller: self, smoothed }
    }

    /// Logarithm of the exposure for smoothed light.
    pub(super) fn exposed(&self, log_luminance: f64) -> f64 {
        (self.offset + self.slope * log_luminance).clamp(self.range[0], self.range[1])
    }
}

/// A controller on its way along a flight.
#[derive(Clone, Debug)]
pub struct ExposureFollower {
    controller: AutoExposure,
    smoothed: LowPass,
}

impl ExposureFollower {
    /// Logarithm of the exposure of the view at a time [s], not before that of the last one. A view
    /// that shows nothing keeps the exposure before it; `None` as long as nothing was seen.
    pub fn next(&mut self, time: f64, metering: Option<&Metering>) -> Option<f64> {
        if let Some(metering) = metering {
            self.smoothed.next(time, metering.get(self.controller.meter));
        }
        self.smoothed.value().map(|light| self.controller.exposed(light))
    }
}

/// A causal one-pole low pass over uneven times, settled at its first value.
#[derive(Clone, Debug)]
pub(super) struct LowPass {
    time_constant: f64,
    last: Option<(f64, f64)>,
}

impl LowPass {
    /// A low pass with a time constant [s], zero for none.
    pub(super) const fn new(time_constant: f64) -> Self {
        Self { time_constant, last: None }
    }

    /// The smoothed value with one more at `time`.
    pub(super) fn next(&mut self, time: f64, value: f64) -> f64 {
        let smoothed = match self.last {
            Some((before, last)) if self.time_constant > 0.0 => {
                let elapsed = (time - before).max(0.0);
                last + (1.0 - (-elapsed / self.time_constant).exp()) * (value - last)
            }
            _ => value,
        };
        self.last = Some((time, smoothed));
        smoothed
    }

    fn value(&self) -> Option<f64> {
        self.last.map(|(_, value)| value)
    }
}

//! Rolling-shutter readout of a sequence: fixed, or estimated from the frames.

use crate::config::InputConfig;

/// Standard deviation of a single frame's measurement [frame intervals]: the speed during the
/// exposure is not that between the frames.
const FRAME_SIGMA: f64 = 0.3;
/// Smallest standard deviation of an estimated readout as a prior [frame intervals], so that the
/// estimate so far does not decide the next measurement.
const MIN_PRIOR_SIGMA: f64 = 0.5;

/// Frames after which a measurement is forgotten. A map made with a wrong readout biases the
/// measurements against it, so that the first ones must not count for ever.
const MEMORY_FRAMES: f64 = 10.0;

/// The readout of a sequence: fixed, or the weighted mean of the last frames' measurements.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SequenceReadout {
    /// First to last row [s].
    pub(crate) seconds: f64,
    /// Estimated rather than fixed.
    pub(crate) optimised: bool,
    /// The bottom row is read first.
    bottom_up: bool,
    /// Sum of `1 / variance` of the remembered measurements [1/s²].
    information: f64,
}

/// The readout as measured by one frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MeasuredReadout {
    /// First to last row [s].
    pub(crate) seconds: f64,
    /// Standard deviation, large where the frame moved little [s].
    pub(crate) deviation: f64,
}

impl SequenceReadout {
    pub(crate) fn new(input: &InputConfig) -> Self {
        Self {
            seconds: input.rolling_shutter_readout,
            optimised: input.optimise_rolling_shutter,
            bottom_up: input.rolling_shutter_readout < 0.0,
            information: 0.0,
        }
    }

    /// Whether rows are, or may be, exposed one after another.
    pub(crate) fn is_rolling(&self) -> bool {
        self.optimised || self.seconds != 0.0
    }

    /// Whether a frame has measured it.
    pub(crate) fn is_measured(&self) -> bool {
        self.information > 0.0
    }

    /// `readout`, or 0 where it is estimated and has the wrong sign: beyond 0, blur and rows would
    /// ask for opposite motions, and the optimisation would end between them, at rest.
    pub(crate) fn keep_direction(&self, readout: f64) -> f64 {
        match (self.optimised, self.bottom_up) {
            (false, _) => readout,
            (true, false) => readout.max(0.0),
            (true, true) => readout.min(0.0),
        }
    }

    /// Standard deviation of the readout as a prior, for frames `interval` apart [s].
    pub(crate) fn deviation(&self, interval: f64) -> f64 {
        if !self.optimised {
            return 0.0;
        }
        let sigma = (self.information + interval.powi(-2)).powf(-0.5);
        sigma.max(MIN_PRIOR_SIGMA * interval)
    }

    /// Adds the measurement of a frame, with frames `interval` apart [s].
    pub(crate) fn add(&mut self, measured: MeasuredReadout, interval: f64) {
        let variance = measured.deviation.powi(2) + (FRAME_SIGMA * interval).powi(2);
        let information = 1.0 / variance;
        let finite = measured.seconds.is_finite() && information.is_finite();
        if !self.optimised || !finite {
            return;
        }
        let max = MEMORY_FRAMES * (FRAME_SIGMA * interval).powi(-2);
        self.information = (self.information + information).min(max);
        self.seconds += (measured.seconds - self.seconds) * information / self.information;
        self.seconds = self.keep_direction(self.seconds).clamp(-interval, interval);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimated() -> SequenceReadout {
        SequenceReadout { seconds: 0.0, optimised: true, bottom_up: false, information: 0.0 }
    }

    #[test]
    fn measurements_count_by_their_variance() {
        let mut readout = estimated();
        let interval = 1.0 / 30.0;
        assert_eq!(readout.deviation(interval), interval);
        assert!(!readout.is_measured());
        for (seconds, deviation) in [(0.02, 0.001), (0.03, 10.0), (0.02, 0.001), (f64::NAN, 0.0)] {
            readout.add(MeasuredReadout { seconds, deviation }, interval);
        }
        assert!((readout.seconds - 0.02).abs() < 1e-5, "{}", readout.seconds);
        assert!(readout.is_measured());
        assert_eq!(readout.deviation(interval), MIN_PRIOR_SIGMA * interval);
    }

    #[test]
    fn first_measurements_are_forgotten() {
        let (mut readout, interval) = (estimated(), 1.0 / 30.0);
        let mut show = |seconds, frames| {
            for _ in 0..frames {
                readout.add(MeasuredReadout { seconds, deviation: 0.0 }, interval);
            }
            readout.seconds
        };
        assert!((show(0.005, 100) - 0.005).abs() < 1e-6);
        assert!((show(0.02, 40) - 0.02).abs() < 5e-4);
        assert_eq!(show(-0.02, 400), 0.0);
    }

    #[test]
    fn a_fixed_readout_stays() {
        let mut readout = SequenceReadout { optimised: false, seconds: 0.01, ..estimated() };
        readout.add(MeasuredReadout { seconds: 0.02, deviation: 0.0 }, 0.03);
        assert_eq!((readout.seconds, readout.deviation(0.03)), (0.01, 0.0));
        assert!(readout.is_rolling());
    }
}

//! What is known of the time in which a camera reads its rows.

use crate::config::InputConfig;

/// Spread of what single frames say, as a share of the frame interval: the speed over the exposure
/// is not that between the frames.
const FRAME_SPREAD: f64 = 0.3;
/// Share of the frame interval by which a readout that is looked for is always taken to be unsure:
/// what is expected must not decide what is found.
const MIN_SPREAD: f64 = 0.5;

/// Frames with plenty of motion that are remembered. A map made with a wrong readout shows every
/// frame a part of it, so that what the first frames said has to be forgotten.
const MEMORY: f64 = 10.0;

/// The readout of a sequence: fixed, or the weighted mean of what its last frames said.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SequenceReadout {
    /// First to last row [s].
    pub(crate) seconds: f64,
    /// Whether it is looked for.
    pub(crate) optimised: bool,
    /// Whether the bottom row comes first.
    upward: bool,
    /// Sum of `1 / variance` of the frames that are remembered [1/s²].
    information: f64,
}

/// The readout that one frame shows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MeasuredReadout {
    /// [s]
    pub(crate) seconds: f64,
    /// Standard deviation for want of motion [s].
    pub(crate) deviation: f64,
}

impl SequenceReadout {
    pub(crate) fn new(input: &InputConfig) -> Self {
        Self {
            seconds: input.rolling_shutter_readout,
            optimised: input.optimise_rolling_shutter,
            upward: input.rolling_shutter_readout < 0.0,
            information: 0.0,
        }
    }

    /// Whether rows are, or may be, read in turn.
    pub(crate) fn is_rolling(&self) -> bool {
        self.optimised || self.seconds != 0.0
    }

    /// A readout of the direction that a search keeps: where it changed sign, blur and rows would
    /// tell opposite motions, and a descent ends between them, at none.
    pub(crate) fn one_way(&self, readout: f64) -> f64 {
        match (self.optimised, self.upward) {
            (false, _) => readout,
            (true, false) => readout.max(0.0),
            (true, true) => readout.min(0.0),
        }
    }

    /// Standard deviation, for frames `interval` apart [s].
    pub(crate) fn deviation(&self, interval: f64) -> f64 {
        if !self.optimised {
            return 0.0;
        }
        let known = (self.information + interval.powi(-2)).powf(-0.5);
        known.max(MIN_SPREAD * interval)
    }

    /// Takes in what a frame showed, with frames `interval` apart [s].
    pub(crate) fn add(&mut self, measured: MeasuredReadout, interval: f64) {
        let variance = measured.deviation.powi(2) + (FRAME_SPREAD * interval).powi(2);
        let information = 1.0 / variance;
        let finite = measured.seconds.is_finite() && information.is_finite();
        if !self.optimised || !finite {
            return;
        }
        let most = MEMORY * (FRAME_SPREAD * interval).powi(-2);
        self.information = (self.information + information).min(most);
        self.seconds += (measured.seconds - self.seconds) * information / self.information;
        self.seconds = self.one_way(self.seconds).clamp(-interval, interval);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn looked_for() -> SequenceReadout {
        SequenceReadout { seconds: 0.0, optimised: true, upward: false, information: 0.0 }
    }

    #[test]
    fn frames_with_motion_decide() {
        let mut readout = looked_for();
        let interval = 1.0 / 30.0;
        assert_eq!(readout.deviation(interval), interval);
        for (seconds, deviation) in [(0.02, 0.001), (0.03, 10.0), (0.02, 0.001), (f64::NAN, 0.0)] {
            readout.add(MeasuredReadout { seconds, deviation }, interval);
        }
        assert!((readout.seconds - 0.02).abs() < 1e-5, "{}", readout.seconds);
        assert_eq!(readout.deviation(interval), MIN_SPREAD * interval);
    }

    #[test]
    fn what_the_first_frames_said_is_forgotten() {
        let (mut readout, interval) = (looked_for(), 1.0 / 30.0);
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
        let mut readout = SequenceReadout { optimised: false, seconds: 0.01, ..looked_for() };
        readout.add(MeasuredReadout { seconds: 0.02, deviation: 0.0 }, 0.03);
        assert_eq!((readout.seconds, readout.deviation(0.03)), (0.01, 0.0));
        assert!(readout.is_rolling());
    }
}

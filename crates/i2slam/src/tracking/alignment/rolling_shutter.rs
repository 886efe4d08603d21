//! The readout among the unknowns of a frame.
//!
//! Rows tell the motion during the readout, `r v` with the readout `r` in exposures and the motion
//! `v` over the exposure; blur tells `v` alone. Along the motion `Δ` since the last frame, a time
//! `T` ago, both are tied to the sequence's readout `R`:
//!
//! ```text
//! r v · d = (R/T) |Δ|,   d = Δ/|Δ|, everything in pixels
//! ```
//!
//! as far as the speed now is that since the last frame. Motions of several frames are compared per
//! usual frame interval: frames may be missing between them.

use super::residual::{Equations, READOUT};
use super::{Frame, PRIOR_WEIGHT, State};
use crate::reconstruction::FrameEstimate;
use crate::tracking::readout::MeasuredReadout;
use i2slam_formation::CentreVelocity;
use i2slam_geometry::Tangent;

/// First index of the velocity among the unknowns.
const VELOCITY: usize = 6;
/// Least uncertainty [px].
const FLOOR: f64 = 0.05;
/// Uncertainty as a share of the motion during the readout, and of the change of motion.
const SHARE: f64 = 0.1;
const BEND: f64 = 0.5;
/// Standard deviation of the readout in exposures, as a share of itself: brightness tells the
/// exposure time only roughly. Blur of less than a pixel tells nothing at all.
const HOLD: f64 = 0.5;
/// Open share of the frame interval under which a readout that is looked for is no less sure.
const MIN_SHARE: f64 = 0.2;
/// Least standard deviation of it [exposures].
const HOLD_FLOOR: f64 = 0.05;
/// Uncertainty of the measured motion during a frame interval [px].
const UNSURE: f64 = 1.0;
/// Frames whose motion the map is taken to show.
const PAST: usize = 9;
/// Motion unlike that of the frames before from which a frame says something about the readout
/// [px].
const MIN_MOTION: f64 = 2.0;

/// A Gaussian prior on readout and velocity together.
pub(super) struct ReadoutPrior {
    /// Pixels per unit of each tangent coordinate.
    pub(super) pixels: [f64; 6],
    /// Direction and length [px] of the motion since the last frame.
    pub(super) direction: [f64; 6],
    pub(super) length: f64,
    /// `R / T`.
    pub(super) share: f64,
    /// Standard deviation of the motion during the readout [px].
    pub(super) deviation: f64,
    /// Readout to stay near, and standard deviation from it [exposures].
    pub(super) hold: f64,
    pub(super) hold_deviation: f64,
    /// Weight against the residuals.
    pub(super) weight: f64,
}

impl ReadoutPrior {
    /// The part of the velocity along the motion [px].
    fn along(&self, velocity: Tangent<f64>) -> f64 {
        let values = velocity.to_array();
        (0..6).map(|i| values[i] * self.pixels[i] * self.direction[i]).sum()
    }

    fn precision(&self) -> f64 {
        self.weight / (self.deviation * self.deviation)
    }

    fn hold_precision(&self) -> f64 {
        PRIOR_WEIGHT / (self.hold_deviation * self.hold_deviation)
    }

    /// The cost, of which [`add_to`](Self::add_to) adds half the gradient.
    pub(super) fn cost(&self, velocity: Tangent<f64>, readout: f64) -> f64 {
        let error = readout * self.along(velocity) - self.share * self.length;
        self.precision() * error * error + self.hold_precision() * (readout - self.hold).powi(2)
    }

    /// Adds the prior's normal equations.
    pub(super) fn add_to(&self, velocity: Tangent<f64>, readout: f64, equations: &mut Equations) {
        let along = self.along(velocity);
        let error = readout * along - self.share * self.length;
        let by_velocity = |i: usize| readout * self.direction[i] * self.pixels[i];
        let precision = self.precision();
        for a in 0..6 {
            for b in a..6 {
                equations.hessian[VELOCITY + a][VELOCITY + b] +=
                    precision * by_velocity(a) * by_velocity(b);
            }
            equations.hessian[VELOCITY + a][READOUT] += precision * by_velocity(a) * along;
            equations.gradient[VELOCITY + a] += precision * by_velocity(a) * error;
        }
        let hold = self.hold_precision();
        equations.hessian[READOUT][READOUT] += precision * along * along + hold;
        equations.gradient[READOUT] += precision * along * error + hold * (readout - self.hold);
    }
}

impl Frame<'_> {
    /// The prior of a rolling shutter.
    pub(super) fn readout_prior(&self, state: &State) -> Option<ReadoutPrior> {
        let readout = self.context.readout;
        if !readout.is_rolling() {
            return None;
        }
        let step = self.step_in_pixels(state.motion.centre);
        let length = norm(&step);
        let interval = self.context.interval();
        let share = readout.seconds / interval;
        let spread = SHARE * share.abs() + readout.deviation(interval) / interval;
        let known = self.motion_is_known() && length > 0.0;
        let usual = 1.0 / self.context.frame_rate;
        let open_share = self.open_share(state).max(MIN_SHARE);
        let unsure = readout.deviation(usual) / (usual * open_share);
        Some(ReadoutPrior {
            pixels: self.pixels,
            direction: step.map(|v| if length > 0.0 { v / length } else { 0.0 }),
            length,
            share,
            deviation: FLOOR
                + spread * length
                + BEND * (readout.seconds / usual).abs() * self.bend(state),
            hold: self.readout_start,
            hold_deviation: HOLD_FLOOR + HOLD * self.readout_start.abs() + unsure,
            weight: if known { PRIOR_WEIGHT } else { 0.0 },
        })
    }

    /// What a frame says about the readout, if it moved unlike the frames before.
    ///
    /// With `Δ` and `Δ'` the motion of this frame and of those during the usual frame interval `T`,
    /// a map that was made with the readout `R'` shows `(R - R')/T Δ'` as if it were in the scene,
    /// so that with `e = Δ - Δ'`
    ///
    /// ```text
    /// r v = (R/T) Δ - ((R - R')/T) Δ'   or   (R/T) e = r v - (R'/T) Δ'
    /// ```
    pub(super) fn measured_readout(&self, state: &State) -> Option<MeasuredReadout> {
        let prior = self.readout_prior(state)?;
        let (step, past) = (self.usual_step(state), self.past_motion()?);
        let velocity = state.motion.velocity.to_array();
        let usual = 1.0 / self.context.frame_rate;
        let share = self.context.readout.seconds / usual;
        let apart: [f64; 6] = std::array::from_fn(|i| step[i] - past[i]);
        let rows: [f64; 6] =
            std::array::from_fn(|i| state.readout * velocity[i] * self.pixels[i] - share * past[i]);
        let dot: f64 = rows.iter().zip(&apart).map(|(r, a)| r * a).sum();
        let length = norm(&apart);
        let known = prior.weight > 0.0 && length > MIN_MOTION;
        known.then(|| MeasuredReadout {
            seconds: dot / (length * length) * usual,
            deviation: (UNSURE + BEND * self.bend(state)) / length * usual,
        })
    }

    /// The mean motion of the last frames that were tracked [px per usual frame interval].
    fn past_motion(&self) -> Option<[f64; 6]> {
        let frames = &self.context.frames[self.context.frames.len().saturating_sub(PAST)..];
        let (mut sum, mut count) = ([0.0; 6], 0.0);
        for pair in frames.windows(2).filter(|pair| pair[0].tracked && pair[1].tracked) {
            let step = self.step_between(&pair[0], &pair[1]);
            (0..6).for_each(|i| sum[i] += step[i]);
            count += 1.0;
        }
        (count > 0.0).then(|| sum.map(|v| v / count))
    }

    /// The motion since the last frame [px per usual frame interval].
    fn usual_step(&self, state: &State) -> [f64; 6] {
        let share = self.context.interval_share();
        self.step_in_pixels(state.motion.centre).map(|v| v * share)
    }

    /// The motion from frame to frame [px per usual frame interval].
    fn step_between(&self, from: &FrameEstimate, to: &FrameEstimate) -> [f64; 6] {
        let share = self.context.share_of(to.timestamp - from.timestamp);
        let step = CentreVelocity::along(from.middle(), to.middle(), share).velocity.to_array();
        std::array::from_fn(|i| step[i] * self.pixels[i])
    }

    fn step_in_pixels(&self, centre: i2slam_geometry::Pose<f64>) -> [f64; 6] {
        let step = CentreVelocity::along(self.previous, centre, 1.0).velocity.to_array();
        std::array::from_fn(|i| step[i] * self.pixels[i])
    }

    /// How much the motion differs from that of the frame before [px per usual frame interval]; all
    /// of it where that is unknown.
    fn bend(&self, state: &State) -> f64 {
        let step = self.usual_step(state);
        let (Some(last), Some(before)) = (self.context.previous, self.context.before_previous)
        else {
            return norm(&step);
        };
        let before = self.step_between(before, last);
        norm(&std::array::from_fn(|i| step[i] - before[i]))
    }
}

fn norm(values: &[f64; 6]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests;

//! Prior and measurement of the rolling-shutter readout.
//!
//! Rows show the motion during the readout, `r v` with the readout `r` in exposures and the motion
//! `v` over the exposure; blur shows `v` alone. Along the motion `Δ` since the last frame, a time
//! `T` ago, both are tied to the sequence's readout `R`:
//!
//! ```text
//! r v · d = (R/T) |Δ|,   d = Δ/|Δ|, everything in pixels
//! ```
//!
//! as far as the speed is constant. Motions of several frames are compared per nominal frame
//! interval, because frames may be missing between them.

use super::{FrameAlignment, PRIOR_WEIGHT, TrackingState};
use crate::reconstruction::FrameEstimate;
use crate::tracking::readout::MeasuredReadout;
use i2slam_formation::CentreVelocity;
use i2slam_geometry::{Pose, Tangent};
use i2slam_odometry::alignment::{Equations, READOUT, VELOCITY};

/// Standard deviation of the motion during the readout at rest [px].
const MIN_MOTION_SIGMA_PX: f64 = 0.05;
/// Its growth with that motion.
const MOTION_SIGMA_RATIO: f64 = 0.1;
/// Its growth with the change of motion from frame to frame.
const MOTION_CHANGE_SIGMA_RATIO: f64 = 0.5;
/// Standard deviation of the readout in exposures over the readout: brightness gives the exposure
/// time only roughly, and blur of less than a pixel not at all.
const READOUT_SIGMA_RATIO: f64 = 0.5;
/// Least standard deviation of the readout [exposures].
const MIN_READOUT_SIGMA: f64 = 0.05;
/// Smallest open share by which the standard deviation of an estimated readout is converted to
/// exposures.
const MIN_OPEN_SHARE: f64 = 0.2;
/// Standard deviation of the measured motion during a frame interval [px].
const MEASUREMENT_SIGMA_PX: f64 = 1.0;
/// Frames before this one whose mean motion the map reflects.
const PAST_FRAMES: usize = 9;
/// Least difference from the motion of the frames before at which a frame measures the readout [px
/// per frame interval].
const MIN_MOTION_CHANGE_PX: f64 = 2.0;

/// Gaussian prior on readout and velocity together.
pub(super) struct ReadoutPrior {
    pixels_per_unit: [f64; 6],
    /// Direction and length [px] of the motion since the last frame.
    direction: [f64; 6],
    length: f64,
    /// `R / T`.
    readout_ratio: f64,
    /// Standard deviation of the motion during the readout [px].
    motion_sigma: f64,
    /// Predicted readout and its standard deviation [exposures].
    predicted_readout: f64,
    readout_sigma: f64,
    /// Weight of the motion term against single residuals.
    weight: f64,
}

impl ReadoutPrior {
    /// Component of the velocity along the motion since the last frame [px].
    fn along(&self, velocity: Tangent<f64>) -> f64 {
        let values = velocity.to_array();
        (0..6).map(|i| values[i] * self.pixels_per_unit[i] * self.direction[i]).sum()
    }

    fn motion_precision(&self) -> f64 {
        self.weight / (self.motion_sigma * self.motion_sigma)
    }

    fn readout_precision(&self) -> f64 {
        PRIOR_WEIGHT / (self.readout_sigma * self.readout_sigma)
    }

    /// The cost, of which [`add_to`](Self::add_to) adds half the gradient.
    pub(super) fn cost(&self, velocity: Tangent<f64>, readout: f64) -> f64 {
        let error = readout * self.along(velocity) - self.readout_ratio * self.length;
        let motion = self.motion_precision() * error * error;
        motion + self.readout_precision() * (readout - self.predicted_readout).powi(2)
    }

    /// Adds the prior's normal equations.
    pub(super) fn add_to(&self, velocity: Tangent<f64>, readout: f64, equations: &mut Equations) {
        let along = self.along(velocity);
        let error = readout * along - self.readout_ratio * self.length;
        let by_velocity = |i: usize| readout * self.direction[i] * self.pixels_per_unit[i];
        let precision = self.motion_precision();
        for a in 0..6 {
            for b in a..6 {
                equations.hessian[VELOCITY + a][VELOCITY + b] +=
                    precision * by_velocity(a) * by_velocity(b);
            }
            equations.hessian[VELOCITY + a][READOUT] += precision * by_velocity(a) * along;
            equations.gradient[VELOCITY + a] += precision * by_velocity(a) * error;
        }
        let own = self.readout_precision();
        equations.hessian[READOUT][READOUT] += precision * along * along + own;
        equations.gradient[READOUT] +=
            precision * along * error + own * (readout - self.predicted_readout);
    }
}

impl FrameAlignment<'_> {
    /// The prior for a rolling shutter; `None` for a global one.
    pub(super) fn readout_prior(&self, state: &TrackingState) -> Option<ReadoutPrior> {
        let readout = self.context.readout;
        if !readout.is_rolling() {
            return None;
        }
        let step = self.step_in_pixels(state.motion.centre);
        let length = norm(&step);
        let interval = self.context.elapsed();
        let ratio = readout.seconds / interval;
        let growth = MOTION_SIGMA_RATIO * ratio.abs() + readout.deviation(interval) / interval;
        let known = self.has_measured_motion() && length > 0.0;
        let nominal = 1.0 / self.context.frame_rate;
        let open_share = self.open_share(state).max(MIN_OPEN_SHARE);
        let sequence_sigma = readout.deviation(nominal) / (nominal * open_share);
        Some(ReadoutPrior {
            pixels_per_unit: self.pixels_per_unit,
            direction: step.map(|v| if length > 0.0 { v / length } else { 0.0 }),
            length,
            readout_ratio: ratio,
            motion_sigma: MIN_MOTION_SIGMA_PX
                + growth * length
                + MOTION_CHANGE_SIGMA_RATIO
                    * (readout.seconds / nominal).abs()
                    * self.motion_change(state),
            predicted_readout: self.predicted_readout,
            readout_sigma: MIN_READOUT_SIGMA
                + READOUT_SIGMA_RATIO * self.predicted_readout.abs()
                + sequence_sigma,
            weight: if known { PRIOR_WEIGHT } else { 0.0 },
        })
    }

    /// The readout as measured by this frame; `None` unless it moved unlike the frames before.
    ///
    /// With `Δ` and `Δ'` the motion of this frame and the mean of those before during the nominal
    /// frame interval `T`, a map that was made with the readout `R'` contains the distortion
    /// `(R - R')/T Δ'`, so that with `e = Δ - Δ'`
    ///
    /// ```text
    /// r v = (R/T) Δ - ((R - R')/T) Δ'   or   (R/T) e = r v - (R'/T) Δ'
    /// ```
    pub(super) fn measured_readout(&self, state: &TrackingState) -> Option<MeasuredReadout> {
        let prior = self.readout_prior(state)?;
        let (step, past) = (self.motion_per_interval(state), self.mean_past_motion()?);
        let velocity = state.motion.velocity.to_array();
        let nominal = 1.0 / self.context.frame_rate;
        let ratio = self.context.readout.seconds / nominal;
        let change: [f64; 6] = std::array::from_fn(|i| step[i] - past[i]);
        let rows: [f64; 6] = std::array::from_fn(|i| {
            state.readout * velocity[i] * self.pixels_per_unit[i] - ratio * past[i]
        });
        let dot: f64 = rows.iter().zip(&change).map(|(r, a)| r * a).sum();
        let length = norm(&change);
        let known = prior.weight > 0.0 && length > MIN_MOTION_CHANGE_PX;
        known.then(|| MeasuredReadout {
            seconds: dot / (length * length) * nominal,
            deviation: (MEASUREMENT_SIGMA_PX
                + MOTION_CHANGE_SIGMA_RATIO * self.motion_change(state))
                / length
                * nominal,
        })
    }

    /// Mean motion of the last tracked frames [px per nominal frame interval].
    fn mean_past_motion(&self) -> Option<[f64; 6]> {
        let frames = &self.context.frames[self.context.frames.len().saturating_sub(PAST_FRAMES)..];
        let (mut sum, mut count) = ([0.0; 6], 0.0);
        for pair in frames.windows(2).filter(|pair| pair[0].tracked && pair[1].tracked) {
            let step = self.motion_between(&pair[0], &pair[1]);
            (0..6).for_each(|i| sum[i] += step[i]);
            count += 1.0;
        }
        (count > 0.0).then(|| sum.map(|v| v / count))
    }

    /// Motion since the last frame [px per nominal frame interval].
    fn motion_per_interval(&self, state: &TrackingState) -> [f64; 6] {
        let share = self.context.interval_ratio();
        self.step_in_pixels(state.motion.centre).map(|v| v * share)
    }

    /// Motion between two frames [px per nominal frame interval].
    fn motion_between(&self, from: &FrameEstimate, to: &FrameEstimate) -> [f64; 6] {
        let share = self.context.interval_over(to.timestamp - from.timestamp);
        let step = CentreVelocity::along(from.middle(), to.middle(), share).velocity.to_array();
        std::array::from_fn(|i| step[i] * self.pixels_per_unit[i])
    }

    fn step_in_pixels(&self, centre: Pose<f64>) -> [f64; 6] {
        let step = CentreVelocity::along(self.previous_pose, centre, 1.0).velocity.to_array();
        std::array::from_fn(|i| step[i] * self.pixels_per_unit[i])
    }

    /// Difference of the motion from that of the frame before [px per nominal frame interval]; the
    /// whole motion where that is unknown.
    fn motion_change(&self, state: &TrackingState) -> f64 {
        let step = self.motion_per_interval(state);
        let (Some(last), Some(before)) = (self.context.previous, self.context.before_previous)
        else {
            return norm(&step);
        };
        let before = self.motion_between(before, last);
        norm(&std::array::from_fn(|i| step[i] - before[i]))
    }
}

fn norm(values: &[f64; 6]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::objective::Observation;
    use crate::tracking::{SequenceReadout, TrackingContext};
    use crate::{Config, FrameEstimate};
    use i2slam_check::{assert_gradient, noise};
    use i2slam_compute::CancellationToken;
    use i2slam_formation::{FrameTone, ShutterPoses, TrajectoryScale};
    use i2slam_geometry::{Camera, Image, Pose};

    #[test]
    fn normal_equations_are_half_the_derivative_of_the_cost() {
        let values = noise(3, 6);
        let prior = ReadoutPrior {
            pixels_per_unit: [130.0, 130.0, 130.0, 260.0, 260.0, 260.0],
            direction: [0.1, -0.7, 0.2, 0.5, 0.3, 0.35],
            length: 7.0,
            readout_ratio: 0.6,
            motion_sigma: 0.9,
            predicted_readout: 1.5,
            readout_sigma: 0.4,
            weight: 20.0,
        };
        let x: Vec<f64> = values.iter().map(|v| 0.02 * v).chain([2.3]).collect();
        let velocity = |x: &[f64]| Tangent::from_array(std::array::from_fn(|i| x[i]));
        let mut equations = Equations::default();
        prior.add_to(velocity(&x), x[6], &mut equations);
        let indices = (VELOCITY..VELOCITY + 6).chain([READOUT]);
        let gradient: Vec<f64> = indices.map(|i| 2.0 * equations.gradient[i]).collect();
        assert_gradient("readout prior", &x, &gradient, 1e-5, 1e-6, |x| {
            prior.cost(velocity(x), x[6])
        });
    }

    const CAMERA: Camera<f64> =
        Camera { width: 64, height: 48, fx: 100.0, fy: 100.0, cx: 32.0, cy: 24.0 };
    const RATE: f64 = 30.0;
    /// Rows are read over half the frame interval, the shutter is open for a quarter.
    const SHARE: f64 = 0.5;
    const OPEN: f64 = 0.25;

    /// The camera after a turn of `pixels`.
    fn turned(pixels: f64) -> Pose<f64> {
        Pose::identity().retract(Tangent::from_array([0.0, 0.0, 0.0, 0.0, pixels / CAMERA.fx, 0.0]))
    }

    /// The readout as measured by the last of `frames`, each given by its time [frame intervals]
    /// and rotation [px]; all earlier ones were tracked with the true readout. The last rotates by
    /// `speed` px per frame interval while it is exposed.
    fn measured(frames: &[(f64, f64)], speed: f64) -> Option<MeasuredReadout> {
        let config = Config::default();
        let (&(now, turn), before) = frames.split_last()?;
        let estimate = |(index, &(time, turn)): (usize, &(f64, f64))| {
            FrameEstimate::at_pose(index, time / RATE, ShutterPoses::still(turned(turn)))
        };
        let estimates: Vec<_> = before.iter().enumerate().map(estimate).collect();
        let observation = Observation::new(Image::new(64, 48, 3), Image::new(64, 48, 1));
        let mut input = config.input.clone();
        (input.optimise_rolling_shutter, input.rolling_shutter_readout) = (true, SHARE / RATE);
        let context = TrackingContext {
            config: &config,
            camera: &CAMERA,
            frame_rate: RATE,
            readout: SequenceReadout::new(&input),
            timestamps: (now / RATE, now / RATE),
            frames: &estimates,
            previous: estimates.last(),
            before_previous: estimates.len().checked_sub(2).map(|i| &estimates[i]),
            exposure_motion: None,
            expected: None,
            keyframe: None,
            white_balance: config.formation.white_balance,
            vignetting: None,
            cancellation: &CancellationToken::default(),
        };
        let frame = FrameAlignment {
            context: &context,
            levels: Vec::new(),
            observation: &observation,
            curve: None,
            pixels_per_unit: [50.0, 50.0, 50.0, 100.0, 100.0, 100.0],
            previous_pose: estimates.last()?.middle(),
            predicted_white_balance: [0.0; 3],
            predicted_readout: SHARE / OPEN,
        };
        let velocity = Tangent::from_array([0.0, 0.0, 0.0, 0.0, OPEN * speed / CAMERA.fx, 0.0]);
        frame.measured_readout(&TrackingState {
            motion: CentreVelocity { centre: turned(turn), velocity },
            readout: SHARE / OPEN,
            tone: FrameTone::default(),
            response: None,
            scale: TrajectoryScale::from_frame_rate(RATE),
        })
    }

    #[test]
    fn constant_speed_measures_nothing_even_with_gaps() {
        let even = |times: &[f64]| times.iter().map(|t| (*t, 10.0 * t)).collect::<Vec<_>>();
        for times in
            [[0.0, 1.0, 2.0, 3.0, 4.0], [0.0, 1.0, 3.0, 4.0, 5.0], [0.0, 1.0, 2.0, 3.0, 5.0]]
        {
            assert!(measured(&even(&times), 10.0).is_none(), "{times:?}");
        }
    }

    #[test]
    fn a_change_of_speed_measures_the_readout_even_with_gaps() {
        let before = [(0.0, 0.0), (1.0, 10.0), (3.0, 30.0)];
        for (time, turn) in [(4.0, 50.0), (5.0, 70.0)] {
            let found = measured(&[&before[..], &[(time, turn)]].concat(), 20.0).expect("motion");
            assert!((found.seconds * RATE - SHARE).abs() < 1e-9, "{found:?}");
            let deviation = (MEASUREMENT_SIGMA_PX + MOTION_CHANGE_SIGMA_RATIO * 10.0) / 10.0;
            assert!((found.deviation * RATE - deviation).abs() < 1e-9, "{found:?}");
        }
    }
}

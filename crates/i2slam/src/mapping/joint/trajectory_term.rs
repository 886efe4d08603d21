//! The trajectory loss between keyframes (eqs. 15 to 17).

use crate::config::Config;
use crate::mapping::context::MappingContext;
use crate::mapping::frame_optimizer::adam;
use crate::mapping::keyframe::{Keyframe, intervals};
use crate::objective::{Evaluation, pull_back_to_middle};
use crate::reconstruction::FrameEstimate;
use i2slam_compute::Adam;
use i2slam_formation::{
    ShutterPoses, ShutterTangent, TrajectoryGradient, TrajectoryPair, TrajectoryScale,
};
use i2slam_geometry::Pose;

/// Assumed share of the frame interval for which the shutter of the first frame is open.
const INITIAL_OPEN_SHARE: f64 = 0.5;

/// Trajectory loss with its free scale `a` and the optimiser of that.
pub(super) struct TrajectoryTerm {
    frame_rate: f64,
    /// `a`, in frame intervals over exposures of the first frame.
    scale: TrajectoryScale<f64>,
    optimizer: Adam,
    d_scale: f64,
}

/// Loss of a frame with its neighbours, and derivatives by its own poses, exposure and by `a`.
#[derive(Default)]
struct FrameLoss {
    loss: f64,
    shutter: ShutterTangent<f64>,
    log_exposure: f64,
    scale: f64,
}

impl TrajectoryTerm {
    pub(super) fn new(frame_rate: f64) -> Self {
        let scale = TrajectoryScale::from_open_share(INITIAL_OPEN_SHARE);
        Self { frame_rate, scale, optimizer: adam(), d_scale: 0.0 }
    }

    /// Adds a frame's weighted loss, times `share`, to its evaluation; returns the unweighted one.
    pub(super) fn add(
        &mut self,
        context: &MappingContext<'_>,
        keyframe: &Keyframe,
        share: f64,
        evaluation: &mut Evaluation,
    ) -> f64 {
        let formation = &context.config.formation;
        if !formation.trajectory_loss || !formation.blur {
            return 0.0;
        }
        let estimate = &context.frames[keyframe.frame];
        let part = match keyframe.adjacent.both(estimate.timestamp) {
            Some(adjacent) => self.with_adjacent(estimate, adjacent),
            None => self.with_neighbours(context.frames, keyframe.frame),
        };
        evaluation.total += share * part.loss;
        evaluation.shutter = evaluation.shutter.plus(part.shutter.scaled(share));
        evaluation.tone.log_exposure += (share * part.log_exposure) as f32;
        self.d_scale += share * part.scale;
        part.loss
    }

    /// Loss of a frame with the session's frames before and after it.
    fn with_neighbours(&self, frames: &[FrameEstimate], frame: usize) -> FrameLoss {
        let mut part = FrameLoss::default();
        for last in [frame, frame + 1] {
            let Some((loss, gradient)) = self.pair(frames, last) else { continue };
            let (shutter, log_exposure) = match last == frame {
                true => (gradient.current, gradient.log_exposure_current),
                false => (gradient.previous, gradient.log_exposure_previous),
            };
            part.loss += loss;
            part.shutter = part.shutter.plus(shutter);
            part.log_exposure += log_exposure;
            part.scale += gradient.scale;
        }
        part
    }

    /// Loss of a keyframe with its adjacent video frames, which move along with it.
    fn with_adjacent(&self, frame: &FrameEstimate, adjacent: [(f64, Pose<f64>); 2]) -> FrameLoss {
        let (middle, own) = (frame.middle(), frame.shutter);
        let mut part = FrameLoss::default();
        for (stamp, relative) in adjacent {
            let other = middle * relative;
            let is_before = stamp < frame.timestamp;
            let (earlier, later) = (stamp.min(frame.timestamp), stamp.max(frame.timestamp));
            let exposure = f64::from(frame.tone.log_exposure).exp()
                / intervals(self.frame_rate, earlier, later);
            // The other frame has no known motion during exposure: zero exposure drops its terms.
            let still = (ShutterPoses::still(other), 0.0);
            let pair =
                |(previous, exposure_previous), (current, exposure_current)| TrajectoryPair {
                    previous,
                    current,
                    exposure_previous,
                    exposure_current,
                    scale: self.scale,
                };
            let pair =
                if is_before { pair(still, (own, exposure)) } else { pair((own, exposure), still) };
            let (loss, gradient) = pair.loss_and_gradient();
            let (d_own, d_other, d_exposure) = match is_before {
                true => (gradient.current, gradient.previous, gradient.log_exposure_current),
                false => (gradient.previous, gradient.current, gradient.log_exposure_previous),
            };
            let d_middle = pull_back_to_middle(middle, other, d_other.start.plus(d_other.end));
            part.loss += loss.total();
            part.shutter = part.shutter.plus(d_own).plus(own.pull_back(0.5, d_middle));
            part.log_exposure += d_exposure;
            part.scale += gradient.scale;
        }
        part
    }

    /// Loss and gradient of frame `last` with the one before it.
    fn pair(
        &self,
        frames: &[FrameEstimate],
        last: usize,
    ) -> Option<(f64, TrajectoryGradient<f64>)> {
        let current = frames.get(last)?;
        let previous = frames.get(last.checked_sub(1)?)?;
        let intervals = intervals(self.frame_rate, previous.timestamp, current.timestamp);
        let exposure = |frame: &FrameEstimate| f64::from(frame.tone.log_exposure).exp() / intervals;
        let pair = TrajectoryPair {
            previous: previous.shutter,
            current: current.shutter,
            exposure_previous: exposure(previous),
            exposure_current: exposure(current),
            scale: self.scale,
        };
        let (loss, gradient) = pair.loss_and_gradient();
        Some((loss.total(), gradient))
    }

    /// One step on `a` by the derivatives added since the last step.
    pub(super) fn step_scale(&mut self, config: &Config) {
        if self.d_scale == 0.0 {
            return;
        }
        let mut a = [self.scale.a as f32];
        let rate = config.parameters.frames.exposure_rate * a[0].abs().max(1e-3);
        self.optimizer.step(&mut a, &[self.d_scale as f32], rate);
        self.scale.a = f64::from(a[0]).clamp(0.0, 0.5);
        self.d_scale = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::assert_gradient;
    use i2slam_formation::FrameTone;
    use i2slam_geometry::Tangent;

    fn frame(index: usize, timestamp: f64) -> FrameEstimate {
        let t = index as f64;
        let motion = |s: f64| {
            let along = [0.1 * t + s, 0.02 * t * t, -0.03 * t, 0.05 * t + s, 0.02 * t * t, s];
            Pose::identity().retract(Tangent::from_array(along))
        };
        FrameEstimate {
            tone: FrameTone { log_exposure: 0.25 * t as f32, ..FrameTone::default() },
            keyframe: true,
            ..FrameEstimate::at_pose(
                index,
                timestamp,
                ShutterPoses { start: motion(-0.02), end: motion(0.03) },
            )
        }
    }

    /// Checks the derivatives of a frame's loss by its 12 pose coordinates, log exposure and scale.
    fn check(
        frame: &FrameEstimate,
        tolerance: f64,
        loss: impl Fn(&TrajectoryTerm, &FrameEstimate) -> FrameLoss,
    ) {
        let term = TrajectoryTerm::new(20.0);
        let FrameLoss { shutter, log_exposure, scale, .. } = loss(&term, frame);
        let mut analytic = shutter.to_array().to_vec();
        analytic.extend([log_exposure, scale]);
        // Exposures are kept in `f32`, which holds this step exactly.
        let step = 1.0 / 1024.0;
        assert_gradient("trajectory loss", &[0.0; 14], &analytic, step, tolerance, |x| {
            let mut moved = frame.clone();
            let step = ShutterTangent::from_array(std::array::from_fn(|i| x[i]));
            moved.shutter = moved.shutter.retract(&step);
            moved.tone.log_exposure += x[12] as f32;
            let scale = TrajectoryScale { a: term.scale.a + x[13] };
            loss(&TrajectoryTerm { scale, ..TrajectoryTerm::new(20.0) }, &moved).loss
        });
    }

    #[test]
    fn derivatives_with_neighbours_agree_with_differences() {
        let frames = [frame(0, 0.0), frame(1, 0.1), frame(2, 0.4)];
        check(&frames[1], 1e-6, |term, moved| {
            term.with_neighbours(&[frames[0].clone(), moved.clone(), frames[2].clone()], 1)
        });
        let alone = TrajectoryTerm::new(20.0).with_neighbours(&frames[..1], 0);
        assert_eq!(alone.loss, 0.0);
    }

    #[test]
    fn derivatives_with_adjacent_frames_agree_with_differences() {
        let relative = |scale: f64| {
            let step = [-0.03, 0.02, 0.01, 0.04, -0.02, 0.05].map(|v| scale * v);
            Pose::identity().retract(Tangent::from_array(step))
        };
        let adjacent = [(0.05, relative(1.0)), (0.2, relative(-1.7))];
        check(&frame(1, 0.1), 1e-5, |term, moved| term.with_adjacent(moved, adjacent));
    }
}

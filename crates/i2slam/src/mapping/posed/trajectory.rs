//! The trajectory loss between keyframes (eqs. 15 to 17).

use crate::config::Config;
use crate::mapping::Story;
use crate::mapping::frames::adam;
use crate::objective::Evaluation;
use crate::reconstruction::FrameEstimate;
use i2slam_compute::Adam;
use i2slam_formation::{ShutterTangent, TrajectoryGradient, TrajectoryPair, TrajectoryScale};

/// Share of the frame interval for which the shutter of the first frame is taken to be open.
const OPEN: f64 = 0.5;

/// The loss's own parameter, and what it asks of it.
pub(super) struct TrajectoryTerm {
    frame_rate: f64,
    /// `a`, in frame intervals over exposures of the first frame.
    scale: TrajectoryScale<f64>,
    optimizer: Adam,
    d_scale: f64,
}

/// Loss of a frame with its neighbours, and derivatives by what is the frame's own and by `a`.
#[derive(Default)]
struct Part {
    loss: f64,
    shutter: ShutterTangent<f64>,
    log_exposure: f64,
    scale: f64,
}

impl TrajectoryTerm {
    pub(super) fn new(frame_rate: f64) -> Self {
        let scale = TrajectoryScale::from_open_share(OPEN);
        Self { frame_rate, scale, optimizer: adam(), d_scale: 0.0 }
    }

    /// Adds the loss of a frame with its neighbours to its evaluation, `share` times; returns the
    /// loss itself.
    pub(super) fn add(
        &mut self,
        story: &Story<'_>,
        frame: usize,
        share: f64,
        evaluation: &mut Evaluation,
    ) -> f64 {
        let formation = &story.config.formation;
        if !formation.trajectory_loss || !formation.blur {
            return 0.0;
        }
        let weight = share * f64::from(story.config.keyframed.trajectory_weight);
        let part = self.around(story.frames, frame);
        evaluation.total += weight * part.loss;
        evaluation.shutter = evaluation.shutter.plus(part.shutter.scaled(weight));
        evaluation.tone.log_exposure += (weight * part.log_exposure) as f32;
        self.d_scale += weight * part.scale;
        part.loss
    }

    /// What a frame and its neighbours on both sides say.
    fn around(&self, frames: &[FrameEstimate], frame: usize) -> Part {
        let mut part = Part::default();
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

    /// Loss and gradient between frame `last` and the one before it.
    fn pair(
        &self,
        frames: &[FrameEstimate],
        last: usize,
    ) -> Option<(f64, TrajectoryGradient<f64>)> {
        let current = frames.get(last)?;
        let previous = frames.get(last.checked_sub(1)?)?;
        let intervals = intervals(self.frame_rate, previous, current);
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

    /// One step of `a` by all that was added since the last.
    pub(super) fn step_scale(&mut self, config: &Config) {
        if self.d_scale == 0.0 {
            return;
        }
        let mut a = [self.scale.a as f32];
        let rate = config.mapping.exposure_rate * a[0].abs().max(1e-3);
        self.optimizer.step(&mut a, &[self.d_scale as f32], rate);
        self.scale.a = f64::from(a[0]).clamp(0.0, 0.5);
        self.d_scale = 0.0;
    }
}

/// Frame intervals of the video between two keyframes.
pub(crate) fn intervals(frame_rate: f64, previous: &FrameEstimate, current: &FrameEstimate) -> f64 {
    let intervals = (current.timestamp - previous.timestamp) * frame_rate;
    if intervals.is_finite() { intervals.max(1.0) } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::assert_gradient;
    use i2slam_formation::{FrameTone, ShutterPoses};
    use i2slam_geometry::{Pose, Tangent};

    fn frame(index: usize, timestamp: f64) -> FrameEstimate {
        let t = index as f64;
        let motion = |s: f64| {
            let along = [0.1 * t + s, 0.02 * t * t, -0.03 * t, 0.05 * t + s, 0.02 * t * t, s];
            Pose::identity().retract(Tangent::from_array(along))
        };
        FrameEstimate {
            tone: FrameTone { log_exposure: 0.25 * t as f32, ..FrameTone::default() },
            keyframe: true,
            ..FrameEstimate::posed(
                index,
                timestamp,
                ShutterPoses { start: motion(-0.02), end: motion(0.03) },
            )
        }
    }

    #[test]
    fn derivatives_of_a_frame_between_two_agree_with_differences() {
        let frames = [frame(0, 0.0), frame(1, 0.1), frame(2, 0.4)];
        let term = TrajectoryTerm::new(20.0);
        let part = term.around(&frames, 1);
        let mut analytic = part.shutter.to_array().to_vec();
        analytic.extend([part.log_exposure, part.scale]);
        // Exposures are kept in `f32`, which holds this step exactly.
        let step = 1.0 / 1024.0;
        assert_gradient("trajectory loss", &[0.0; 14], &analytic, step, 1e-6, |x| {
            let mut moved = frames.clone();
            let step = ShutterTangent::from_array(std::array::from_fn(|i| x[i]));
            moved[1].shutter = moved[1].shutter.retract(&step);
            moved[1].tone.log_exposure += x[12] as f32;
            let scale = TrajectoryScale { a: term.scale.a + x[13] };
            TrajectoryTerm { scale, ..TrajectoryTerm::new(20.0) }.around(&moved, 1).loss
        });
        assert_eq!(term.around(&frames[..1], 0).loss, 0.0);
    }

    #[test]
    fn keyframes_far_apart_reach_a_smaller_share_of_the_way() {
        let (first, last) = (frame(0, 0.0), frame(1, 0.2));
        assert_eq!(intervals(20.0, &first, &last), 4.0);
        assert_eq!(intervals(20.0, &last, &first), 1.0);
    }
}

//! Tracking: where the camera was while a frame was exposed, and how bright the frame is.

mod alignment;
mod first_order;
mod readout;

pub(crate) use first_order::{NODE_STEP, mask_white_balance};
pub(crate) use readout::SequenceReadout;

use readout::MeasuredReadout;

use crate::config::{FormationConfig, Parameters, TrackingConfig, TrackingMethod};
use crate::objective::{Evaluation, FrameObjective, Observation, Sampling, SceneMap, blur_length};
use crate::reconstruction::{Convergence, FrameEstimate, Losses};
use i2slam_compute::CancellationToken;
use i2slam_formation::{CameraResponse, FrameTone, ShutterPoses, TrajectoryScale};
use i2slam_geometry::{Camera, Pose, Tangent};

/// What tracking may know beside map and picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TrackingContext<'a> {
    pub(crate) tracking: &'a TrackingConfig,
    pub(crate) formation: &'a FormationConfig,
    pub(crate) parameters: &'a Parameters,
    pub(crate) camera: &'a Camera<f64>,
    /// Frames per second.
    pub(crate) frame_rate: f64,
    /// The time in which the rows are read.
    pub(crate) readout: SequenceReadout,
    /// Times of the frame's colour and depth pictures [s].
    pub(crate) timestamps: (f64, f64),
    /// All frames before.
    pub(crate) frames: &'a [FrameEstimate],
    /// The frame before, if there is one.
    pub(crate) previous: Option<&'a FrameEstimate>,
    /// The frame before that.
    pub(crate) before_previous: Option<&'a FrameEstimate>,
    /// Where the frame is expected, if another source than constant velocity tells.
    pub(crate) expected: Option<Pose<f64>>,
    /// The last keyframe and its world-from-camera pose when its depth was taken.
    pub(crate) keyframe: Option<(&'a Observation, Pose<f64>)>,
    /// Once wished, first-order steps end with the best that they found.
    pub(crate) cancellation: &'a CancellationToken,
}

impl TrackingContext<'_> {
    /// Exposure time Δt [s] of the trajectory loss. Only ratios of exposures are observable;
    /// the unit is chosen so that frame 0 is open for half the frame interval, and the
    /// optimised scale `a` absorbs the rest.
    pub(crate) fn exposure_time(&self, tone: &FrameTone<f32>) -> f64 {
        0.5 / self.frame_rate * f64::from(tone.log_exposure).exp()
    }

    /// Time since the last frame as a share of the time between the two before it.
    fn relative_interval(&self) -> f64 {
        let (Some(last), Some(before)) = (self.previous, self.before_previous) else { return 1.0 };
        let ratio = (self.timestamps.0 - last.timestamp) / (last.timestamp - before.timestamp);
        if ratio.is_finite() { ratio.clamp(0.0, 5.0) } else { 1.0 }
    }

    /// The usual frame interval as a share of the time since the last frame: below 1 after a gap.
    fn interval_share(&self) -> f64 {
        self.previous.map_or(1.0, |last| self.share_of(self.timestamps.0 - last.timestamp))
    }

    /// The usual frame interval as a share of `seconds`.
    fn share_of(&self, seconds: f64) -> f64 {
        let share = 1.0 / (self.frame_rate * seconds);
        if share.is_finite() && share > 0.0 { share.clamp(0.05, 2.0) } else { 1.0 }
    }

    /// Time since the last frame [s].
    fn interval(&self) -> f64 {
        1.0 / (self.frame_rate * self.interval_share())
    }

    /// `κ = 2 a Δt`: the share of the frame interval for which the shutter is open.
    fn open_share(&self, scale: TrajectoryScale<f64>, tone: &FrameTone<f32>) -> f64 {
        (2.0 * scale.a * self.exposure_time(tone)).clamp(0.02, 1.0)
    }

    /// How far the depth picture is ahead of mid-exposure, as a share of the time since the last
    /// frame.
    fn depth_lead(&self) -> f64 {
        let Some(last) = self.previous else { return 0.0 };
        let lead = (self.timestamps.1 - self.timestamps.0) / (self.timestamps.0 - last.timestamp);
        if lead.is_finite() { lead.clamp(-1.0, 1.0) } else { 0.0 }
    }
}

/// Share of its speed that a camera is taken to keep from frame to frame while it is lost.
const LOST_SPEED: f64 = 0.8;

/// The result of tracking one frame.
#[derive(Clone, Debug)]
pub(crate) struct TrackingResult {
    pub(crate) shutter: ShutterPoses<f64>,
    /// First to last row [exposures], and what that says about the sequence's.
    pub(crate) readout: f64,
    pub(crate) measured_readout: Option<MeasuredReadout>,
    pub(crate) depth_lead: Tangent<f64>,
    pub(crate) tone: FrameTone<f32>,
    /// The frame's response, where responses are tracked.
    pub(crate) response: Option<CameraResponse<f32>>,
    pub(crate) scale: TrajectoryScale<f64>,
    pub(crate) losses: Losses,
    pub(crate) convergence: Convergence,
    pub(crate) tracked: bool,
}

impl TrackingResult {
    /// Where a frame is taken to be that cannot be compared with anything.
    pub(crate) fn lost(
        context: &TrackingContext<'_>,
        response: Option<&CameraResponse<f32>>,
        scale: TrajectoryScale<f64>,
    ) -> Self {
        Self {
            shutter: ShutterPoses::still(predict(context)),
            readout: 0.0,
            measured_readout: None,
            depth_lead: Tangent::zero(),
            tone: context.previous.map_or_else(FrameTone::default, |p| p.tone),
            response: response.cloned(),
            scale,
            losses: Losses::default(),
            convergence: Convergence::default(),
            tracked: false,
        }
    }

    fn new(
        state: first_order::State,
        evaluation: &Evaluation,
        trajectory: f64,
        tracked: bool,
    ) -> Self {
        Self {
            shutter: state.motion.into(),
            readout: state.readout,
            measured_readout: None,
            depth_lead: Tangent::zero(),
            tone: state.tone,
            response: state.response,
            scale: state.scale,
            losses: Losses { image: evaluation.image, depth: evaluation.depth, trajectory },
            convergence: Convergence::default(),
            tracked,
        }
    }

    /// What first-order steps made of an aligned frame, if they could be taken. What only alignment
    /// tells stays.
    fn or_refined(self, refined: Self) -> Self {
        if !refined.tracked {
            return self;
        }
        let Self { measured_readout, convergence, .. } = self;
        Self { measured_readout, convergence, ..refined }
    }
}

/// The predicted pose of a frame and the motion that led to it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Motion {
    /// World-from-camera of the frame to come.
    pub(crate) next: Pose<f64>,
    /// Motion per frame, in the camera's frame.
    pub(crate) step: Tangent<f64>,
}

impl Motion {
    /// The way to where the frame is expected. Without such a place, constant velocity from the two
    /// frames before; standing still with fewer. A lost camera slows down, so that its prediction
    /// stays near where it was seen last.
    pub(crate) fn constant_velocity(context: &TrackingContext<'_>) -> Self {
        let last = context.previous.map_or_else(Pose::identity, FrameEstimate::middle);
        if let Some(next) = context.expected {
            return Self {
                next,
                step: context.previous.map_or_else(Tangent::zero, |_| last.local(next)),
            };
        }
        let step = context
            .before_previous
            .map_or_else(Tangent::zero, |before| before.middle().local(last))
            .scaled(context.relative_interval());
        let lost = context.previous.is_some_and(|last| !last.tracked);
        let step = if lost { step.scaled(LOST_SPEED) } else { step };
        Self { next: last.retract(step), step }
    }
}

/// The constant-velocity prediction of the next frame's pose.
pub(crate) fn predict(context: &TrackingContext<'_>) -> Pose<f64> {
    Motion::constant_velocity(context).next
}

/// Finds shutter poses, tone and (where it belongs to the frame) response of a frame.
pub(crate) fn track<M: SceneMap>(
    context: &TrackingContext<'_>,
    objective: &mut FrameObjective<M>,
    map: &M,
    observation: &Observation,
    response: Option<&CameraResponse<f32>>,
    scale: TrajectoryScale<f64>,
) -> TrackingResult {
    let motion = Motion::constant_velocity(context);
    let tone = context.previous.map_or_else(FrameTone::default, |p| p.tone);
    let open_share = context.open_share(scale, &tone);
    let split = match context.readout.is_rolling() {
        true => open_share * context.interval_share(),
        false => start_split(context),
    };
    let mut state = first_order::State {
        motion: first_order::extrapolate(motion, split),
        readout: context.readout.seconds * context.frame_rate / open_share,
        tone,
        response: response.cloned(),
        scale,
    };
    let mut aligned = None;
    if context.tracking.method == TrackingMethod::SecondOrder {
        let result = alignment::align(context, objective, map, observation, state, motion);
        if context.tracking.iterations == 0 {
            return result;
        }
        state = first_order::State {
            motion: result.shutter.into(),
            readout: result.readout,
            tone: result.tone,
            response: result.response.clone(),
            scale: result.scale,
        };
        aligned = Some(result);
    }
    let exposed = (state.motion.into(), state.readout);
    let sampling = sampling(context.formation, context.camera, exposed, observation);
    let refined = first_order::refine(context, objective, map, observation, state, sampling);
    match aligned {
        Some(aligned) => aligned.or_refined(refined),
        None => refined,
    }
}

/// Distance of start and end pose that first-order tracking begins with, over the motion since the
/// last frame (the paper's appendix A).
const INITIAL_SPLIT: f32 = 0.1;

/// The first split of start and end pose as a share of the motion between frames.
fn start_split(context: &TrackingContext<'_>) -> f64 {
    if context.formation.blur { f64::from(INITIAL_SPLIT) } else { 0.0 }
}

/// How the exposure of a frame is sampled, from its shutter poses and readout [exposures].
pub(crate) fn sampling(
    formation: &FormationConfig,
    camera: &Camera<f64>,
    (shutter, readout): (ShutterPoses<f64>, f64),
    observation: &Observation,
) -> Sampling {
    Sampling::new(formation, blur_length(camera, &shutter, &observation.depth), readout)
}

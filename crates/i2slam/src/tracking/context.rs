//! Inputs, variables and result of tracking one frame, and the predicted motion it starts from.

use super::readout::{MeasuredReadout, SequenceReadout};
use crate::Config;
use crate::objective::{Evaluation, Observation, blur_length};
use crate::reconstruction::{Convergence, FrameEstimate, Losses};
use i2slam_compute::CancellationToken;
use i2slam_formation::{
    CameraResponse, CentreVelocity, FrameTone, ShutterPoses, TrajectoryScale, WhiteBalanceModel,
};
use i2slam_geometry::{Camera, Image, Pose, Rotation, Tangent};
use i2slam_radiance::Render;

/// Share of its speed that a lost camera keeps from frame to frame: the prediction stays near the
/// last pose that was measured.
const LOST_SPEED_DECAY: f64 = 0.8;

/// Inputs of tracking a frame, beside map and picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TrackingContext<'a> {
    pub(crate) config: &'a Config,
    pub(crate) camera: &'a Camera<f64>,
    /// Frames per second.
    pub(crate) frame_rate: f64,
    /// Rolling-shutter readout of the sequence.
    pub(crate) readout: SequenceReadout,
    /// Time stamps of the frame's colour and depth pictures [s].
    pub(crate) timestamps: (f64, f64),
    /// All earlier frames.
    pub(crate) frames: &'a [FrameEstimate],
    /// The frame before, if there is one.
    pub(crate) previous: Option<&'a FrameEstimate>,
    /// The frame before that.
    pub(crate) before_previous: Option<&'a FrameEstimate>,
    /// Motion from start to end of the exposure, of either sign, found by comparison with other
    /// photographs.
    pub(crate) exposure_motion: Option<Tangent<f64>>,
    /// The view predicted by another source than constant velocity.
    pub(crate) expected: Option<ExpectedView<'a>>,
    /// The last keyframe and its world-from-camera pose when its depth was taken.
    pub(crate) keyframe: Option<(&'a Observation, Pose<f64>)>,
    /// White balance of frames: that of the configuration, until it proves constant.
    pub(crate) white_balance: WhiteBalanceModel,
    /// Vignetting of every pixel; `None` for none.
    pub(crate) vignetting: Option<&'a [f32]>,
    /// Ends first-order steps early, with the best state so far.
    pub(crate) cancellation: &'a CancellationToken,
}

/// A pose that a frame is expected at, and the map seen from there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ExpectedView<'a> {
    pub(crate) world_from_camera: Pose<f64>,
    pub(crate) render: &'a Render,
}

impl TrackingContext<'_> {
    /// Exposure time Δt [s] of the trajectory loss. Only ratios of exposures are observable;
    /// the unit is chosen so that frame 0 is open for half the frame interval, and the
    /// optimised scale `a` absorbs the rest.
    pub(crate) fn exposure_time(&self, tone: &FrameTone<f32>) -> f64 {
        0.5 / self.frame_rate * f64::from(tone.log_exposure).exp()
    }

    /// Time since the last frame over the time between the two frames before it, in [0, 5].
    fn elapsed_ratio(&self) -> f64 {
        let (Some(last), Some(before)) = (self.previous, self.before_previous) else { return 1.0 };
        let ratio = (self.timestamps.0 - last.timestamp) / (last.timestamp - before.timestamp);
        if ratio.is_finite() { ratio.clamp(0.0, 5.0) } else { 1.0 }
    }

    /// The nominal frame interval over the time since the last frame: below 1 after a gap.
    pub(super) fn interval_ratio(&self) -> f64 {
        self.previous.map_or(1.0, |last| self.interval_over(self.timestamps.0 - last.timestamp))
    }

    /// The nominal frame interval over `seconds`, in [0.05, 2].
    pub(super) fn interval_over(&self, seconds: f64) -> f64 {
        let ratio = 1.0 / (self.frame_rate * seconds);
        if ratio.is_finite() && ratio > 0.0 { ratio.clamp(0.05, 2.0) } else { 1.0 }
    }

    /// Time since the last frame [s].
    pub(super) fn elapsed(&self) -> f64 {
        1.0 / (self.frame_rate * self.interval_ratio())
    }

    /// `κ = 2 a Δt`: the share of the frame interval for which the shutter is open.
    pub(super) fn open_share(&self, scale: TrajectoryScale<f64>, tone: &FrameTone<f32>) -> f64 {
        (2.0 * scale.a * self.exposure_time(tone)).clamp(0.02, 1.0)
    }

    /// Time from mid-exposure to the depth picture over the time since the last frame, in [-1, 1].
    pub(super) fn depth_delay_ratio(&self) -> f64 {
        let Some(last) = self.previous else { return 0.0 };
        let ratio = (self.timestamps.1 - self.timestamps.0) / (self.timestamps.0 - last.timestamp);
        if ratio.is_finite() { ratio.clamp(-1.0, 1.0) } else { 0.0 }
    }
}

/// The optimised variables of one frame.
#[derive(Clone)]
pub(super) struct TrackingState {
    pub(super) motion: CentreVelocity<f64>,
    /// Time from the first row to the last [exposures].
    pub(super) readout: f64,
    pub(super) tone: FrameTone<f32>,
    pub(super) response: Option<CameraResponse<f32>>,
    pub(super) scale: TrajectoryScale<f64>,
}

impl TrackingState {
    /// This state with the camera at rest at `pose`.
    pub(super) fn at_rest(&self, pose: Pose<f64>) -> Self {
        let motion = PredictedMotion { pose, step: Tangent::zero() }.during_exposure(0.0);
        Self { motion, ..self.clone() }
    }
}

/// The estimate of one tracked frame.
#[derive(Clone, Debug)]
pub(crate) struct TrackingResult {
    pub(crate) shutter: ShutterPoses<f64>,
    /// Time from the first row to the last [exposures].
    pub(crate) readout: f64,
    /// The readout that this frame's own motion shows, if it shows one.
    pub(crate) measured_readout: Option<MeasuredReadout>,
    /// Motion from mid-exposure to the depth picture.
    pub(crate) depth_offset: Tangent<f64>,
    pub(crate) tone: FrameTone<f32>,
    /// The frame's response, where responses are tracked.
    pub(crate) response: Option<CameraResponse<f32>>,
    pub(crate) scale: TrajectoryScale<f64>,
    pub(crate) losses: Losses,
    pub(crate) convergence: Convergence,
    pub(crate) tracked: bool,
}

impl TrackingResult {
    /// Writes what was estimated into a frame; `depth` weighs its blur length.
    pub(crate) fn write_to(
        &self,
        estimate: &mut FrameEstimate,
        camera: &Camera<f64>,
        depth: &Image<f32>,
    ) {
        estimate.shutter = self.shutter;
        estimate.readout = self.readout;
        estimate.tone = self.tone;
        estimate.losses = self.losses;
        estimate.convergence = self.convergence;
        estimate.blur_length = blur_length(camera, &self.shutter, depth);
    }

    pub(super) fn from_first_order(
        state: TrackingState,
        evaluation: &Evaluation,
        trajectory: f64,
        tracked: bool,
    ) -> Self {
        Self {
            shutter: state.motion.into(),
            readout: state.readout,
            measured_readout: None,
            depth_offset: Tangent::zero(),
            tone: state.tone,
            response: state.response,
            scale: state.scale,
            losses: Losses { image: evaluation.image, depth: evaluation.depth, trajectory },
            convergence: Convergence::default(),
            tracked,
        }
    }

    /// An aligned frame after first-order refinement, or as it was where that failed. Readout
    /// measurement and convergence are known from the alignment alone.
    pub(super) fn refined_by(self, refined: Self) -> Self {
        if !refined.tracked {
            return self;
        }
        let Self { measured_readout, convergence, .. } = self;
        Self { measured_readout, convergence, ..refined }
    }
}

/// The predicted pose of a frame and the motion since the last one.
#[derive(Clone, Copy, Debug)]
pub(super) struct PredictedMotion {
    /// World-from-camera pose of the frame.
    pub(super) pose: Pose<f64>,
    /// Motion since the last frame, in the last frame's camera.
    pub(super) step: Tangent<f64>,
}

impl PredictedMotion {
    /// The motion to the expected pose, where the context has one; otherwise constant velocity from
    /// the two frames before, and rest with fewer.
    pub(super) fn new(context: &TrackingContext<'_>) -> Self {
        let last = context.previous.map_or_else(Pose::identity, FrameEstimate::middle);
        if let Some(ExpectedView { world_from_camera: pose, .. }) = context.expected {
            let step = context.previous.map_or_else(Tangent::zero, |_| last.local(pose));
            return Self { pose, step };
        }
        let step = context
            .before_previous
            .map_or_else(Tangent::zero, |before| before.middle().local(last))
            .scaled(context.elapsed_ratio());
        let lost = context.previous.is_some_and(|last| !last.tracked);
        let step = if lost { step.scaled(LOST_SPEED_DECAY) } else { step };
        Self { pose: last.retract(step), step }
    }

    /// The motion during the exposure: `open_share` of the step (appendix A).
    pub(super) fn during_exposure(self, open_share: f64) -> CentreVelocity<f64> {
        let step = self.step;
        // The step in the axes of the camera at its end.
        let translation = Rotation::exp(step.rotation).inverse().rotate(step.translation);
        let velocity = Tangent { translation, ..step }.scaled(open_share);
        CentreVelocity { centre: self.pose, velocity }
    }
}

/// The predicted world-from-camera pose of the next frame.
pub(crate) fn predict_pose(context: &TrackingContext<'_>) -> Pose<f64> {
    PredictedMotion::new(context).pose
}

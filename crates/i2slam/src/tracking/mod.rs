//! Tracking: shutter poses, exposure and white balance of one frame against the current map.
//!
//! [`track`] predicts the motion by constant velocity, aligns the frame to the rendered map by
//! Levenberg-Marquardt ([`alignment`]) and may refine that by first-order steps ([`first_order`]).

mod alignment;
mod context;
mod first_order;
mod readout;

pub(crate) use context::{ExpectedView, TrackingContext, TrackingResult, predict_pose};
pub(crate) use first_order::RESPONSE_NODE_SPACING;
pub(crate) use readout::SequenceReadout;

use crate::config::{FormationConfig, TrackingMethod};
use crate::objective::{FrameObjective, Observation, Sampling, blur_length};
use context::{PredictedMotion, TrackingState};
use i2slam_formation::{CameraResponse, CentreVelocity, FrameTone, ShutterPoses, TrajectoryScale};
use i2slam_geometry::Camera;
use i2slam_radiance::RadianceMap;

/// Motion between start and end pose that first-order tracking begins with, over the motion since
/// the last frame (the paper's appendix A).
const INITIAL_SPLIT: f32 = 0.1;

/// Finds shutter poses, tone and (where it belongs to the frame) response of a frame.
pub(crate) fn track<M: RadianceMap>(
    context: &TrackingContext<'_>,
    objective: &mut FrameObjective<M>,
    map: &M,
    observation: &Observation,
    response: Option<&CameraResponse<f32>>,
    scale: TrajectoryScale<f64>,
) -> TrackingResult {
    let predicted = PredictedMotion::new(context);
    let tone = context.previous.map_or_else(FrameTone::default, |p| p.tone);
    let open_share = context.open_share(scale, &tone);
    let initial_split = match context.readout.is_rolling() {
        true => open_share * context.interval_ratio(),
        false if context.config.formation.blur => f64::from(INITIAL_SPLIT),
        false => 0.0,
    };
    let mut state = TrackingState {
        motion: match context.exposure_motion.filter(|_| context.config.formation.blur) {
            Some(velocity) => CentreVelocity { centre: predicted.pose, velocity },
            None => predicted.during_exposure(initial_split),
        },
        readout: context.readout.seconds * context.frame_rate / open_share,
        tone,
        response: response.cloned(),
        scale,
    };
    let mut aligned = None;
    if context.config.tracking.method == TrackingMethod::SecondOrder {
        let result = alignment::align(context, objective, map, observation, state, predicted);
        if context.config.tracking.iterations == 0 {
            return result;
        }
        state = TrackingState {
            motion: result.shutter.into(),
            readout: result.readout,
            tone: result.tone,
            response: result.response.clone(),
            scale: result.scale,
        };
        aligned = Some(result);
    }
    let exposed = (state.motion.into(), state.readout);
    let sampling = sampling(&context.config.formation, context.camera, exposed, observation);
    let refined = first_order::refine(context, objective, map, observation, state, sampling);
    match aligned {
        Some(aligned) => aligned.refined_by(refined),
        None => refined,
    }
}

/// Virtual cameras and blur method of an exposure, from its shutter poses and readout [exposures].
pub(crate) fn sampling(
    formation: &FormationConfig,
    camera: &Camera<f64>,
    (shutter, readout): (ShutterPoses<f64>, f64),
    observation: &Observation,
) -> Sampling {
    Sampling::new(formation, blur_length(camera, &shutter, &observation.depth), readout)
}

//! First-order tracking: Adam on the rendered objective (SplaTAM; the paper's section on tracking).

use super::context::{TrackingContext, TrackingResult, TrackingState};
use crate::config::{FormationConfig, TrackingParameters};
use crate::objective::{
    Evaluation, Exposure, FrameObjective, FrameVariables, Observation, Sampling,
};
use i2slam_compute::{Adam, AdamSettings};
use i2slam_formation::{
    CameraResponse, Formation, FrameTone, ResponseCurve, TrajectoryGradient, TrajectoryPair,
};
use i2slam_geometry::{Tangent, Vec3};
use i2slam_radiance::RadianceMap;

/// λ_img of eq. 12, a sum over pixels (SplaTAM).
const IMAGE_WEIGHT: f32 = 0.5;
/// λ_depth of eq. 12, a sum over pixels (SplaTAM).
const DEPTH_WEIGHT: f32 = 1.0;
/// Rendered opacity below which a pixel does not count (SplaTAM).
const MIN_OPACITY: f32 = 0.99;
/// Learning rate of the rotational velocity over that of rotations (the paper's appendix A).
const VELOCITY_ROTATION_RATE: f32 = 0.1;

/// Optimisers, one for each group of variables with a learning rate of its own.
struct Optimizers {
    centre: TangentOptimizer,
    velocity: TangentOptimizer,
    tone: Adam,
    response: Vec<Adam>,
    scale: Adam,
}

impl Optimizers {
    fn new(curves: usize) -> Self {
        Self {
            centre: TangentOptimizer::new(),
            velocity: TangentOptimizer::new(),
            tone: adam(),
            response: (0..curves).map(|_| adam()).collect(),
            scale: adam(),
        }
    }
}

fn adam() -> Adam {
    Adam::new(AdamSettings::default())
}

/// Optimisers of translation and rotation.
struct TangentOptimizer([Adam; 2]);

impl TangentOptimizer {
    fn new() -> Self {
        Self([adam(), adam()])
    }

    /// The step against `gradient`, with learning rates of translation and rotation.
    fn step(&mut self, gradient: Tangent<f64>, rates: [f32; 2]) -> Tangent<f64> {
        let [translation, rotation] = &mut self.0;
        let step = |adam: &mut Adam, gradient: Vec3<f64>, rate| {
            let mut step = [0.0_f32; 3];
            adam.step(&mut step, &gradient.to_array().map(|g| g as f32), rate);
            Vec3::from_array(step.map(f64::from))
        };
        Tangent {
            translation: step(translation, gradient.translation, rates[0]),
            rotation: step(rotation, gradient.rotation, rates[1]),
        }
    }
}

/// Takes `tracking.iterations` steps from `start`, fewer once cancelled, and returns the state with
/// the smallest loss.
pub(super) fn refine<M: RadianceMap>(
    context: &TrackingContext<'_>,
    objective: &mut FrameObjective<M>,
    map: &M,
    observation: &Observation,
    start: TrackingState,
    sampling: Sampling,
) -> TrackingResult {
    let mut state = start;
    let mut optimizers = Optimizers::new(state.response.as_ref().map_or(0, |r| r.nodes.len()));
    let mut best: Option<(f64, TrackingState, Evaluation, f64)> = None;
    for _ in 0..context.config.tracking.iterations {
        let curve = state.response.as_ref().map(CameraResponse::curve);
        let mut evaluation = evaluate(
            objective,
            map,
            observation,
            &state,
            (curve.as_ref(), context.vignetting),
            sampling,
        );
        let trajectory = add_trajectory_loss(context, &state, &mut evaluation);
        let total = evaluation.total;
        if !total.is_finite() || evaluation.pixels == 0 {
            break;
        }
        let improved = best.as_ref().is_none_or(|b| total < b.0);
        let loss = trajectory.as_ref().map_or(0.0, |t| t.0);
        if improved {
            best = Some((total, state.clone(), evaluation.clone(), loss));
        }
        if context.cancellation.is_cancelled() {
            break;
        }
        step(context, &mut state, &mut optimizers, &evaluation, trajectory.map(|t| t.1));
    }
    match best {
        Some((_, state, evaluation, trajectory)) => {
            TrackingResult::from_first_order(state, &evaluation, trajectory, true)
        }
        None => TrackingResult::from_first_order(state, &Evaluation::default(), 0.0, false),
    }
}

fn evaluate<M: RadianceMap>(
    objective: &mut FrameObjective<M>,
    map: &M,
    observation: &Observation,
    state: &TrackingState,
    (curve, vignetting): (Option<&ResponseCurve<f32>>, Option<&[f32]>),
    sampling: Sampling,
) -> Evaluation {
    let variables = FrameVariables {
        exposure: Exposure {
            shutter: state.motion.into(),
            sampling,
            readout: state.readout,
            depth_pose: None,
        },
        tone: curve.map(|curve| Formation { tone: state.tone, curve, vignetting }),
    };
    objective.track(map, observation, &variables, MIN_OPACITY, (IMAGE_WEIGHT, DEPTH_WEIGHT))
}

/// Adds λ_traj L_traj (eq. 15) to the objective and its shutter gradient; returns loss and
/// gradient.
fn add_trajectory_loss(
    context: &TrackingContext<'_>,
    state: &TrackingState,
    evaluation: &mut Evaluation,
) -> Option<(f64, TrajectoryGradient<f64>)> {
    if !context.config.formation.trajectory_loss || !context.config.formation.blur {
        return None;
    }
    let previous = context.previous?;
    let pair = TrajectoryPair {
        previous: previous.shutter,
        current: state.motion.into(),
        exposure_previous: context.exposure_time(&previous.tone) * context.interval_ratio(),
        exposure_current: context.exposure_time(&state.tone) * context.interval_ratio(),
        scale: state.scale,
    };
    let (loss, gradient) = pair.loss_and_gradient();
    let weight = f64::from(context.config.tracking.trajectory_weight);
    evaluation.total += weight * loss.total();
    evaluation.shutter = evaluation.shutter.plus(gradient.current.scaled(weight));
    Some((loss.total(), gradient))
}

fn step(
    context: &TrackingContext<'_>,
    state: &mut TrackingState,
    optimizers: &mut Optimizers,
    evaluation: &Evaluation,
    trajectory: Option<TrajectoryGradient<f64>>,
) {
    let (tracking, formation) = (&context.config.tracking, &context.config.formation);
    step_motion(&context.config.parameters.tracking, formation, state, optimizers, evaluation);
    let weight = tracking.trajectory_weight;
    if formation.tone {
        let by_trajectory = trajectory.map_or(0.0, |t| weight * t.log_exposure_current as f32);
        step_tone(context, state, optimizers, evaluation, by_trajectory);
    }
    if let Some(gradient) = trajectory {
        let mut a = [state.scale.a as f32];
        let rate = context.config.parameters.frames.tracking_rate * a[0].abs().max(1e-3);
        optimizers.scale.step(&mut a, &[weight * gradient.scale as f32], rate);
        state.scale.a = f64::from(a[0]).max(0.0);
    }
}

/// Steps centre and velocity; without blur the velocity stays zero.
fn step_motion(
    parameters: &TrackingParameters,
    formation: &FormationConfig,
    state: &mut TrackingState,
    optimizers: &mut Optimizers,
    evaluation: &Evaluation,
) {
    let (d_centre, d_velocity) = state.motion.pull_back(evaluation.shutter);
    let rates = [parameters.translation_rate, parameters.rotation_rate];
    let centre = optimizers.centre.step(d_centre, rates);
    let velocity = if formation.blur {
        optimizers.velocity.step(d_velocity, [rates[0], rates[1] * VELOCITY_ROTATION_RATE])
    } else {
        Tangent::zero()
    };
    state.motion = state.motion.retract(centre, velocity);
}

fn step_tone(
    context: &TrackingContext<'_>,
    state: &mut TrackingState,
    optimizers: &mut Optimizers,
    evaluation: &Evaluation,
    d_log_exposure: f32,
) {
    let (formation, rate) =
        (&context.config.formation, context.config.parameters.frames.tracking_rate);
    let mut gradient = evaluation.tone;
    gradient.log_exposure += d_log_exposure;
    context.white_balance.project_gradient(&mut gradient.log_white_balance);
    let mut values = state.tone.to_array();
    optimizers.tone.step(&mut values, &gradient.to_array(), rate);
    state.tone = FrameTone::from_array(values);
    if formation.response_scope != crate::config::ResponseScope::Frame {
        return;
    }
    if let (Some(response), Some(d_curve)) = (&mut state.response, &evaluation.curve) {
        let d_nodes = response.pull_back(d_curve);
        for ((nodes, d), adam) in
            response.nodes.iter_mut().zip(&d_nodes).zip(&mut optimizers.response)
        {
            adam.step(nodes, d, rate * RESPONSE_NODE_SPACING);
        }
    }
}

/// Difference between neighbouring nodes of a linear response, the unit of its learning rate:
/// longer steps make neighbours overtake each other, and keeping the curve monotone then flattens
/// it.
pub(crate) const RESPONSE_NODE_SPACING: f32 = 1.0 / 255.0;

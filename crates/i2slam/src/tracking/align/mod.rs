//! Second-order tracking: Gauss-Newton on the re-projected model, coarse to fine.
//!
//! The model is rendered once at the predicted pose (and anew where the frame turns out to be
//! elsewhere); every step re-projects that render through the frame's depth to the virtual
//! cameras of the exposure, blurs, forms and compares. Twelve pose numbers, the exposure and the
//! white balance are solved for together.

mod prior;
mod pyramid;
mod residual;

use super::adam::{State, extrapolate};
use super::{Motion, TrackingContext, TrackingResult};
use crate::config::WhiteBalance;
use crate::objective::{FrameObjective, Observation, blur_length, virtual_camera_count};
use crate::reconstruction::Losses;
use i2slam_formation::{CameraResponse, CentreVelocity, ResponseCurve};
use i2slam_geometry::{Pose, Tangent};
use i2slam_radiance::gaussian::GaussianMap;
use prior::{MotionPrior, freeze};
use pyramid::{Model, Observed, depth_levels, model_levels, observed_levels};
use residual::{Linearization, Scales, Sums};

/// Share of the frame's depth that must lie on the model for a frame to count as tracked.
const LEAST_OVERLAP: f64 = 0.3;
/// Robust scales before anything is known: depth [m at 1 m] and picture.
const FIRST_SCALES: Scales = Scales { depth: 0.02, image: 0.08 };
/// A step shorter than this [px] ends a level.
const CONVERGED: f64 = 2e-3;
/// Moves of the model's pose [px] that call for a new render.
const RENDER_AGAIN: f64 = 0.5;

/// A picture of the map that a frame is aligned to: the rendered model (radiance and depth), or
/// the last keyframe's own depth, which has no radiance but edges that no splat has softened.
struct Reference {
    levels: Vec<Model>,
    world_from_camera: Pose<f64>,
    scales: Scales,
    has_radiance: bool,
}

/// Weight of the trajectory prior against single residuals: neighbouring pixels are not
/// independent, and a map that is still soft would otherwise be read as a still camera.
const PRIOR_WEIGHT: f64 = 200.0;

/// How many times less noise than the model's residuals a keyframe's own depth must have.
const CLEANER: f32 = 3.0;

/// Scale of the depth residual [m at 1 m] from which pictures have their full weight.
const COARSE_DEPTH: f32 = 1.5e-3;

/// Everything about one frame that its steps share.
struct Frame<'a> {
    context: &'a TrackingContext<'a>,
    observed: Vec<Observed>,
    observation: &'a Observation,
    curve: Option<ResponseCurve<f32>>,
    /// Pixels per metre and per radian, for tangents in pixels.
    pixels: [f64; 6],
    previous: Pose<f64>,
}

/// Where an alignment ended.
struct Outcome {
    state: State,
    sums: Sums,
}

/// Aligns a frame from the constant-velocity prediction; from a standing start too where that
/// does not converge, and keeps the better of both.
pub(super) fn align(
    context: &TrackingContext<'_>,
    objective: &mut FrameObjective,
    map: &GaussianMap,
    observation: &Observation,
    state: State,
    motion: Motion,
) -> TrackingResult {
    let previous = context.previous.map_or_else(Pose::identity, |p| p.middle());
    let frame = Frame {
        context,
        observed: observed_levels(context.camera, observation, context.tracking.alignment.levels),
        observation,
        curve: state.response.as_ref().map(CameraResponse::curve),
        pixels: pixels_per_unit(context, observation),
        previous,
    };
    let predicted = state.clone();
    let mut outcome = frame.descend(objective, map, state);
    if outcome.sums.overlap() < LEAST_OVERLAP {
        let standing = Motion { next: previous, step: Tangent::zero() };
        let start = State { motion: extrapolate(standing, 0.0), ..predicted.clone() };
        let second = frame.descend(objective, map, start);
        if second.sums.overlap() > outcome.sums.overlap() {
            outcome = second;
        }
    }
    if outcome.sums.overlap() < LEAST_OVERLAP {
        let lost = State { motion: extrapolate(motion, 0.0), ..predicted };
        return frame.result(lost, &outcome.sums, false);
    }
    let state = frame.with_learned_share(outcome.state.clone());
    frame.result(state, &outcome.sums, true)
}

/// How far a metre and a radian move the picture [px], at the frame's median depth.
fn pixels_per_unit(context: &TrackingContext<'_>, observation: &Observation) -> [f64; 6] {
    let mut depths: Vec<f32> =
        observation.depth.data.iter().copied().step_by(7).filter(|&d| d > 0.0).collect();
    let middle = depths.len() / 2;
    let depth = match depths.is_empty() {
        true => 2.0,
        false => f64::from(*depths.select_nth_unstable_by(middle, f32::total_cmp).1),
    };
    let focal = context.camera.fx;
    let metre = focal / depth;
    [metre, metre, metre, focal, focal, focal]
}

impl Frame<'_> {
    /// Coarse to fine, on renders at ever better poses.
    fn descend(
        &self,
        objective: &mut FrameObjective,
        map: &GaussianMap,
        mut state: State,
    ) -> Outcome {
        let levels = self.observed.len();
        let mut references = vec![self.model(objective, map, state.motion.centre)];
        references.extend(self.keyframe());
        let mut sums = Sums::default();
        for round in 0..self.context.tracking.alignment.renders {
            if round > 0 {
                let pose = references[0].world_from_camera;
                if self.in_pixels(pose.local(state.motion.centre)) < RENDER_AGAIN {
                    break;
                }
                let model = self.model(objective, map, state.motion.centre);
                let scales = references[0].scales;
                references[0] = Reference { scales, ..model };
            }
            let coarsest = if round == 0 { levels } else { 1 };
            for level in (0..coarsest).rev() {
                sums = self.solve_level(&mut references, level, &mut state);
            }
        }
        Outcome { state, sums }
    }

    fn model(&self, objective: &mut FrameObjective, map: &GaussianMap, at: Pose<f64>) -> Reference {
        Reference {
            levels: model_levels(objective.render(map, at), self.observed.len()),
            world_from_camera: at,
            scales: FIRST_SCALES,
            has_radiance: true,
        }
    }

    fn keyframe(&self) -> Option<Reference> {
        let (observation, world_from_camera) = self.context.keyframe?;
        if !self.context.tracking.alignment.keyframe_depth {
            return None;
        }
        Some(Reference {
            levels: depth_levels(&observation.depth, self.observed.len()),
            world_from_camera,
            scales: FIRST_SCALES,
            has_radiance: false,
        })
    }

    /// Gauss-Newton on one level, twice: with the scales of the level before, then with its own.
    fn solve_level(&self, references: &mut [Reference], level: usize, state: &mut State) -> Sums {
        let settings = &self.context.tracking.alignment;
        let mut sums = Sums::default();
        for _ in 0..2 {
            for reference in references.iter_mut() {
                let sums = self.linearize(reference, level, state);
                self.update_scales(&sums, &mut reference.scales);
            }
            let linearize = |state: &State| {
                let mut total = Sums::default();
                for reference in cleanest(references) {
                    let mut part = self.linearize(reference, level, state);
                    if !reference.has_radiance {
                        // Overlap with the map says whether a frame is tracked.
                        (part.candidates, part.agreeing) = (0, 0);
                    }
                    total.merge(&part);
                }
                total
            };
            let converged = CONVERGED * (level + 1) as f64;
            sums = linearize(state);
            self.step_down(state, &mut sums, settings.iterations / 2, converged, linearize);
        }
        sums
    }

    /// Levenberg-Marquardt steps; one that raises the cost is taken back.
    fn step_down(
        &self,
        state: &mut State,
        sums: &mut Sums,
        steps: usize,
        converged: f64,
        linearize: impl Fn(&State) -> Sums,
    ) {
        let mut damping = 1e-5;
        for _ in 0..steps {
            let mut equations = sums.equations.clone();
            self.add_prior(state, &mut equations);
            let Some(step) = equations.step(damping) else { break };
            let next = retract(state, &step);
            let next_sums = linearize(&next);
            // One prior for both sides, held where the step was taken from.
            let prior = self.context.formation.blur.then(|| self.prior(state));
            let cost = |state: &State, sums: &Sums| {
                let prior = prior.as_ref().map_or(0.0, |p| p.cost(state.motion.velocity));
                sums.mean_cost() + prior / sums.equations.count.max(1) as f64
            };
            if cost(&next, &next_sums) > cost(state, sums) * (1.0 + 1e-4) {
                damping *= 100.0;
                if damping > 1.0 {
                    break;
                }
                continue;
            }
            let length = self.in_pixels(Tangent::from_array(std::array::from_fn(|i| step[i])));
            (*state, *sums) = (next, next_sums);
            damping = (damping * 0.1).max(1e-7);
            if length < converged {
                break;
            }
        }
    }

    fn linearize(&self, reference: &Reference, level: usize, state: &State) -> Sums {
        let blur = self.blur(state) / f64::from(1 << level);
        let formation = self.context.formation;
        let cameras = match formation.blur {
            true => virtual_camera_count(
                blur,
                f64::from(formation.blur_per_camera),
                formation.virtual_cameras,
            ),
            false => 1,
        };
        Linearization {
            model: &reference.levels[level],
            observed: &self.observed[level],
            model_from_world: reference.world_from_camera.inverse(),
            state,
            curve: self.curve.as_ref(),
            cameras,
            quadrature: formation.quadrature(),
            world_from_depth: state.motion.centre.retract(self.depth_lead(state)),
            depth_lead: self.context.depth_lead(),
            scales: reference.scales,
            image_weight: match reference.has_radiance {
                true => self.context.tracking.alignment.image_weight * exactness(reference),
                false => 0.0,
            },
            derivatives: true,
        }
        .accumulate()
    }

    /// Robust scales follow the mean absolute residual, down to their floors.
    fn update_scales(&self, sums: &Sums, scales: &mut Scales) {
        let settings = &self.context.tracking.alignment;
        if sums.errors.depth_count > 0 {
            let mean = (sums.errors.depth / sums.errors.depth_count as f64) as f32;
            scales.depth = (1.25 * mean).max(settings.depth_scale_floor);
        }
        if sums.errors.image_count > 0 {
            let mean = (sums.errors.image / sums.errors.image_count as f64) as f32;
            scales.image = (1.25 * mean).max(settings.image_scale_floor);
        }
    }

    fn add_prior(&self, state: &State, equations: &mut residual::Equations) {
        let formation = self.context.formation;
        if formation.blur {
            self.prior(state).add_to(state.motion.velocity, equations);
        } else {
            freeze(equations, 6..12);
        }
        let fixed = match (formation.tone, formation.white_balance) {
            (false, _) => 12..16,
            (true, WhiteBalance::PerChannel) => 14..15,
            (true, _) => 13..16,
        };
        freeze(equations, fixed);
    }

    fn prior(&self, state: &State) -> MotionPrior {
        let free = !self.context.formation.trajectory_loss;
        MotionPrior {
            pixels: self.pixels,
            step: CentreVelocity::along(self.previous, state.motion.centre, 1.0).velocity,
            share: self.open_share(state) * self.context.interval_share(),
            across: f64::from(self.context.tracking.alignment.motion_prior),
            along: 0.5,
            weight: if free { 1e-3 } else { PRIOR_WEIGHT },
        }
    }

    /// Motion from mid-exposure to the depth picture.
    fn depth_lead(&self, state: &State) -> Tangent<f64> {
        self.previous.local(state.motion.centre).scaled(self.context.depth_lead())
    }

    /// `κ = 2 a Δt`: the share of the frame interval for which the shutter is open.
    fn open_share(&self, state: &State) -> f64 {
        (2.0 * state.scale.a * self.context.exposure_time(&state.tone)).clamp(0.02, 1.0)
    }

    /// Lets the scale `a` follow the share that was measured, the more the longer the motion.
    fn with_learned_share(&self, mut state: State) -> State {
        let formation = self.context.formation;
        if !formation.blur || !formation.trajectory_loss {
            return state;
        }
        let (share, motion) = self.prior(&state).measured_share(state.motion.velocity);
        let trust = motion * motion / (motion * motion + 400.0);
        let share = (share / self.context.interval_share()).clamp(0.02, 1.0);
        let ratio = (share / self.open_share(&state)).ln();
        state.scale.a *= (0.5 * trust * ratio).exp();
        state
    }

    fn blur(&self, state: &State) -> f64 {
        let shutter = state.motion.into();
        blur_length(self.context.camera, &shutter, &self.observation.depth)
    }

    fn in_pixels(&self, tangent: Tangent<f64>) -> f64 {
        let values = tangent.to_array();
        values.iter().zip(self.pixels).map(|(v, p)| (v * p).powi(2)).sum::<f64>().sqrt()
    }

    fn result(&self, state: State, sums: &Sums, tracked: bool) -> TrackingResult {
        TrackingResult {
            shutter: state.motion.into(),
            depth_lead: self.depth_lead(&state),
            tone: state.tone,
            response: state.response,
            scale: state.scale,
            losses: Losses {
                image: sums.errors.image / sums.errors.image_count.max(1) as f64,
                depth: sums.errors.depth / sums.errors.depth_count.max(1) as f64,
                trajectory: 0.0,
            },
            tracked,
        }
    }
}

/// The model, and the keyframe where its own depth is far less noisy than the model is wrong:
/// true of an exact depth, not of a sensor's, which the model has averaged.
///
/// The keyframe is judged by the noise of its depth alone, not by how well it fits: that would
/// depend on the pose, which is what is looked for.
fn cleanest(references: &[Reference]) -> impl Iterator<Item = &Reference> {
    let model = references[0].scales.depth;
    references.iter().filter(move |r| r.has_radiance || CLEANER * r.levels[0].noise < model)
}

/// What is left of the image's weight where depth is exact. The errors of pictures are not
/// independent (a map that is still soft is wrong everywhere in the same way), so they must not
/// outvote a depth that knows better than a millimetre at a metre.
fn exactness(reference: &Reference) -> f32 {
    (reference.scales.depth / COARSE_DEPTH).clamp(0.05, 1.0)
}

fn retract(state: &State, step: &[f64; residual::UNKNOWNS]) -> State {
    let mut next = state.clone();
    let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| step[from + i]));
    next.motion = next.motion.retract(part(0), part(6));
    next.tone.log_exposure += step[12] as f32;
    for channel in 0..3 {
        next.tone.log_white_balance[channel] += step[13 + channel] as f32;
    }
    next
}

//! Gauss-Newton down the levels of the pictures.

use super::balance::BalancePrior;
use super::priors::{MotionPrior, freeze};
use super::residual::{Equations, Errors, Linearization, READOUT, Sums, UNKNOWNS};
use super::rolling_shutter::ReadoutPrior;
use super::target::{Reference, cleanest};
use super::{Frame, State};
use crate::config::WhiteBalanceModel;
use crate::objective::{FrameObjective, SceneMap, virtual_camera_count};
use i2slam_geometry::Tangent;

/// A step shorter than this [px] ends a level.
const CONVERGED: f64 = 2e-3;
/// A descent whose last step was shorter than this [px] has converged: noise moves its end farther.
const SETTLED: f64 = 0.02;
/// Moves of the model's pose [px] that call for a new render.
const RENDER_AGAIN: f64 = 0.5;

/// Renders of the model, each at the refined pose.
const MAX_RENDERS: usize = 2;
/// Steps of a descent; a level takes two.
const MAX_STEPS: usize = 6;
/// A frame takes 1 / (1 + this) of the white balance that it asks for: cameras change it slowly.
const WHITE_BALANCE_INERTIA: f32 = 1.5;

/// Where an alignment ended.
pub(super) struct Outcome {
    pub(super) state: State,
    /// Without derivatives.
    pub(super) sums: Sums,
    pub(super) progress: Progress,
    /// What the frame was aligned to.
    pub(super) references: Vec<Reference>,
}

/// How a descent went.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Progress {
    /// Steps tried, over all levels.
    pub(super) steps: usize,
    /// Whether the last step was too short to matter.
    pub(super) converged: bool,
}

/// All residuals at one state.
struct Evaluation {
    total: Sums,
    /// Errors against each reference that counts.
    errors: Vec<Option<Errors>>,
}

/// What is known of a state beside its residuals.
struct Priors {
    motion: Option<MotionPrior>,
    readout: Option<ReadoutPrior>,
    balance: BalancePrior,
}

impl Priors {
    /// Mean cost of the residuals with the priors' share.
    fn cost(&self, state: &State, sums: &Sums) -> f64 {
        let velocity = state.motion.velocity;
        let readout = self.readout.as_ref().map_or(0.0, |p| p.cost(velocity, state.readout));
        let motion = self.motion.as_ref().map_or(0.0, |p| p.cost(velocity));
        let balance = self.balance.cost(state.tone.log_white_balance);
        sums.mean_cost() + (motion + readout + balance) / sums.equations.count.max(1) as f64
    }
}

/// What an evaluation is for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// To take a step from there.
    Step,
    /// The same from depth alone.
    StepByDepth,
    /// To compare cost and errors.
    Compare,
}

impl Frame<'_> {
    /// Coarse to fine, on renders at ever better poses.
    pub(super) fn descend<M: SceneMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        mut state: State,
    ) -> Outcome {
        let levels = self.observed.len();
        let mut references = vec![Reference::model(self, objective, map, state.motion.centre)];
        references.extend(Reference::keyframe(self));
        let (mut sums, mut progress) = (Sums::default(), Progress::default());
        for round in 0..MAX_RENDERS {
            if round > 0 {
                let pose = references[0].world_from_camera;
                if self.in_pixels(pose.local(state.motion.centre)) < RENDER_AGAIN {
                    break;
                }
                let model = Reference::model(self, objective, map, state.motion.centre);
                let scales = references[0].scales;
                references[0] = Reference { scales, ..model };
            }
            let coarsest = if round == 0 { levels } else { 1 };
            for level in (0..coarsest).rev() {
                sums = self.solve_level(&mut references, level, &mut state, &mut progress);
            }
        }
        Outcome { state, sums, progress, references }
    }

    /// Gauss-Newton on one level, twice: with the scales of the level before, then with its own.
    pub(super) fn solve_level(
        &self,
        references: &mut [Reference],
        level: usize,
        state: &mut State,
        progress: &mut Progress,
    ) -> Sums {
        let mut known = vec![None; references.len()];
        let mut sums = Sums::default();
        for _ in 0..2 {
            let cameras = self.virtual_cameras(level, state);
            for (reference, known) in references.iter_mut().zip(known) {
                let errors = known.unwrap_or_else(|| {
                    self.residuals(reference, level, state, cameras, Purpose::Compare).errors
                });
                reference.update_scales(&errors);
            }
            let end = self.step_down(references, level, state, MAX_STEPS, progress);
            (sums, known) = (end.total, end.errors);
        }
        sums
    }

    /// Levenberg-Marquardt steps; one that raises the cost is taken back.
    fn step_down(
        &self,
        references: &[Reference],
        level: usize,
        state: &mut State,
        steps: usize,
        progress: &mut Progress,
    ) -> Evaluation {
        let converged = CONVERGED * (level + 1) as f64;
        progress.converged = false;
        let mut damping = 1e-5;
        let mut here = self.evaluate(references, level, state, Purpose::Step);
        for left in (0..steps).rev() {
            let mut equations = here.total.equations.clone();
            self.add_prior(state, &mut equations);
            let Some(step) = equations.step(damping) else { break };
            let length = self.in_pixels(Tangent::from_array(std::array::from_fn(|i| step[i])));
            let last = length < converged || left == 0;
            progress.steps += 1;
            progress.converged = length < SETTLED;
            let purpose = if last { Purpose::Compare } else { Purpose::Step };
            let mut next = retract(state, &step);
            next.readout = self.context.readout.one_way(next.readout);
            let there = self.evaluate(references, level, &next, purpose);
            // The same for both sides, held where the step was taken from.
            let priors = self.priors(state, &here.total.equations);
            let bound = priors.cost(state, &here.total) * (1.0 + 1e-4);
            let lower = priors.cost(&next, &there.total) <= bound;
            if !lower || there.total.equations.count == 0 {
                damping *= 100.0;
                if damping > 1.0 {
                    break;
                }
                continue;
            }
            (*state, here) = (next, there);
            damping = (damping * 0.1).max(1e-7);
            if last {
                break;
            }
        }
        here
    }

    fn evaluate(
        &self,
        references: &[Reference],
        level: usize,
        state: &State,
        purpose: Purpose,
    ) -> Evaluation {
        let cameras = self.virtual_cameras(level, state);
        let mut all = Evaluation { total: Sums::default(), errors: vec![None; references.len()] };
        for (index, reference) in cleanest(references) {
            let mut part = self.residuals(reference, level, state, cameras, purpose);
            if !reference.has_radiance {
                // Overlap with the map says whether a frame is tracked.
                (part.candidates, part.agreeing) = (0, 0);
            }
            all.errors[index] = Some(part.errors);
            all.total.merge(&part);
        }
        all
    }

    /// How many moments of the exposure a level needs.
    pub(super) fn virtual_cameras(&self, level: usize, state: &State) -> usize {
        let formation = self.context.formation;
        if !formation.blur {
            return 1;
        }
        let blur = self.blur(state) / f64::from(1 << level);
        let per_camera = f64::from(formation.blur_per_camera);
        virtual_camera_count(blur, per_camera, formation.virtual_cameras)
    }

    pub(super) fn residuals(
        &self,
        reference: &Reference,
        level: usize,
        state: &State,
        cameras: usize,
        purpose: Purpose,
    ) -> Sums {
        Linearization {
            model: &reference.levels[level],
            observed: &self.observed[level],
            model_from_world: reference.world_from_camera.inverse(),
            state,
            curve: self.curve.as_ref(),
            cameras,
            quadrature: self.context.formation.quadrature,
            rolling_height: self
                .context
                .readout
                .is_rolling()
                .then(|| self.context.camera.height as f64 / f64::from(1_u32 << level)),
            world_from_depth: state.motion.centre.retract(self.depth_lead(state)),
            depth_lead: self.depth_share(),
            scales: self.scales(reference),
            image_weight: match purpose {
                Purpose::StepByDepth => 0.0,
                _ => self.image_weight(reference),
            },
            derivatives: purpose != Purpose::Compare,
        }
        .accumulate()
    }

    fn balance_prior(&self, equations: &Equations) -> BalancePrior {
        BalancePrior::new(equations, WHITE_BALANCE_INERTIA, self.white_balance)
    }

    fn priors(&self, state: &State, equations: &Equations) -> Priors {
        let motion = self.context.formation.blur.then(|| self.prior(state));
        let balance = self.balance_prior(equations);
        Priors { motion, readout: self.readout_prior(state), balance }
    }

    pub(super) fn add_prior(&self, state: &State, equations: &mut Equations) {
        let formation = self.context.formation;
        self.balance_prior(equations).add_to(state.tone.log_white_balance, equations);
        if formation.blur {
            self.prior(state).add_to(state.motion.velocity, equations);
        } else {
            freeze(equations, 6..12);
        }
        let fixed = match (formation.tone, formation.white_balance) {
            (false, _) => 12..16,
            (true, WhiteBalanceModel::PerChannel) => 14..15,
            (true, _) => 13..16,
        };
        freeze(equations, fixed);
        match self.readout_prior(state) {
            Some(prior) => prior.add_to(state.motion.velocity, state.readout, equations),
            None => freeze(equations, READOUT..UNKNOWNS),
        }
    }
}

fn retract(state: &State, step: &[f64; UNKNOWNS]) -> State {
    let mut next = state.clone();
    let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| step[from + i]));
    next.motion = next.motion.retract(part(0), part(6));
    next.readout += step[READOUT];
    next.tone.log_exposure += step[12] as f32;
    for channel in 0..3 {
        next.tone.log_white_balance[channel] += step[13 + channel] as f32;
    }
    next
}

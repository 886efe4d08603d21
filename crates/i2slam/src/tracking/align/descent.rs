//! Gauss-Newton down the levels of the pictures.

use super::prior::freeze;
use super::reference::{Reference, cleanest};
use super::residual::{Equations, Errors, Linearization, Sums, UNKNOWNS};
use super::{Frame, State};
use crate::config::WhiteBalance;
use crate::objective::{FrameObjective, SceneMap, virtual_camera_count};
use i2slam_geometry::Tangent;

/// A step shorter than this [px] ends a level.
const CONVERGED: f64 = 2e-3;
/// Moves of the model's pose [px] that call for a new render.
const RENDER_AGAIN: f64 = 0.5;

/// Where an alignment ended.
pub(super) struct Outcome {
    pub(super) state: State,
    /// Without derivatives.
    pub(super) sums: Sums,
}

/// All residuals at one state.
struct Evaluation {
    total: Sums,
    /// Errors against each reference that counts.
    errors: Vec<Option<Errors>>,
}

/// What an evaluation is for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Purpose {
    /// To take a step from there.
    Step,
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
        let mut sums = Sums::default();
        for round in 0..self.context.tracking.alignment.renders {
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
                sums = self.solve_level(&mut references, level, &mut state);
            }
        }
        Outcome { state, sums }
    }

    /// Gauss-Newton on one level, twice: with the scales of the level before, then with its own.
    fn solve_level(&self, references: &mut [Reference], level: usize, state: &mut State) -> Sums {
        let settings = &self.context.tracking.alignment;
        let mut known = vec![None; references.len()];
        let mut sums = Sums::default();
        for _ in 0..2 {
            let cameras = self.virtual_cameras(level, state);
            for (reference, known) in references.iter_mut().zip(known) {
                let errors = known.unwrap_or_else(|| {
                    self.residuals(reference, level, state, cameras, Purpose::Compare).errors
                });
                reference.update_scales(&errors, settings);
            }
            let end = self.step_down(references, level, state, settings.iterations / 2);
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
    ) -> Evaluation {
        let converged = CONVERGED * (level + 1) as f64;
        let mut damping = 1e-5;
        let mut here = self.evaluate(references, level, state, Purpose::Step);
        for left in (0..steps).rev() {
            let mut equations = here.total.equations.clone();
            self.add_prior(state, &mut equations);
            let Some(step) = equations.step(damping) else { break };
            let length = self.in_pixels(Tangent::from_array(std::array::from_fn(|i| step[i])));
            let last = length < converged || left == 0;
            let purpose = if last { Purpose::Compare } else { Purpose::Step };
            let next = retract(state, &step);
            let there = self.evaluate(references, level, &next, purpose);
            // One prior for both sides, held where the step was taken from.
            let prior = self.context.formation.blur.then(|| self.prior(state));
            let cost = |state: &State, sums: &Sums| {
                let prior = prior.as_ref().map_or(0.0, |p| p.cost(state.motion.velocity));
                sums.mean_cost() + prior / sums.equations.count.max(1) as f64
            };
            let lower = cost(&next, &there.total) <= cost(state, &here.total) * (1.0 + 1e-4);
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
    fn virtual_cameras(&self, level: usize, state: &State) -> usize {
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
            quadrature: self.context.formation.quadrature(),
            world_from_depth: state.motion.centre.retract(self.depth_lead(state)),
            depth_lead: self.depth_share(),
            scales: reference.scales,
            image_weight: reference.image_weight(&self.context.tracking.alignment),
            derivatives: purpose == Purpose::Step,
        }
        .accumulate()
    }

    fn add_prior(&self, state: &State, equations: &mut Equations) {
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
}

fn retract(state: &State, step: &[f64; UNKNOWNS]) -> State {
    let mut next = state.clone();
    let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| step[from + i]));
    next.motion = next.motion.retract(part(0), part(6));
    next.tone.log_exposure += step[12] as f32;
    for channel in 0..3 {
        next.tone.log_white_balance[channel] += step[13 + channel] as f32;
    }
    next
}

//! Levenberg-Marquardt over the levels of the image pyramid.

use super::priors::{MotionPrior, WhiteBalancePrior, freeze};
use super::rolling_shutter::ReadoutPrior;
use super::target::{AlignmentTarget, active_targets};
use super::{FrameAlignment, TrackingState};
use crate::config::WhiteBalanceModel;
use crate::objective::{FrameObjective, blur_length, virtual_camera_count};
use i2slam_geometry::Tangent;
use i2slam_odometry::alignment::{
    AbsoluteErrors, Derivatives, Equations, Linearization, ResidualSums,
};
use i2slam_odometry::alignment::{EXPOSURE, READOUT, UNKNOWNS, VELOCITY, WHITE_BALANCE};
use i2slam_radiance::RadianceMap;

/// Step length at which a level ends [px at that level].
const MIN_STEP_PX: f64 = 2e-3;
/// Length of the last step below which the optimisation has converged [px]: noise moves its end
/// farther.
const CONVERGED_STEP_PX: f64 = 0.02;
/// Distance from the rendered pose from which the map is rendered again [px].
const RERENDER_DISTANCE_PX: f64 = 0.5;
/// Largest number of renders of the map, each at the improved pose.
const MAX_RENDERS: usize = 2;
/// Largest number of steps of one minimisation; a level takes two.
const MAX_STEPS: usize = 6;
/// Share of the residuals that a step keeps at least: the mean cost is least where nothing of the map is seen.
/// On coarse levels steps that lose half of them recover.
const MIN_KEPT_SHARE: f64 = 0.1;
/// λ of the [`WhiteBalancePrior`].
const WHITE_BALANCE_INERTIA: f32 = 1.5;

/// End of an optimisation.
pub(super) struct AlignmentOutcome {
    pub(super) state: TrackingState,
    /// Without derivatives.
    pub(super) sums: ResidualSums,
    pub(super) progress: SolverProgress,
    pub(super) targets: Vec<AlignmentTarget>,
}

/// Iterations of an optimisation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SolverProgress {
    /// Steps tried, over all levels, the rejected ones included.
    pub(super) steps: usize,
    /// Whether the last step was shorter than [`CONVERGED_STEP_PX`].
    pub(super) converged: bool,
}

/// Residuals of all targets at one state.
struct Evaluation {
    total: ResidualSums,
    /// By target; `None` for one that does not count.
    errors: Vec<Option<AbsoluteErrors>>,
}

/// Priors on a state.
struct Priors {
    motion: Option<MotionPrior>,
    readout: Option<ReadoutPrior>,
    white_balance: WhiteBalancePrior,
}

impl Priors {
    /// Cost of residuals and priors, over the number of residuals.
    fn cost(&self, state: &TrackingState, sums: &ResidualSums) -> f64 {
        let velocity = state.motion.velocity;
        let readout = self.readout.as_ref().map_or(0.0, |p| p.cost(velocity, state.readout));
        let motion = self.motion.as_ref().map_or(0.0, |p| p.cost(velocity));
        let white_balance = self.white_balance.cost(state.tone.log_white_balance);
        sums.mean_cost() + (motion + readout + white_balance) / sums.equations.count.max(1) as f64
    }
}

/// Parts of an evaluation.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum EvaluationMode {
    /// All residuals with derivatives.
    Full,
    /// Depth residuals with derivatives.
    DepthOnly,
    /// All residuals without derivatives.
    CostOnly,
}

impl FrameAlignment<'_> {
    /// Optimises from the coarsest level to the finest, then again on the finest against renders at
    /// the improved pose.
    pub(super) fn coarse_to_fine<M: RadianceMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        mut state: TrackingState,
    ) -> AlignmentOutcome {
        let levels = self.levels.len();
        let mut targets =
            vec![AlignmentTarget::from_map(self, objective, map, state.motion.centre)];
        targets.extend(AlignmentTarget::from_keyframe(self));
        let (mut sums, mut progress) = (ResidualSums::default(), SolverProgress::default());
        for round in 0..MAX_RENDERS {
            if round > 0 {
                let pose = targets[0].world_from_camera;
                if self.norm_in_pixels(pose.local(state.motion.centre)) < RERENDER_DISTANCE_PX {
                    break;
                }
                let target = AlignmentTarget::from_map(self, objective, map, state.motion.centre);
                let scales = targets[0].scales;
                targets[0] = AlignmentTarget { scales, ..target };
            }
            let coarsest = if round == 0 { levels } else { 1 };
            for level in (0..coarsest).rev() {
                sums = self.minimize_level(&mut targets, level, &mut state, &mut progress);
            }
        }
        AlignmentOutcome { state, sums, progress, targets }
    }

    /// Minimises on one level, twice: the robust scales follow the residuals in between.
    pub(super) fn minimize_level(
        &self,
        targets: &mut [AlignmentTarget],
        level: usize,
        state: &mut TrackingState,
        progress: &mut SolverProgress,
    ) -> ResidualSums {
        let mut known = vec![None; targets.len()];
        let mut sums = ResidualSums::default();
        for _ in 0..2 {
            let cameras = self.virtual_cameras(level, state);
            for (target, known) in targets.iter_mut().zip(known) {
                let errors = known.unwrap_or_else(|| {
                    self.residuals(target, level, state, cameras, EvaluationMode::CostOnly).errors
                });
                target.update_scales(&errors);
            }
            let end = self.levenberg_marquardt(targets, level, state, progress);
            (sums, known) = (end.total, end.errors);
        }
        sums
    }

    /// Up to [`MAX_STEPS`] steps; one that raises the cost, or looks away from the map, is rejected and damped
    /// a hundredfold.
    fn levenberg_marquardt(
        &self,
        targets: &[AlignmentTarget],
        level: usize,
        state: &mut TrackingState,
        progress: &mut SolverProgress,
    ) -> Evaluation {
        let converged = MIN_STEP_PX * (level + 1) as f64;
        progress.converged = false;
        let mut damping = 1e-5;
        let mut here = self.evaluate(targets, level, state, EvaluationMode::Full);
        for left in (0..MAX_STEPS).rev() {
            let mut equations = here.total.equations.clone();
            self.add_priors(state, &mut equations);
            let Some(step) = equations.step(damping) else { break };
            let length = self.norm_in_pixels(Tangent::from_array(std::array::from_fn(|i| step[i])));
            let last = length < converged || left == 0;
            progress.steps += 1;
            progress.converged = length < CONVERGED_STEP_PX;
            let mode = if last { EvaluationMode::CostOnly } else { EvaluationMode::Full };
            let mut next = retract(state, &step);
            next.readout = self.context.readout.keep_direction(next.readout);
            let there = self.evaluate(targets, level, &next, mode);
            // Some priors depend on the state: both sides are compared under those of the old one.
            let priors = self.priors(state, &here.total.equations);
            let bound = priors.cost(state, &here.total) * (1.0 + 1e-4);
            let lower = priors.cost(&next, &there.total) <= bound;
            let [before, after] = [&here, &there].map(|e| e.total.equations.count as f64);
            if !lower || after <= MIN_KEPT_SHARE * before {
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
        targets: &[AlignmentTarget],
        level: usize,
        state: &TrackingState,
        mode: EvaluationMode,
    ) -> Evaluation {
        let cameras = self.virtual_cameras(level, state);
        let mut all =
            Evaluation { total: ResidualSums::default(), errors: vec![None; targets.len()] };
        for (index, target) in active_targets(targets) {
            let mut part = self.residuals(target, level, state, cameras, mode);
            if !target.has_radiance {
                // Acceptance is about the overlap with the map alone.
                (part.candidates, part.agreeing) = (0, 0);
            }
            all.errors[index] = Some(part.errors);
            all.total.merge(&part);
        }
        all
    }

    /// Virtual cameras that a level needs for the blur of `state`.
    pub(super) fn virtual_cameras(&self, level: usize, state: &TrackingState) -> usize {
        let formation = &self.context.config.formation;
        if !formation.blur {
            return 1;
        }
        let shutter = state.motion.into();
        let blur = blur_length(self.context.camera, &shutter, &self.observation.depth)
            / f64::from(1 << level);
        let per_camera = f64::from(formation.blur_per_camera);
        virtual_camera_count(blur, per_camera, formation.virtual_cameras)
    }

    pub(super) fn residuals(
        &self,
        target: &AlignmentTarget,
        level: usize,
        state: &TrackingState,
        cameras: usize,
        mode: EvaluationMode,
    ) -> ResidualSums {
        Linearization {
            target: &target.levels[level],
            frame: &self.levels[level],
            target_from_world: target.world_from_camera.inverse(),
            motion: state.motion,
            readout: state.readout,
            tone: state.tone,
            curve: self.curve.as_ref(),
            cameras,
            quadrature: self.context.config.formation.quadrature,
            target_rows: None,
            rolling_height: self
                .context
                .readout
                .is_rolling()
                .then(|| self.context.camera.height as f64 / f64::from(1_u32 << level)),
            world_from_depth: state.motion.centre.retract(self.depth_offset(state)),
            depth_offset_ratio: self.depth_offset_ratio(),
            scales: self.scales(target),
            image_weight: match mode {
                EvaluationMode::DepthOnly => 0.0,
                _ => self.image_weight(target),
            },
            derivatives: match mode {
                EvaluationMode::CostOnly => Derivatives::None,
                _ => Derivatives::All,
            },
        }
        .accumulate()
    }

    fn white_balance_prior(&self, equations: &Equations) -> WhiteBalancePrior {
        WhiteBalancePrior::new(equations, WHITE_BALANCE_INERTIA, self.predicted_white_balance)
    }

    fn priors(&self, state: &TrackingState, equations: &Equations) -> Priors {
        let motion = self.context.config.formation.blur.then(|| self.motion_prior(state));
        let white_balance = self.white_balance_prior(equations);
        Priors { motion, readout: self.readout_prior(state), white_balance }
    }

    /// Adds the priors' normal equations and freezes the unknowns that the settings fix.
    pub(super) fn add_priors(&self, state: &TrackingState, equations: &mut Equations) {
        let formation = &self.context.config.formation;
        self.white_balance_prior(equations).add_to(state.tone.log_white_balance, equations);
        if formation.blur {
            self.motion_prior(state).add_to(state.motion.velocity, equations);
        } else {
            freeze(equations, VELOCITY..EXPOSURE);
        }
        let fixed = match (formation.tone, self.context.white_balance) {
            (false, _) => EXPOSURE..READOUT,
            // The gain of green is the exposure's.
            (true, WhiteBalanceModel::PerChannel) => WHITE_BALANCE + 1..WHITE_BALANCE + 2,
            (true, _) => WHITE_BALANCE..READOUT,
        };
        freeze(equations, fixed);
        match self.readout_prior(state) {
            Some(prior) => prior.add_to(state.motion.velocity, state.readout, equations),
            None => freeze(equations, READOUT..UNKNOWNS),
        }
    }
}

fn retract(state: &TrackingState, step: &[f64; UNKNOWNS]) -> TrackingState {
    let mut next = state.clone();
    let part = |from: usize| Tangent::from_array(std::array::from_fn(|i| step[from + i]));
    next.motion = next.motion.retract(part(0), part(VELOCITY));
    next.readout += step[READOUT];
    next.tone.log_exposure += step[EXPOSURE] as f32;
    for channel in 0..3 {
        next.tone.log_white_balance[channel] += step[WHITE_BALANCE + channel] as f32;
    }
    next
}

//! Second-order tracking: Gauss-Newton on the re-projected model, coarse to fine.
//!
//! The model is rendered once at the predicted pose (and anew where the frame turns out to be
//! elsewhere); every step re-projects that render through the frame's depth to the virtual
//! cameras of the exposure, blurs, forms and compares. Twelve pose numbers, the exposure and the
//! white balance are solved for together.

mod acceptance;
mod balance;
mod blur_initialization;
mod covariance;
mod levenberg_marquardt;
mod noise;
mod priors;
mod pyramid;
mod relocalization;
mod residual;
mod rolling_shutter;
mod target;

use super::first_order::{State, extrapolate};
use super::{Motion, TrackingContext, TrackingResult};
use crate::objective::{FrameObjective, Observation, SceneMap, blur_length};
use crate::reconstruction::{Convergence, Losses};
use acceptance::MIN_OVERLAP;
use i2slam_compute::median;
use i2slam_formation::{CameraResponse, CentreVelocity, ResponseCurve};
use i2slam_geometry::{Pose, Tangent};
use levenberg_marquardt::Outcome;
use priors::MotionPrior;
use pyramid::{Observed, observed_levels};
use relocalization::standing;
use residual::Sums;

/// Levels of the picture pyramid, each half the size of the one before.
const LEVELS: usize = 3;
/// Standard deviation of the blur motion, over the motion between frames.
const MOTION_DEVIATION: f32 = 0.1;
/// Share of the overlap that a better start must keep: what sees nothing has no loss.
const KEPT_OVERLAP: f64 = 0.9;
/// Frame intervals after which the motion since the last frame no longer tells the velocity.
const MAX_INTERVAL: f64 = 3.5;
/// Share of the picture that must have depth: a pose from one small patch slides along it.
const MIN_DEPTH: f64 = 0.05;
/// Weight of the trajectory prior against single residuals: neighbouring pixels are not
/// independent, and a map that is still soft would otherwise be read as a still camera.
const PRIOR_WEIGHT: f64 = 200.0;

/// Everything about one frame that its steps share.
struct Frame<'a> {
    context: &'a TrackingContext<'a>,
    observed: Vec<Observed>,
    observation: &'a Observation,
    curve: Option<ResponseCurve<f32>>,
    /// Pixels per metre and per radian, for tangents in pixels.
    pixels: [f64; 6],
    previous: Pose<f64>,
    /// Logarithms of the white balance that is expected.
    white_balance: [f32; 3],
    /// The readout that the descent starts from [exposures].
    readout_start: f64,
}

/// Aligns a frame from the constant-velocity prediction; from a standing start where that end is
/// not to be believed. Where both fail, the frame is looked for around all places that the map was
/// seen from, unless its place was told.
pub(super) fn align<M: SceneMap>(
    context: &TrackingContext<'_>,
    objective: &mut FrameObjective<M>,
    map: &M,
    observation: &Observation,
    state: State,
    motion: Motion,
) -> TrackingResult {
    let previous = context.previous.map_or_else(Pose::identity, |p| p.middle());
    let frame = Frame {
        context,
        observed: observed_levels(context.camera, observation, LEVELS),
        observation,
        curve: state.response.as_ref().map(CameraResponse::curve),
        pixels: pixels_per_unit(context, observation),
        previous,
        white_balance: state.tone.log_white_balance,
        readout_start: state.readout,
    };
    let predicted = state.clone();
    let lost = |sums: &Sums| {
        let state = State { motion: extrapolate(motion, 0.0), ..predicted.clone() };
        frame.result(state, sums, Convergence::default(), false)
    };
    let pixels = observation.depth.pixels() as f64;
    if (observation.valid_depths() as f64) < MIN_DEPTH * pixels {
        return lost(&Sums::default());
    }
    let first = frame.settle(objective, map, state);
    if frame.is_believed(&first) {
        let convergence = frame.convergence(&first);
        let state = frame.with_learned_share(first.state);
        return frame.result(state, &first.sums, convergence, true);
    }
    let still = frame.settle(objective, map, standing(&predicted, previous));
    let found = match frame.is_believed(&still) {
        true => Some(still),
        false if context.expected.is_some() => None,
        false => frame.recover(objective, map, &predicted),
    };
    let Some(found) = found else { return lost(&first.sums) };
    let convergence = frame.convergence(&found);
    frame.result(found.state, &found.sums, convergence, true)
}

fn losses(sums: &Sums) -> Losses {
    let errors = &sums.errors;
    Losses {
        image: errors.image / errors.image_count.max(1) as f64,
        depth: errors.depth / errors.depth_count.max(1) as f64,
        trajectory: 0.0,
    }
}

/// How far a metre and a radian move the picture [px], at the frame's median depth.
fn pixels_per_unit(context: &TrackingContext<'_>, observation: &Observation) -> [f64; 6] {
    let mut depths: Vec<f32> =
        observation.depth.data.iter().copied().step_by(7).filter(|&d| d > 0.0).collect();
    let depth = median(&mut depths).map_or(2.0, f64::from);
    let focal = context.camera.fx;
    let metre = focal / depth;
    [metre, metre, metre, focal, focal, focal]
}

impl Frame<'_> {
    /// Descends; where no motion before tells the velocity, again with the best of some streaks.
    fn settle<M: SceneMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        start: State,
    ) -> Outcome {
        let end = self.descend(objective, map, start);
        if self.motion_is_known() || end.sums.overlap() < MIN_OVERLAP {
            return end;
        }
        let Some(streak) = self.with_streak(objective, map, &end.state) else { return end };
        let moving = self.descend(objective, map, streak);
        let sees_as_much = moving.sums.overlap() >= KEPT_OVERLAP * end.sums.overlap();
        match sees_as_much && losses(&moving.sums).image < losses(&end.sums).image {
            true => moving,
            false => end,
        }
    }

    fn prior(&self, state: &State) -> MotionPrior {
        let free = !self.context.formation.trajectory_loss || !self.motion_is_known();
        MotionPrior {
            pixels: self.pixels,
            step: CentreVelocity::along(self.previous, state.motion.centre, 1.0).velocity,
            share: self.open_share(state) * self.context.interval_share(),
            across: f64::from(MOTION_DEVIATION),
            along: 0.5,
            weight: if free { 1e-3 } else { PRIOR_WEIGHT },
        }
    }

    /// Whether the motion since the last frame was measured at both ends, and so soon after it that
    /// it tells the velocity.
    fn motion_is_known(&self) -> bool {
        let is_soon = self.context.interval_share() * MAX_INTERVAL >= 1.0;
        is_soon && self.context.previous.is_some_and(|p| p.tracked)
    }

    /// Motion from mid-exposure to the depth picture.
    fn depth_lead(&self, state: &State) -> Tangent<f64> {
        CentreVelocity::along(self.previous, state.motion.centre, self.depth_share()).velocity
    }

    /// The same as a share of the motion since the last frame, where that is known.
    fn depth_share(&self) -> f64 {
        if self.motion_is_known() { self.context.depth_lead() } else { 0.0 }
    }

    /// `κ = 2 a Δt`: the share of the frame interval for which the shutter is open.
    fn open_share(&self, state: &State) -> f64 {
        self.context.open_share(state.scale, &state.tone)
    }

    /// Lets the scale `a` follow the share that was measured, the more the longer the motion.
    fn with_learned_share(&self, mut state: State) -> State {
        let formation = self.context.formation;
        if !formation.blur || !formation.trajectory_loss || !self.motion_is_known() {
            return state;
        }
        if self.context.readout.optimised && self.virtual_cameras(0, &state) == 1 {
            // Rows of an unknown readout tell its product with the velocity alone.
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

    /// How the descent ended and how sure that is.
    fn convergence(&self, end: &Outcome) -> Convergence {
        let covariance = self.covariance(end);
        Convergence {
            converged: end.progress.converged,
            iterations: end.progress.steps,
            position_deviation: covariance.map(|c| c.position()),
            rotation_deviation: covariance.map(|c| c.rotation()),
        }
    }

    fn result(
        &self,
        state: State,
        sums: &Sums,
        convergence: Convergence,
        tracked: bool,
    ) -> TrackingResult {
        TrackingResult {
            shutter: state.motion.into(),
            readout: state.readout,
            measured_readout: tracked.then(|| self.measured_readout(&state)).flatten(),
            depth_lead: self.depth_lead(&state),
            tone: state.tone,
            response: state.response,
            scale: state.scale,
            losses: losses(sums),
            convergence,
            tracked,
        }
    }
}

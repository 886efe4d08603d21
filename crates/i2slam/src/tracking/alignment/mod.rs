//! Second-order tracking: aligns a frame to the rendered map by Levenberg-Marquardt, coarse to
//! fine.
//!
//! The map is rendered once at the predicted pose, and again where the frame turns out to be
//! elsewhere. Every step re-projects that render through the frame's depth to the virtual cameras
//! of the exposure, averages, applies the camera response and compares. The unknowns are the pose
//! at mid-exposure, the motion during the exposure, exposure, white balance and readout.

mod blur_initialization;
mod covariance;
mod levenberg_marquardt;
mod priors;
mod pyramid;
mod relocalization;
mod rolling_shutter;
mod target;

use super::context::{PredictedMotion, TrackingContext, TrackingResult, TrackingState};
use crate::objective::{FrameObjective, Observation};
use crate::reconstruction::{Convergence, FrameEstimate, Losses};
use i2slam_compute::median;
use i2slam_formation::vignetting::without_vignetting;
use i2slam_formation::{CameraResponse, CentreVelocity, ResponseCurve};
use i2slam_geometry::{Pose, Tangent};
use i2slam_odometry::alignment::{FrameLevel, ResidualSums};
use i2slam_radiance::RadianceMap;
use levenberg_marquardt::AlignmentOutcome;
use priors::{MIN_SIGMA_PX, MotionPrior};
use pyramid::frame_levels;
use std::sync::Arc;

/// Levels of the image pyramids.
const LEVELS: usize = 3;
/// Least share of the frame's depth that must lie on the map's surface; where that depth is the map's own, of
/// what can lie there.
const MIN_OVERLAP: f64 = 0.3;
/// Least share of depth that is the map's own, whatever its holes.
const MIN_HOLED_OVERLAP: f64 = 0.05;
/// Least share of the overlap that another start must keep to be preferred: a pose that sees
/// nothing has no loss.
const MIN_OVERLAP_RATIO: f64 = 0.9;
/// Last frames whose median losses are the usual ones.
const RECENT_FRAMES: usize = 20;
/// Fewer frames than these have no usual loss.
const MIN_RECENT_FRAMES: usize = 5;
/// Product of the image and depth losses over their usual values from which a pose is rejected. At
/// right poses new surfaces, glare or a jump of exposure raised one of the two up to ninefold; at
/// wrong ones both rose, together twentyfold and more.
const MAX_LOSS_RATIO: f64 = 12.0;
/// Nominal frame intervals after which the motion since the last frame no longer predicts the
/// velocity.
const MAX_GAP_INTERVALS: f64 = 3.5;
/// Least share of the picture that must have depth: a pose from one small patch slides along it.
const MIN_DEPTH_COVERAGE: f64 = 0.05;
/// Weight of the motion priors against single residuals: neighbouring pixels are not independent,
/// and a map that is still soft would otherwise be read as a still camera.
const PRIOR_WEIGHT: f64 = 200.0;
/// Depth that stands in for the median of a frame without any [m].
const DEFAULT_DEPTH: f64 = 2.0;

/// One frame to be aligned, and what its iterations share.
struct FrameAlignment<'a> {
    context: &'a TrackingContext<'a>,
    levels: Vec<FrameLevel>,
    observation: &'a Observation,
    curve: Option<ResponseCurve<f32>>,
    /// Pixels per metre and per radian, which measure tangents in pixels.
    pixels_per_unit: [f64; 6],
    previous_pose: Pose<f64>,
    /// Predicted logarithms of the white balance.
    predicted_white_balance: [f32; 3],
    /// Predicted readout [exposures].
    predicted_readout: f64,
}

/// Time since the last frame beyond which that tells nothing of the motion, as with photographs [s].
const MAX_KNOWN_GAP: f64 = 1e5;

/// Deviation of the motion during an exposure of which nothing is known, over the longer side of the
/// picture: photographs held by hand show blur of one to some percent.
const UNKNOWN_MOTION_RATIO: f64 = 0.05;

/// Motion found by comparison with other pictures below which it is not told from none [px], and its
/// deviation, which grows with its length.
const MIN_EXPOSURE_MOTION_PX: f64 = 1.0;
const EXPOSURE_MOTION_SIGMA_PX: f64 = 0.5;

/// Aligns a frame from the constant-velocity prediction or, where that end is rejected, from the
/// last pose at rest. Where both fail, and no pose was expected, the frame is relocalised against
/// the keyframes.
pub(super) fn align<M: RadianceMap>(
    context: &TrackingContext<'_>,
    objective: &mut FrameObjective<M>,
    map: &M,
    observation: &Observation,
    predicted: TrackingState,
    motion: PredictedMotion,
) -> TrackingResult {
    // Where the frame before is unknown, nothing says that the camera moves.
    let previous_pose = context.previous.map_or(predicted.motion.centre, |p| p.middle());
    let curve = predicted.response.as_ref().map(CameraResponse::curve);
    let colour = match (&curve, context.vignetting) {
        (Some(curve), Some(v)) => Arc::new(without_vignetting(&observation.colour, curve, v)),
        _ => Arc::clone(&observation.colour),
    };
    let frame = FrameAlignment {
        context,
        levels: frame_levels(context.camera, (colour, &observation.depth), LEVELS),
        observation,
        curve,
        pixels_per_unit: pixels_per_unit(context, observation),
        previous_pose,
        predicted_white_balance: predicted.tone.log_white_balance,
        predicted_readout: predicted.readout,
    };
    let lost = |sums: &ResidualSums| {
        let state = TrackingState { motion: motion.during_exposure(0.0), ..predicted.clone() };
        frame.result(state, sums, Convergence::default(), false)
    };
    let pixels = observation.depth.pixels() as f64;
    if (observation.valid_depths() as f64) < MIN_DEPTH_COVERAGE * pixels {
        return lost(&ResidualSums::default());
    }
    let first = frame.optimize(objective, map, predicted.clone());
    if frame.is_accepted(&first) {
        let convergence = frame.convergence(&first);
        let state = frame.with_measured_scale(first.state);
        return frame.result(state, &first.sums, convergence, true);
    }
    let still = frame.optimize(objective, map, predicted.at_rest(previous_pose));
    let found = match frame.is_accepted(&still) {
        true => Some(still),
        false if context.expected.is_some() => None,
        false => frame.relocalize(objective, map, &predicted),
    };
    let Some(found) = found else { return lost(&first.sums) };
    let convergence = frame.convergence(&found);
    frame.result(found.state, &found.sums, convergence, true)
}

fn mean_losses(sums: &ResidualSums) -> Losses {
    let errors = &sums.errors;
    Losses {
        image: errors.image / errors.image_count.max(1) as f64,
        depth: errors.depth / errors.depth_count.max(1) as f64,
        trajectory: 0.0,
    }
}

/// Image motion [px] per metre and per radian of camera motion, at the frame's median depth.
fn pixels_per_unit(context: &TrackingContext<'_>, observation: &Observation) -> [f64; 6] {
    let mut depths: Vec<f32> =
        observation.depth.data.iter().copied().step_by(7).filter(|&d| d > 0.0).collect();
    let depth = median(&mut depths).map_or(DEFAULT_DEPTH, f64::from);
    let focal = context.camera.fx;
    let metre = focal / depth;
    [metre, metre, metre, focal, focal, focal]
}

impl FrameAlignment<'_> {
    /// Optimises from `start`; where the motion before is unknown, once more with the initial blur
    /// that suits the picture best, and keeps the better end.
    fn optimize<M: RadianceMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        start: TrackingState,
    ) -> AlignmentOutcome {
        let end = self.coarse_to_fine(objective, map, start);
        let is_known = self.has_measured_motion() || self.exposure_motion().is_some();
        if is_known || !self.sees_map(&end) {
            return end;
        }
        let Some(blurred) = self.with_initial_blur(objective, map, &end.state) else { return end };
        let moving = self.coarse_to_fine(objective, map, blurred);
        let sees_as_much = moving.sums.overlap() >= MIN_OVERLAP_RATIO * end.sums.overlap();
        match sees_as_much && mean_losses(&moving.sums).image < mean_losses(&end.sums).image {
            true => moving,
            false => end,
        }
    }

    /// Acceptance test: enough of the frame lies on the map, and its losses are near the usual
    /// ones. A frame at a wrong pose would spoil the map.
    fn is_accepted(&self, end: &AlignmentOutcome) -> bool {
        let losses = mean_losses(&end.sums);
        let depth_ratio = match self.observation.is_estimated() {
            true => 1.0,
            false => self.ratio_to_usual(&losses, |losses| losses.depth),
        };
        let loss_ratio = self.ratio_to_usual(&losses, |losses| losses.image) * depth_ratio;
        self.sees_map(end) && loss_ratio < MAX_LOSS_RATIO
    }

    /// Overlap test: true if enough of the frame's depth lies on the map's surface. The depth of a frame that is
    /// localised is the map's own, with its holes.
    fn sees_map(&self, end: &AlignmentOutcome) -> bool {
        let least = match self.context.expected {
            Some(_) => {
                let surface = end.targets[0].levels[0].surface_pixels();
                let depths = self.observation.valid_depths().max(surface).max(1);
                (MIN_OVERLAP * surface as f64 / depths as f64).max(MIN_HOLED_OVERLAP)
            }
            None => MIN_OVERLAP,
        };
        end.sums.overlap() >= least
    }

    /// A loss over its median in the last tracked frames; 1 where these are too few. The first
    /// frame was not aligned and does not count.
    fn ratio_to_usual(&self, losses: &Losses, loss: impl Fn(&Losses) -> f64) -> f64 {
        let aligned = self.context.frames.iter().skip(1).rev().filter(|f| f.tracked);
        let mut recent: Vec<f64> = aligned.take(RECENT_FRAMES).map(|f| loss(&f.losses)).collect();
        match median(&mut recent) {
            Some(usual) if recent.len() >= MIN_RECENT_FRAMES && usual > 0.0 => loss(losses) / usual,
            _ => 1.0,
        }
    }

    fn motion_prior(&self, state: &TrackingState) -> MotionPrior {
        let observed = self.context.timestamps.0;
        let pixels_per_unit = self.pixels_per_unit;
        if let Some(step) = self.exposure_motion() {
            let (sigma_at_rest, weight) = (EXPOSURE_MOTION_SIGMA_PX, PRIOR_WEIGHT);
            return MotionPrior { pixels_per_unit, step, share: 1.0, sigma_at_rest, weight };
        }
        let is_near = |last: &&FrameEstimate| observed - last.timestamp <= MAX_KNOWN_GAP;
        if self.context.previous.filter(is_near).is_none() {
            let sigma_at_rest = UNKNOWN_MOTION_RATIO
                * self.context.camera.width.max(self.context.camera.height) as f64;
            let step = Tangent::zero();
            let weight = PRIOR_WEIGHT;
            return MotionPrior { pixels_per_unit, step, share: 0.0, sigma_at_rest, weight };
        }
        let is_free = !self.context.config.formation.trajectory_loss || !self.has_measured_motion();
        MotionPrior {
            pixels_per_unit,
            step: CentreVelocity::along(self.previous_pose, state.motion.centre, 1.0).velocity,
            share: self.open_share(state) * self.context.interval_ratio(),
            sigma_at_rest: MIN_SIGMA_PX,
            weight: if is_free { 1e-3 } else { PRIOR_WEIGHT },
        }
    }

    /// The motion found by comparison with other pictures, where it is longer than its error.
    fn exposure_motion(&self) -> Option<Tangent<f64>> {
        let found = self.context.exposure_motion;
        found.filter(|motion| self.norm_in_pixels(*motion) >= MIN_EXPOSURE_MOTION_PX)
    }

    /// Whether the last frame was tracked, and is so recent that the motion since then predicts the
    /// velocity.
    fn has_measured_motion(&self) -> bool {
        let is_recent = self.context.interval_ratio() * MAX_GAP_INTERVALS >= 1.0;
        is_recent && self.context.previous.is_some_and(|p| p.tracked)
    }

    /// Motion from mid-exposure to the depth picture.
    fn depth_offset(&self, state: &TrackingState) -> Tangent<f64> {
        let ratio = self.depth_offset_ratio();
        CentreVelocity::along(self.previous_pose, state.motion.centre, ratio).velocity
    }

    /// [`depth_offset`](Self::depth_offset) over the motion since the last frame; 0 where that is
    /// unknown.
    fn depth_offset_ratio(&self) -> f64 {
        if self.has_measured_motion() { self.context.depth_delay_ratio() } else { 0.0 }
    }

    /// `κ = 2 a Δt`: the share of the frame interval for which the shutter is open.
    fn open_share(&self, state: &TrackingState) -> f64 {
        self.context.open_share(state.scale, &state.tone)
    }

    /// Moves the trajectory scale `a` towards the open share that the blur shows, the more the
    /// longer the motion.
    fn with_measured_scale(&self, mut state: TrackingState) -> TrackingState {
        let formation = &self.context.config.formation;
        if !formation.blur || !formation.trajectory_loss || !self.has_measured_motion() {
            return state;
        }
        if self.context.readout.optimised && self.virtual_cameras(0, &state) == 1 {
            // Without blur, rows show only the product of an unknown readout and the velocity.
            return state;
        }
        let (share, motion) = self.motion_prior(&state).measured_share(state.motion.velocity);
        // Half trust at a motion of 20 px.
        let trust = motion * motion / (motion * motion + 400.0);
        let share = (share / self.context.interval_ratio()).clamp(0.02, 1.0);
        let ratio = (share / self.open_share(&state)).ln();
        state.scale.a *= (0.5 * trust * ratio).exp();
        state
    }

    fn norm_in_pixels(&self, tangent: Tangent<f64>) -> f64 {
        let values = tangent.to_array();
        values.iter().zip(self.pixels_per_unit).map(|(v, p)| (v * p).powi(2)).sum::<f64>().sqrt()
    }

    fn convergence(&self, end: &AlignmentOutcome) -> Convergence {
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
        state: TrackingState,
        sums: &ResidualSums,
        convergence: Convergence,
        tracked: bool,
    ) -> TrackingResult {
        TrackingResult {
            shutter: state.motion.into(),
            readout: state.readout,
            measured_readout: tracked.then(|| self.measured_readout(&state)).flatten(),
            depth_offset: self.depth_offset(&state),
            tone: state.tone,
            response: state.response,
            scale: state.scale,
            losses: mean_losses(sums),
            convergence,
            tracked,
        }
    }
}

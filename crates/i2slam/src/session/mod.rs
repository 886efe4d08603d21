//! Sessions: frames or keyframes go in one by one, a reconstruction comes out.

mod calibration;
mod correction;
mod error;
mod frame_tracker;
mod online;
mod posed;
mod runtime_estimate;
mod state;
mod tracked;

pub use error::SessionError;
pub(crate) use online::{MappedFrames, OnlineMapping};
pub use online::{MappingPanicked, OnlineError, OnlineSession, OnlineUpdate};
pub use runtime_estimate::RuntimeEstimate;
pub(crate) use state::scratch_store;

use crate::config::{Config, MapKind, MappingConfig};
use crate::mapping::{
    FieldMapper, GaussianMapper, Growth, JointFieldMapper, Keyframe, Mapper, MappingContext,
    RefinementStep, is_comparison_due,
};
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::tracking::SequenceReadout;
use crate::warning::Warning;
use frame_tracker::FrameTracker;
use i2slam_compute::CancellationToken;
use i2slam_geometry::{Camera, Image};
use i2slam_radiance::hashgrid::SettingsError;
use posed::SourcePoses;
use state::SessionState;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Called after every step of the final refinement with the steps done and in total, and with what
/// copies everything estimated so far; returns whether to continue.
pub(crate) type OnWatchedStep<'a> =
    &'a mut dyn FnMut(usize, usize, &dyn Fn() -> Reconstruction) -> bool;

/// SLAM on one sequence.
///
/// Frames with depth are [tracked](Self::track) against the map, whose poses stay then. Keyframes
/// with poses of another source are [added](Self::add_keyframe) and refined together with the map,
/// and the frames between them [localised](Self::localize) in it after
/// [`finish`](Self::finish).
pub struct Session {
    config: Config,
    camera: Camera<f64>,
    frame_rate: f64,
    mapper: Box<dyn Mapper>,
    state: SessionState,
    tracker: FrameTracker,
    /// Poses as they came; `None` where frames are tracked and their poses stay.
    source: Option<SourcePoses>,
    /// True if a setting gives the readout of a rolling shutter, or asks for its estimate.
    is_readout_given: bool,
    /// True if frames are photographs.
    is_unordered: bool,
    /// Whether a frame without a depth picture was warned of.
    is_missing_depth_told: bool,
    failure: Option<SettingsError>,
}

impl Session {
    /// A session that tracks frames of `camera` at `frame_rate` frames per second.
    pub fn tracking(config: Config, camera: Camera<f64>, frame_rate: f64) -> Self {
        let mapper: Box<dyn Mapper> = match config.map.kind {
            MapKind::Gaussian => Box::new(GaussianMapper::new(&config, &camera)),
            MapKind::HashGrid => Box::new(FieldMapper::new(&camera)),
        };
        Self::new(config, camera, frame_rate, mapper)
    }

    /// A session on keyframes of `camera` that come with poses, taken from a video of `frame_rate`
    /// frames per second.
    ///
    /// The world is the camera of the first keyframe. In `default` poses at mid-exposure stay as they
    /// came, and the motion during the exposure is refined with the map; the paper's presets for
    /// colour alone refine both.
    pub fn refining(config: Config, camera: Camera<f64>, frame_rate: f64) -> Self {
        let mapper: Box<dyn Mapper> = match config.map.kind {
            MapKind::Gaussian => Box::new(GaussianMapper::new(&config, &camera)),
            MapKind::HashGrid => Box::new(JointFieldMapper::new(&camera, frame_rate)),
        };
        let mut session = Self::new(config, camera, frame_rate, mapper);
        session.source = Some(SourcePoses::default());
        session.state.warnings.extend(unused_setting(&session.config));
        session
    }

    fn new(config: Config, camera: Camera<f64>, frame_rate: f64, mapper: Box<dyn Mapper>) -> Self {
        Self {
            mapper,
            state: SessionState::new(&config),
            tracker: FrameTracker::new(frame_rate, &config.input),
            source: None,
            is_readout_given: config.input.is_rolling(),
            is_unordered: false,
            is_missing_depth_told: false,
            failure: None,
            config,
            camera,
            frame_rate,
        }
    }

    /// Restricts the image terms to recorded pixels, a mask such as `Sequence::valid_mask`.
    pub fn set_valid_mask(&mut self, valid_mask: Arc<Image<bool>>) {
        self.mapper.set_valid_mask(Arc::clone(&valid_mask));
        self.state.valid_mask = Some(valid_mask);
    }

    /// Sets the token whose cancellation ends mapping and first-order tracking of a frame early.
    pub fn set_cancellation(&mut self, cancellation: CancellationToken) {
        self.state.cancellation = cancellation;
    }

    /// Sets the frame rate [1/s] of a map of Gaussians before its first frame.
    pub(crate) fn set_frame_rate(&mut self, frame_rate: f64) {
        self.frame_rate = frame_rate;
        self.tracker = FrameTracker::new(frame_rate, &self.config.input);
    }

    /// Sets the folder for a file of pictures that are beyond `memory`, before the first frame. It is
    /// that of the system for temporary files otherwise.
    pub fn set_scratch_folder(&mut self, folder: &Path) {
        self.state.scratch = scratch_store(&self.config, folder);
    }

    /// Final optimisation over all keyframes; stops when `on_step(done, total)` returns false.
    pub fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        self.finish_watched(&mut |done, of, _| on_step(done, of));
    }

    /// [`finish`](Self::finish) with a copy of everything estimated so far after every step, for those
    /// who want it.
    pub(crate) fn finish_watched(&mut self, on_step: OnWatchedStep<'_>) {
        if self.state.keyframes.is_empty() || self.failure.is_some() {
            return;
        }
        if let Err(error) = self.refine_all(on_step) {
            self.state.warnings.push(format!("the map is empty: {error}").into());
            self.failure = Some(error);
        }
        if self.source.is_some() {
            self.state.warn_of_keyframes_not_found();
        }
        self.state.warn_of_scratch();
    }

    /// Frames so far, in order of their index.
    pub fn frames(&self) -> &[FrameEstimate] {
        &self.state.frames
    }

    /// True if the `number`-th frame or keyframe, from 0, of this index is held out
    /// (`mapping.hold_out`, `mapping.hold_out_frames`).
    pub fn holds_out(&self, number: usize, index: usize) -> bool {
        self.config.mapping.holds_out(number, index)
    }

    /// Sets the readout that the source of the poses has found [s], unless a setting gives it.
    pub(crate) fn set_found_readout(&mut self, seconds: f64) {
        if !self.is_readout_given {
            self.config.input.rolling_shutter_readout = 0.0;
            self.config = self.config.clone().with_found_readout(seconds);
            self.tracker.readout = SequenceReadout::new(&self.config.input);
        }
    }

    /// Sets whether the keyframes are photographs: nothing is told of their motion by those before and after
    /// them in time.
    pub(crate) fn set_unordered(&mut self, is_unordered: bool) {
        self.is_unordered = is_unordered;
        self.tracker.moves_held_out = is_unordered;
        self.config.formation.trajectory_loss &= !is_unordered;
    }

    /// Shares the steps that a configuration gives `keyframes` among `count` frames.
    pub(crate) fn share_steps(&mut self, config: &Config, keyframes: usize, count: usize) {
        let steps = config.mapping.iterations * keyframes;
        self.config.mapping.iterations = steps.div_ceil(count.max(1));
    }

    /// Settings of mapping.
    pub(crate) fn mapping_settings(&self) -> &MappingConfig {
        &self.config.mapping
    }

    /// Whether the readout of a rolling shutter was to be found, and no frame has measured it.
    pub(crate) fn is_readout_missing(&self) -> bool {
        let readout = &self.tracker.readout;
        self.source.is_none() && readout.optimised && !readout.is_measured()
    }

    /// Takes the warnings since the last call.
    pub fn take_warnings(&mut self) -> Vec<Warning> {
        std::mem::take(&mut self.state.warnings)
    }

    /// A copy of everything estimated so far.
    pub fn reconstruction(&self) -> Reconstruction {
        let readout = self.tracker.readout.seconds;
        self.state.reconstruction(&self.config, &self.camera, self.mapper.map(), readout)
    }

    /// Extends the map by a frame, and refines it for some steps.
    fn map(&mut self, current: &Keyframe) -> Result<(), SessionError> {
        let (mapper, _, mut context) = self.mapping();
        match mapper.add(&mut context, current) {
            Ok(Growth::Waiting) => Ok(()),
            Ok(growth) => {
                mapper.refine(&mut context, current, growth);
                if is_comparison_due(&context, current) {
                    self.calibrate_light();
                }
                Ok(())
            }
            Err(source) => {
                self.failure = Some(source);
                Err(SessionError::Map { source })
            }
        }
    }

    /// Final steps over all keyframes; where their poses are refined, in parts between which all are
    /// localised again.
    fn refine_all(&mut self, on_step: OnWatchedStep<'_>) -> Result<(), SettingsError> {
        let (refines_poses, is_unordered) = (self.source.is_some(), self.is_unordered);
        let (mapper, _, mut context) = self.mapping();
        if is_unordered {
            // Others have come since that see the same places from elsewhere.
            mapper.remove_contradicted(&context);
        }
        let plan = mapper.plan_final(&mut context)?;
        if refines_poses && mapper.is_empty() {
            let reason =
                "the map is empty: no keyframe came with a depth, which Gaussians begin on";
            context.warnings.push(reason.into());
        }
        let relocalizations = if refines_poses { plan.relocalizations } else { 0 };
        let part = plan.steps.div_ceil(relocalizations + 1);
        for round in 0..=relocalizations {
            let first = (round * part).min(plan.steps);
            let steps = first..(first + part).min(plan.steps);
            self.find_motions();
            self.calibrate_light();
            let vignetting = self.state.lens_vignetting();
            let (mapper, tracker, mut context) = self.mapping();
            let setup = (context.config, context.camera);
            let lens = (vignetting, tracker.readout.seconds);
            let mut on_step = |step: RefinementStep<'_>| {
                let estimates = (step.frames, step.responses);
                let copy = || state::reconstruction(setup, estimates, (step.map)(), lens);
                on_step(step.done, step.of, &copy)
            };
            if !mapper.refine_all(&mut context, (steps, plan.steps), &mut on_step) {
                break;
            }
            if round < relocalizations {
                tracker.relocalize(mapper, &mut context);
                mapper.correct(&context, &BTreeMap::new());
            }
        }
        Ok(())
    }

    fn mapping(&mut self) -> (&mut dyn Mapper, &mut FrameTracker, MappingContext<'_>) {
        let context = self.state.mapping_context(&self.config, &self.camera);
        (self.mapper.as_mut(), &mut self.tracker, context)
    }
}

/// Warns of a changed setting that has no effect where poses are refined.
fn unused_setting(config: &Config) -> Option<Warning> {
    let preset = Config::preset(&config.preset).ok()?.formation.quadrature;
    let is_field = config.map.kind == MapKind::HashGrid;
    (is_field && preset != config.formation.quadrature).then(|| {
        "`formation.quadrature` has no effect here: the moments of the exposure are drawn at \
         random within equal parts of it"
            .into()
    })
}

#[cfg(test)]
mod late_frame_tests;
#[cfg(test)]
mod photograph_tests;
#[cfg(test)]
mod posed_tests;
#[cfg(test)]
mod tracked_tests;

//! Loop over the frames or keyframes of any source of poses, from the first to the finished map.

use super::error::{RunError, catch_panic};
use super::input::{FRAMES, Input, Item, ItemKind};
use super::observer::RunContext;
use super::{PoseSource, RunOptions, RunOutcome, Stage, shortfall};
use crate::config::{HoldOut, Parameters, TrackingMethod};
use crate::keyframes::{PictureError, PosedKeyframe};
use crate::reconstruction::{FrameEstimate, Reconstruction, UnitOfLength};
use crate::session::{MappedFrames, Session, SessionError};
use crate::warning::Warning;
use i2slam_dataset::Sequence;
use i2slam_geometry::Camera;
use i2slam_odometry::PoseDeviation;
use std::collections::{BTreeMap, VecDeque};
use std::fmt::Display;
use std::sync::Arc;
use std::time::Instant;

/// Maps all items of the input that `open` gives until they end or the run is cancelled. An
/// unreadable one is left out with a warning.
pub(super) fn run<'a>(
    sequence: &'a Sequence,
    options: &RunOptions,
    context: &RunContext,
    open: impl FnOnce() -> Result<Input<'a>, RunError>,
) -> Result<RunOutcome, RunError> {
    let started = Instant::now();
    let mut driver = Driver::new(catch_panic(open)?, sequence, options, context);
    let problem = driver.map_all();
    if driver.session.frames().is_empty() {
        return Err(driver.nothing(problem));
    }
    Ok(driver.into_outcome(problem, options, started))
}

/// Poses that stayed as their source gave them have its deviations: localisation in the map measured
/// something else.
fn claim_deviations(found: &mut Reconstruction, deviations: &BTreeMap<usize, PoseDeviation>) {
    for frame in &mut found.frames {
        let claimed = deviations.get(&frame.index);
        frame.convergence.converged = claimed.is_some_and(|d| d.converged);
        frame.convergence.position_deviation = claimed.map(|d| d.position);
        frame.convergence.rotation_deviation = claimed.map(|d| d.rotation);
    }
}

/// A session of a source whose frames are all still to come, on a camera and a frame rate; a sequence
/// has the mask.
pub(super) fn new_session(
    kind: &ItemKind,
    options: &RunOptions,
    context: &RunContext,
    ((camera, frame_rate), sequence): ((Camera<f64>, f64), &Sequence),
) -> Session {
    let mut config = options.config.clone();
    if kind.stage == Stage::Frames && config.tracking.method == TrackingMethod::SecondOrder {
        config.parameters = Parameters::tracked();
        // Flat Gaussians lost frames of small pictures after few steps; larger ones were not tried.
        config.map.isotropic = true;
    }
    let mut session = (kind.session)(config, camera, frame_rate);
    session.set_cancellation(context.cancellation.clone());
    session.set_scratch_folder(&options.scratch_folder);
    if let Some(valid_mask) = &sequence.valid_mask {
        session.set_valid_mask(Arc::clone(valid_mask));
    }
    session
}

/// Held-out items: by the count of frames where the front end avoids these as keyframes, else by their own.
fn hold_out(options: &RunOptions, input: &Input<'_>, sequence: &Sequence) -> HoldOut {
    let mapping = &options.config.mapping;
    match input.counts_frames(options) {
        true => HoldOut::of_frames(mapping, sequence.entries.iter().map(|entry| entry.index)),
        false => HoldOut::new(mapping),
    }
}

struct Driver<'a, 'b> {
    session: Session,
    input: Input<'a>,
    context: &'b RunContext,
    /// Frames in the map that came before the items.
    before: usize,
    /// Which keyframes are kept from the map.
    hold_out: HoldOut,
    /// Keyframes kept from the map, in order.
    held_out: VecDeque<PosedKeyframe>,
    skipped: usize,
    first_error: Option<String>,
    /// The last frame that was processed.
    latest: Option<FrameEstimate>,
    /// True if no front end has given poses before.
    is_source_of_poses: bool,
}

impl<'a, 'b> Driver<'a, 'b> {
    fn new(
        mut input: Input<'a>,
        sequence: &Sequence,
        options: &RunOptions,
        context: &'b RunContext,
    ) -> Self {
        let (mut session, hold_out, before, errors) = match input.mapped.take() {
            Some(MappedFrames { session, hold_out, current, errors, .. }) => {
                (session, hold_out, current.len(), errors)
            }
            None => {
                let pictures = input.undistorted.as_ref().unwrap_or(sequence);
                let source = ((input.camera, input.frame_rate), pictures);
                let session = new_session(input.kind, options, context, source);
                (session, hold_out(options, &input, sequence), 0, Vec::new())
            }
        };
        context.observer.progress(input.stage(before), before, before + input.count);
        session.set_found_readout(input.readout);
        session.set_unordered(input.is_unordered);
        session.share_steps(&options.config, input.keyframes, before + input.count);
        let mut driver = Self {
            session,
            input,
            context,
            before,
            hold_out,
            held_out: VecDeque::new(),
            skipped: 0,
            first_error: None,
            latest: None,
            is_source_of_poses: options.poses == PoseSource::Map,
        };
        errors.iter().for_each(|error| driver.leave_out(error));
        driver
    }
}

impl Driver<'_, '_> {
    /// Maps all items and refines the map; returns the error that ended it early, if any.
    fn map_all(&mut self) -> Option<RunError> {
        let problem = self.attempt(Self::process_all);
        let is_cancelled = self.context.cancellation.is_cancelled();
        if problem.is_some() || is_cancelled || self.session.frames().is_empty() {
            return problem;
        }
        self.attempt(Self::finish)
    }

    /// Takes a step and returns its error; after cancellation, frames not processed keep their known poses.
    fn attempt(
        &mut self,
        step: impl FnOnce(&mut Self) -> Result<(), RunError>,
    ) -> Option<RunError> {
        let problem = catch_panic(|| step(self)).err();
        if self.context.cancellation.is_cancelled() {
            self.keep_unprocessed();
        }
        problem
    }

    /// The result of a session with frames, which `problem` ended early if there is one.
    fn into_outcome(
        mut self,
        problem: Option<RunError>,
        options: &RunOptions,
        started: Instant,
    ) -> RunOutcome {
        self.pass_warnings_on();
        let complete = problem.is_none() && !self.context.cancellation.is_cancelled();
        let shortfalls = if complete { self.shortfalls(options) } else { Vec::new() };
        let Self { session, input, skipped, .. } = self;
        let mut reconstruction = session.reconstruction();
        reconstruction.online_trajectory = input.path.online;
        if matches!(options.poses, PoseSource::Files { .. }) {
            reconstruction.unit_of_length = UnitOfLength::Keyframes;
        }
        // As set: a run from its own configuration would share the steps a second time.
        reconstruction.config.mapping.iterations = options.config.mapping.iterations;
        let keeps_poses = reconstruction.config.parameters.frames.keeps_middle;
        if keeps_poses && !input.path.deviations.is_empty() {
            claim_deviations(&mut reconstruction, &input.path.deviations);
        }
        RunOutcome {
            reconstruction,
            frames_given: input.frames_given,
            is_unordered: input.is_unordered,
            frames_skipped: skipped,
            seconds: started.elapsed().as_secs_f64(),
            complete,
            problem,
            shortfalls,
            camera: input.estimate,
            camera_source: input.camera_source,
            undistorted: input.undistorted,
            warnings: Vec::new(),
        }
    }

    /// Reasons for which a complete result is not what was asked for.
    fn shortfalls(&self, options: &RunOptions) -> Vec<String> {
        let Self { session, input, .. } = self;
        let number = match input.kind.stage {
            Stage::Frames => session.frames().len(),
            _ => self.hold_out.frames(),
        };
        let item = if input.counts_frames(options) { FRAMES.name } else { input.kind.name };
        let of_holding_out = shortfall::of_holding_out(session.mapping_settings(), (number, item));
        let of_readout = shortfall::of_readout(session.is_readout_missing());
        // Where the frames between keyframes are localised, too, their tracking tells.
        let is_path =
            input.estimate.is_some() && options.config.tracking.method == TrackingMethod::Adam;
        let given = (input.frames_given, input.is_unordered);
        let few_poses = is_path.then(|| shortfall::of_path(input.path.poses.len(), given));
        of_holding_out.into_iter().chain(of_readout).chain(few_poses.flatten()).collect()
    }

    fn process_all(&mut self) -> Result<(), RunError> {
        let items = std::mem::replace(&mut self.input.items, Box::new(std::iter::empty()));
        let before = self.before;
        for (done, item) in items.enumerate() {
            if self.context.cancellation.is_cancelled() {
                return Ok(());
            }
            match item {
                Ok(item) => self.process(item)?,
                Err(error) => self.leave_out(&error),
            }
            if let Some(estimate) = &self.latest {
                self.context.observer.frame(estimate, before + done + 1, before + self.input.count);
                self.context.observer.map(&|| self.session.reconstruction());
            }
        }
        Ok(())
    }

    fn process(&mut self, item: Item) -> Result<(), RunError> {
        let (processed, of_file) = match item {
            Item::Frame(frame) => {
                let processed = self.session.track(&frame).cloned();
                let found = processed.as_ref().ok().filter(|found| found.tracked);
                if let Some(found) = found.filter(|_| self.is_source_of_poses) {
                    self.context.observer.pose(&found.stamped_pose());
                }
                (
                    processed,
                    frame.warnings.iter().map(|w| Warning::of_frame(frame.index, w)).collect(),
                )
            }
            Item::Keyframe(keyframe) => {
                if self.hold_out.decide(keyframe.index) {
                    self.held_out.push_back(*keyframe);
                    return Ok(());
                }
                (self.session.add_keyframe(*keyframe).cloned(), Vec::new())
            }
        };
        match processed {
            Ok(estimate) => self.latest = Some(estimate),
            // No later frame can start the map either.
            Err(error @ SessionError::Map { .. }) => return Err(error.into()),
            Err(error) => self.leave_out(&error),
        }
        let mut warnings: Vec<Warning> = self.session.take_warnings();
        if warnings.is_empty() {
            warnings = of_file;
        }
        warnings.into_iter().for_each(|warning| self.context.warn(warning));
        Ok(())
    }

    fn leave_out(&mut self, error: &dyn Display) {
        self.context.warn(format!("{} left out: {error}", self.input.kind.name));
        self.skipped += 1;
        self.first_error.get_or_insert_with(|| error.to_string());
    }

    /// Refines the map after the last item, then localises all frames with poses that it was not made
    /// of.
    fn finish(&mut self) -> Result<(), RunError> {
        let count = self.held_out.len() + self.input.between.len();
        let (mut done, mut steps, mut goes_on) = (0, 0, true);
        let (context, stage) = (self.context, self.input.kind.last_stage);
        let on_step = |done: usize, of: usize| {
            context.observer.progress(stage, done, of);
            !context.cancellation.is_cancelled()
        };
        self.session.finish_watched(&mut |step, of, current| {
            (done, steps) = (step, of);
            context.observer.map(current);
            goes_on = on_step(step, of + count);
            goes_on
        });
        while goes_on {
            let next = self.held_out.pop_front().map(Ok).or_else(|| self.input.between.next());
            let Some(frame) = next else { break };
            self.localize(frame);
            done += 1;
            goes_on = on_step(done, steps + count);
        }
        Ok(())
    }

    /// Localises a frame in the finished map; one that cannot be used is left out with a warning.
    fn localize(&mut self, frame: Result<PosedKeyframe, PictureError>) {
        let located = frame.and_then(|frame| Ok(self.session.localize(frame).map(|_| ())?));
        if let Err(reason) = located {
            self.context.warn(format!("frame left out: {reason}"));
        }
    }

    /// Adds the poses that are known of frames not processed, after cancellation.
    fn keep_unprocessed(&mut self) {
        let path = std::mem::take(&mut self.input.path.poses).into_iter();
        let kept = path
            .filter(|(index, stamp, pose)| self.session.insert_unrefined(*index, *stamp, *pose));
        let count = kept.count();
        if count > 0 {
            let have = if count == 1 { "frame has" } else { "frames have" };
            self.context.warn(format!(
                "ended early: {count} {have} a pose, but neither exposure nor motion blur was estimated"
            ));
        }
    }

    fn pass_warnings_on(&mut self) {
        let warnings = self.session.take_warnings().into_iter();
        warnings.for_each(|warning| self.context.warn(warning));
    }

    /// Error of a run without a single frame.
    fn nothing(self, problem: Option<RunError>) -> RunError {
        if self.context.cancellation.is_cancelled() {
            return RunError::Cancelled { before: self.input.kind.first };
        }
        let reason = problem.map(|error| error.to_string()).or(self.first_error);
        RunError::NoUsableFrame {
            what: self.input.none_usable(),
            reason: reason.unwrap_or_else(|| "there are none".to_owned()),
        }
    }
}

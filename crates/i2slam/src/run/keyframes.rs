//! Keyframes with poses, found by visual odometry or imported, mapped one by one; then the frames
//! between them are localised in the finished map.

use super::camera::CameraEstimate;
use super::error::{RunError, catch_panic};
use super::forecast::Forecaster;
use super::observer::{Observer, RunContext, Stage};
use super::runner::{self, FrameConsumer};
use super::{RunOptions, RunOutcome, shortfall};
use crate::config::{MappingConfig, TrackingMethod};
use crate::keyframes::{
    self, ImportDepth, ImportOptions, Intrinsics, KeyframeSource, MonocularError, MonocularSource,
    OdometryError, OdometryProgress, OdometryWarning, PictureError, PosedKeyframe, RefinedImport,
    import,
};
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::session::{Session, SessionError};
use crate::warning::Warning;
use i2slam_dataset::import::ImportedKeyframes;
use i2slam_dataset::{Frame, Sequence};
use i2slam_geometry::Pose;
use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::Instant;

/// Longer side of the pictures for visual odometry, where they were recorded so large [px]:
/// smaller ones, which a map may be made of, locate points less exactly.
const ODOMETRY_SIDE: usize = 640;

/// Width and height of the pictures of a sequence that visual odometry sees [px]: larger than
/// those delivered where these are small.
pub fn odometry_size(sequence: &Sequence) -> (usize, usize) {
    let camera = sequence.at_least(ODOMETRY_SIDE).camera;
    (camera.width, camera.height)
}

/// Frames with poses between keyframes, in order.
type BetweenFrames = Box<dyn ExactSizeIterator<Item = Result<PosedKeyframe, PictureError>>>;

/// Keyframes ready to be mapped.
pub(super) struct KeyframeInput {
    source: Box<dyn KeyframeSource>,
    count: usize,
    between: BetweenFrames,
    /// Index, stamp [s] and pose of all frames that have one.
    path: Vec<(usize, f64, Pose<f64>)>,
    /// Frames of the sequence, those without a pose included.
    frames_given: usize,
    frame_rate: f64,
    camera: Option<CameraEstimate>,
    undistorted: Option<Sequence>,
}

/// Maps every keyframe that `open` gives.
pub(super) fn run(
    sequence: &Sequence,
    options: &RunOptions,
    context: &RunContext,
    open: impl FnOnce() -> Result<KeyframeInput, RunError>,
) -> Result<RunOutcome, RunError> {
    let started = Instant::now();
    let input = catch_panic(open)?;
    let KeyframeInput { mut source, count, between, path, frames_given, frame_rate, .. } = input;
    let KeyframeInput { camera, undistorted, .. } = input;
    context.observer.progress(Stage::Keyframes, 0, count);
    let config = options.config.clone().with_found_readout(source.readout());
    let mut session = Session::refining(config, *source.camera(), frame_rate);
    session.set_cancellation(context.cancellation.clone());
    if let Some(valid_mask) = &undistorted.as_ref().unwrap_or(sequence).valid_mask {
        session.set_valid_mask(Arc::clone(valid_mask));
    }
    let items = std::iter::from_fn(|| source.next_keyframe());
    // Where the frames between keyframes are localised, too, their tracking tells.
    let has_path = camera.is_some() && options.config.tracking.method == TrackingMethod::Adam;
    let few_poses = has_path.then(|| shortfall::of_path(path.len(), frames_given)).flatten();
    let (mapping, held_out) = (options.config.mapping.clone(), VecDeque::new());
    let (position, warnings) = (0, Vec::new());
    let consumer =
        KeyframeConsumer { session, mapping, between, position, held_out, path, warnings };
    let none_usable = "no keyframe could be used";
    let outcome = runner::run(consumer, items, count, (started, none_usable), context)?;
    let few_poses = few_poses.filter(|_| outcome.complete);
    let shortfalls = outcome.shortfalls.into_iter().chain(few_poses).collect();
    Ok(RunOutcome { camera, undistorted, frames_given, shortfalls, ..outcome })
}

/// Finds the path of the camera from the pictures, with dense depth of the keyframes, and their
/// lens distortion if asked.
pub(super) fn from_odometry(
    sequence: &Sequence,
    estimate_distortion: bool,
    options: &RunOptions,
    context: &RunContext,
) -> Result<KeyframeInput, RunError> {
    let size = (sequence.camera.width, sequence.camera.height);
    let found = find_path(sequence, estimate_distortion, options, context)?
        .with_pictures(size, |place| picture(sequence, place));
    let camera = CameraEstimate::new(sequence, found.reconstruction());
    context.observer.camera(&camera);
    let undistorted = camera.lens.as_ref().map(|lens| sequence.with_estimated_camera(lens));
    path_warnings(sequence, &found).into_iter().for_each(|warning| context.warn(warning));
    if let Some(sequence) = &undistorted {
        sequence.warnings.iter().for_each(|warning| context.warn(warning.as_str()));
    }
    let pictures = Arc::new(undistorted.as_ref().unwrap_or(sequence).clone());
    let others = Arc::clone(&pictures);
    let source = found.with_pictures(size, move |place| picture(&pictures, place));
    let (count, between) = (
        source.reconstruction().keyframes.len(),
        source.non_keyframes(move |place| picture(&others, place)),
    );
    let by_index = |(place, stamp, pose): (usize, f64, Pose<f64>)| {
        Some((sequence.entries.get(place)?.index, stamp, pose))
    };
    let path = source.trajectory().into_iter().filter_map(by_index).collect();
    // The paper's system has poses of keyframes alone.
    let between: BetweenFrames = match options.config.tracking.method {
        TrackingMethod::SecondOrder => Box::new(between),
        TrackingMethod::Adam => Box::new(std::iter::empty()),
    };
    Ok(KeyframeInput {
        source: Box::new(source.with_dense_depth(context.cancellation.clone())),
        count,
        between,
        path,
        frames_given: sequence.len(),
        frame_rate: sequence.frame_rate,
        camera: Some(camera),
        undistorted,
    })
}

/// Finds the path of the camera in the pictures at [`odometry_size`], as they were recorded.
fn find_path(
    sequence: &Sequence,
    estimate_distortion: bool,
    options: &RunOptions,
    context: &RunContext,
) -> Result<MonocularSource<impl FnMut(usize) -> Result<Frame, PictureError> + use<>>, RunError> {
    let large = sequence.at_least(ODOMETRY_SIDE);
    let intrinsics = match (sequence.camera_is_guess, estimate_distortion) {
        (true, true) => Intrinsics::GuessWithDistortion(large.camera),
        (true, false) => Intrinsics::Guess(large.camera),
        (false, _) => Intrinsics::Known(large.camera),
    };
    let count = large.len();
    let odometry_progress =
        odometry_progress(context, Some(Forecaster::new(&options.config, sequence)));
    let load = move |place: usize| picture(&large, place);
    MonocularSource::find(intrinsics, count, load, &odometry_progress).map_err(
        |error| match error {
            MonocularError::NoPath { failure: OdometryError::Cancelled, .. } => {
                RunError::Cancelled { before: "the path of the camera was found" }
            }
            error => RunError::NoPath(error),
        },
    )
}

/// Passes the progress of visual odometry on, and a forecast as soon as there is one.
fn odometry_progress(context: &RunContext, forecaster: Option<Forecaster>) -> OdometryProgress {
    let observer: Arc<dyn Observer> = Arc::clone(&context.observer);
    let forecaster = Mutex::new(forecaster);
    OdometryProgress::new(context.cancellation.clone(), move |stage, done, of| {
        observer.progress(Stage::Odometry(stage), done, of);
        let keyframes::Stage::Tracking { keyframes } = stage else { return };
        let Ok(mut forecaster) = forecaster.lock() else { return };
        let forecast = forecaster.as_mut().and_then(|f| f.after(done, keyframes));
        forecast.iter().for_each(|forecast| observer.forecast(forecast));
    })
}

/// Warnings about a path, with frames numbered as in the sequence.
fn path_warnings<L>(sequence: &Sequence, found: &MonocularSource<L>) -> Vec<Warning>
where
    L: FnMut(usize) -> Result<Frame, PictureError>,
{
    let index = |place: usize| sequence.entries.get(place).map_or(place, |entry| entry.index);
    let number = |frame: usize| found.position(frame).map_or(frame, index);
    let left_out = |(place, why): &(usize, PictureError)| {
        Warning::of_frame(index(*place), format!("left out: {why}"))
    };
    let warnings = found.reconstruction().warnings.iter().map(|w| w.with_frame_numbers(number));
    let warnings = warnings.map(|warning| match warning {
        OdometryWarning::DisconnectedFrames { frames: [first, last] } => Warning::of_frames(
            (first, last),
            format!("{warning} (frames {first}..{} can be reconstructed apart)", last + 1),
        ),
        _ => match warning.frames() {
            Some([first, last]) => Warning::of_frames((first, last), warning.to_string()),
            None => warning.to_string().into(),
        },
    });
    found.refused().iter().map(left_out).chain(warnings).collect()
}

/// The picture at a place of a sequence.
fn picture(sequence: &Sequence, place: usize) -> Result<Frame, PictureError> {
    Ok(sequence.load(place)?)
}

/// Opens the keyframes of another program in the pictures of a dataset.
pub(super) fn imported(
    (keyframes, pictures): (&Path, &Path),
    import_options: &ImportOptions,
    options: &RunOptions,
    context: &RunContext,
) -> Result<KeyframeInput, RunError> {
    let source = import(keyframes, Some(pictures), import_options)?;
    let (count, frame_rate) = (source.files().len(), source.files().frame_rate);
    let refines =
        import_options.depth != ImportDepth::None && options.config.keyframed.refine_imported;
    let refined = refines.then(|| refined(source.files(), context)).flatten();
    source.files().warnings.iter().for_each(|warning| context.warn(warning.as_str()));
    Ok(KeyframeInput {
        source: refined.unwrap_or_else(|| Box::new(source)),
        count,
        between: Box::new(std::iter::empty()),
        path: Vec::new(),
        frames_given: count,
        frame_rate,
        camera: None,
        undistorted: None,
    })
}

/// Imported keyframes with poses refined by visual odometry, and its dense depth; none if they
/// come with depth, or if no path is found in their pictures, which is noted.
fn refined(files: &ImportedKeyframes, context: &RunContext) -> Option<Box<dyn KeyframeSource>> {
    if files.has_depth {
        return None;
    }
    let note = |line: &str| context.observer.note(line);
    let large = files.at_least(ODOMETRY_SIDE);
    let load = |place: usize| imported_picture(&large, place);
    let camera = Intrinsics::Known(large.camera);
    let found =
        match MonocularSource::find(camera, large.len(), load, &odometry_progress(context, None)) {
            Ok(found) => found,
            Err(MonocularError::NoPath { failure: OdometryError::Cancelled, .. }) => {
                note("ended during visual odometry: the imported poses stay as they are");
                return None;
            }
            Err(failure) => {
                note(&format!("the imported poses stay as they are, without depth: {failure}"));
                return None;
            }
        };
    let own = files.clone();
    let load = move |place: usize| imported_picture(&own, place);
    let poses = files.keyframes.iter().map(|keyframe| keyframe.world_from_camera).collect();
    let refined =
        RefinedImport::new(files.camera, poses, &found, load, context.cancellation.clone());
    let Some(refined) = refined else {
        note(
            "the imported poses stay as they are, without depth: odometry found too few of them, or a \
              rolling shutter",
        );
        return None;
    };
    note(&refined.summary());
    Some(Box::new(refined))
}

fn imported_picture(files: &ImportedKeyframes, place: usize) -> Result<Frame, PictureError> {
    let keyframe = files.load(place)?;
    let (index, timestamp) = (keyframe.index, keyframe.timestamp);
    Ok(Frame::colour_only(index, timestamp, keyframe.colour))
}

/// A session on keyframes, and the frames that are localised after the last of them.
struct KeyframeConsumer {
    session: Session,
    mapping: MappingConfig,
    between: BetweenFrames,
    /// Number of keyframes so far, mapped or held out.
    position: usize,
    /// Keyframes kept from the map, in order.
    held_out: VecDeque<PosedKeyframe>,
    path: Vec<(usize, f64, Pose<f64>)>,
    warnings: Vec<Warning>,
}

impl KeyframeConsumer {
    /// Localises a frame in the finished map; one that cannot be used is left out with a warning.
    fn localize(&mut self, frame: Result<PosedKeyframe, PictureError>) {
        let located = match frame {
            Ok(frame) => self.session.localize(frame).map(|_| ()).map_err(|e| e.to_string()),
            Err(error) => Err(error.to_string()),
        };
        let left_out = located.err().map(|reason| format!("frame left out: {reason}").into());
        self.warnings.extend(left_out);
    }

    fn next_to_localize(&mut self) -> Option<Result<PosedKeyframe, PictureError>> {
        self.held_out.pop_front().map(Ok).or_else(|| self.between.next())
    }
}

impl FrameConsumer for KeyframeConsumer {
    type Item = PosedKeyframe;
    const ITEM: &'static str = "keyframe";
    const LAST_STAGE: Stage = Stage::Refinement;

    fn process(&mut self, keyframe: PosedKeyframe) -> (Result<(), SessionError>, Vec<Warning>) {
        self.position += 1;
        if self.mapping.holds_out(self.position - 1) {
            self.held_out.push_back(keyframe);
            return (Ok(()), Vec::new());
        }
        let processed = self.session.add_keyframe(keyframe).map(|_| ());
        (processed, self.session.take_warnings())
    }

    fn finish(&mut self, on_step: &mut dyn FnMut(usize, usize) -> bool) {
        let count = self.held_out.len() + self.between.len();
        let (mut done, mut steps, mut goes_on) = (0, 0, true);
        self.session.finish(&mut |step, of| {
            (done, steps) = (step, of);
            goes_on = on_step(step, of + count);
            goes_on
        });
        while goes_on {
            let Some(frame) = self.next_to_localize() else { break };
            self.localize(frame);
            done += 1;
            goes_on = on_step(done, steps + count);
        }
    }

    fn frames(&self) -> &[FrameEstimate] {
        self.session.frames()
    }

    fn keep_unprocessed(&mut self) {
        let path = std::mem::take(&mut self.path).into_iter();
        let kept = path
            .filter(|(index, stamp, pose)| self.session.insert_unrefined(*index, *stamp, *pose));
        let count = kept.count();
        if count > 0 {
            let frames = if count == 1 { "frame" } else { "frames" };
            let text = format!(
                "ended early: the poses of {count} {frames} are those of visual odometry, not refined"
            );
            self.warnings.push(text.into());
        }
    }

    fn shortfalls(&self) -> Vec<String> {
        let held_out = shortfall::of_holding_out(&self.mapping, (self.position, "keyframe"));
        held_out.into_iter().collect()
    }

    fn take_warnings(&mut self) -> Vec<Warning> {
        let mut warnings = std::mem::take(&mut self.warnings);
        warnings.extend(self.session.take_warnings());
        warnings
    }

    fn reconstruction(&self) -> Reconstruction {
        self.session.reconstruction()
    }
}

//! Keyframes with poses that visual odometry finds.

use super::RunOptions;
use super::camera::CameraEstimate;
use super::error::RunError;
use super::forecast::RunForecasts;
use super::input::{BetweenFrames, Input, KnownPath};
use super::observer::{Observer, RunContext, Stage};
use super::preview::MapPreview;
use super::stream::TrackedFrames;
use crate::config::{HoldOut, MapKind, TrackingMethod};
use crate::keyframes::{
    self, BoxedLoader, Intrinsics, KeyframeSource, MonocularError, MonocularSource, OdometryError,
    OdometryProgress, OdometryWarning, PictureError, TrackedPictures,
};
use crate::session::{MappedFrames, scratch_store};
use crate::warning::Warning;
use i2slam_dataset::{Frame, Sequence};
use i2slam_geometry::StampedPose;
use i2slam_odometry::{FrameUpdate, FrontEnd};
use i2slam_storage::listed;
use std::sync::Arc;
use std::time::Instant;

/// Keyframes on a path that was found in pictures.
type OdometrySource = MonocularSource<BoxedLoader>;

/// Longer side of the pictures for visual odometry, where they were recorded so large [px]:
/// smaller ones, which a map may be made of, locate points less exactly.
pub(super) const ODOMETRY_SIDE: usize = 640;

/// Path of the camera, and the frames that were mapped while they came, if any.
pub(super) struct FoundPath {
    pub(super) source: OdometrySource,
    pub(super) mapped: Option<MappedFrames>,
    /// Forecasts of the run, where it began with finding the path.
    pub(super) forecasts: Option<Arc<RunForecasts>>,
}

/// Width and height of the pictures of a sequence that visual odometry sees [px]: larger than
/// those delivered where these are small.
pub fn odometry_size(sequence: &Sequence) -> (usize, usize) {
    let camera = sequence.at_least(ODOMETRY_SIDE).camera;
    (camera.width, camera.height)
}

/// Finds the path of the camera in the pictures, and opens its keyframes with dense depth; the lens
/// distortion is estimated if asked, and frames of a stream may have been `tracked` already.
pub(super) fn open(
    sequence: &Sequence,
    (estimate_distortion, tracked): (bool, Option<TrackedFrames>),
    options: &RunOptions,
    context: &RunContext,
) -> Result<Input<'static>, RunError> {
    let FoundPath { source, mapped, forecasts } = match tracked {
        Some(TrackedFrames::Mapped(frames)) => frames.into_path(sequence, context)?,
        Some(TrackedFrames::Unmapped(pictures)) => {
            find_path(sequence, (estimate_distortion, Some(*pictures)), options, context)?
        }
        None => find_path(sequence, (estimate_distortion, None), options, context)?,
    };
    let keyframes = source.reconstruction().keyframes.len();
    let size = (sequence.camera.width, sequence.camera.height);
    let source = source.with_pictures(size, loader(sequence));
    let camera = CameraEstimate::new(sequence, source.reconstruction());
    context.observer.camera(&camera);
    let undistorted = camera.lens.as_ref().map(|lens| sequence.with_estimated_camera(lens));
    path_warnings(sequence, &source).into_iter().for_each(|warning| context.warn(warning));
    let of_undistorted = undistorted.iter().flat_map(|sequence| &sequence.warnings);
    of_undistorted.for_each(|warning| context.warn(warning.as_str()));
    let pictures = undistorted.as_ref().unwrap_or(sequence);
    let source = match &mapped {
        Some(_) => source,
        None => with_fitted_frames(source, sequence, options),
    };
    let source = source.with_pictures(size, loader(pictures));
    let path = known_path(&source, sequence);
    // The paper's system has poses of keyframes alone.
    let between: BetweenFrames = match options.config.tracking.method {
        TrackingMethod::Adam => Box::new(std::iter::empty()),
        TrackingMethod::SecondOrder => Box::new(source.non_keyframes(loader(pictures))),
    };
    let source = with_frames_between(source, mapped.as_ref(), options, pictures);
    let count = source.remaining();
    let source = with_depth_and_motions(source, forecasts.as_deref(), options, context);
    let camera_source = camera.source_of_focal_length();
    Ok(Input {
        between,
        path,
        keyframes,
        frames_given: sequence.len(),
        estimate: Some(camera),
        undistorted,
        mapped,
        ..Input::keyframes(Box::new(source), camera_source, count, sequence.frame_rate)
    })
}

/// A loader of the pictures of a sequence, by position.
fn loader(sequence: &Sequence) -> BoxedLoader {
    let sequence = sequence.clone();
    Box::new(move |place| picture(&sequence, place))
}

/// Poses and deviations that a source has found, by frame index.
fn known_path(source: &OdometrySource, sequence: &Sequence) -> KnownPath {
    let index = |place: usize| sequence.entries.get(place).map(|entry| entry.index);
    let poses = source.trajectory().into_iter();
    let poses = poses.filter_map(|(place, stamp, pose)| Some((index(place)?, stamp, pose)));
    let deviations = source.deviations();
    let deviations = deviations.filter_map(|(place, deviation)| Some((index(place)?, deviation)));
    KnownPath {
        poses: poses.collect(),
        online: source.online_trajectory(),
        deviations: deviations.collect(),
    }
}

/// With the frames between keyframes, where depth is measured: it adds what keyframes do not see, and
/// every exposure adds to the radiance. Frames that are `mapped` already are left out.
fn with_frames_between(
    source: OdometrySource,
    mapped: Option<&MappedFrames>,
    options: &RunOptions,
    pictures: &Sequence,
) -> OdometrySource {
    let config = &options.config;
    let is_measured = source.reconstruction().depth_model.is_some();
    let adds = is_measured
        && config.tracking.method == TrackingMethod::SecondOrder
        && config.map.kind == MapKind::Gaussian;
    let source = if adds { source.with_frames_between(loader(pictures)) } else { source };
    match mapped {
        Some(mapped) => source.without_frames(&mapped.current),
        None => source,
    }
}

/// With dense depth, and the motions of photographs, whose mapping is forecast.
fn with_depth_and_motions(
    source: OdometrySource,
    forecasts: Option<&RunForecasts>,
    options: &RunOptions,
    context: &RunContext,
) -> OdometrySource {
    let config = &options.config;
    let is_blurred = config.formation.blur && config.tracking.method == TrackingMethod::SecondOrder;
    let source = match is_blurred {
        true => source.with_photograph_motions(&context.cancellation),
        false => source,
    };
    if source.is_unordered() && !context.cancellation.is_cancelled() {
        let forecast = forecasts.and_then(|all| all.after_placing(source.remaining()));
        forecast.iter().for_each(|forecast| context.observer.forecast(forecast));
    }
    let on_estimated = |done, of| {
        context.observer.progress(Stage::DenseDepth, done, of);
        !context.cancellation.is_cancelled()
    };
    source.with_dense_depth(context.cancellation.clone()).with_depth_prepared(on_estimated)
}

/// Finds the path of the camera in the pictures at [`odometry_size`], as they were recorded, unless
/// they were `tracked` already; after cancellation the path so far, if there is one.
fn find_path(
    sequence: &Sequence,
    (estimate_distortion, tracked): (bool, Option<TrackedPictures>),
    options: &RunOptions,
    context: &RunContext,
) -> Result<FoundPath, RunError> {
    let large = sequence.at_least(ODOMETRY_SIDE);
    let forecasts = Arc::new(RunForecasts::new(&options.config, sequence));
    let progress = odometry_progress(context, Some(Arc::clone(&forecasts)));
    let count = large.len();
    let tracked = if let Some(tracked) = tracked {
        let keyframes = tracked.given.keyframes;
        progress.report(keyframes::Stage::Tracking { keyframes }, count, count);
        tracked
    } else {
        let load = |place: usize| picture(&large, place);
        let mut preview =
            MapPreview::start((sequence, sequence.frames_with_depth() > 0), options, context);
        let on_tracked = |front_end: &FrontEnd, update: &FrameUpdate, tracked: &Frame| {
            forecasts.set_unordered(front_end.is_unordered());
            stamped_pose(update, tracked).iter().for_each(|pose| context.observer.pose(pose));
            if let Some(preview) = &mut preview {
                let started = Instant::now();
                preview.add_from_file(front_end, update, tracked);
                forecasts.add_preview(started.elapsed());
            }
        };
        let intrinsics = intrinsics(&large, estimate_distortion);
        let hold_out = avoided_keyframes(options, Some(sequence));
        TrackedPictures::new(intrinsics, hold_out)
            .with_scratch(scratch_store(&options.config, &options.scratch_folder))
            .track(count, load, &progress, on_tracked)
    };
    match tracked.finish(loader(&large), &progress) {
        Ok(source) => Ok(FoundPath { source, mapped: None, forecasts: Some(forecasts) }),
        Err(MonocularError::NoPath { failure: OdometryError::Cancelled, .. }) => {
            Err(RunError::Cancelled { before: "the path of the camera was found" })
        }
        Err(error) => Err(RunError::NoPath(error)),
    }
}

/// With the frames between keyframes that Gaussians are [fitted to](crate::Config::fitted_keyframes).
fn with_fitted_frames(
    source: OdometrySource,
    sequence: &Sequence,
    options: &RunOptions,
) -> OdometrySource {
    let found = source.reconstruction();
    let most = options.config.fitted_keyframes(found.keyframes.len(), found.poses.len());
    let held_out = avoided_keyframes(options, Some(sequence));
    let is_measured = found.depth_model.is_some();
    source.with_fitted_frames(most, |place| {
        let entry = sequence.entries.get(place);
        entry.is_some_and(|entry| {
            !held_out.is_held_out(entry.index) && (entry.depth.is_some() || !is_measured)
        })
    })
}

/// Frames that the front end avoids as keyframes: those held out, of a sequence or a stream; none where
/// keyframes alone get poses, so that every n-th of these is held out.
pub(super) fn avoided_keyframes(options: &RunOptions, sequence: Option<&Sequence>) -> HoldOut {
    let mapping = &options.config.mapping;
    match (options.config.tracking.method, sequence) {
        (TrackingMethod::Adam, _) => HoldOut::default(),
        (TrackingMethod::SecondOrder, None) => HoldOut::new(mapping),
        (TrackingMethod::SecondOrder, Some(sequence)) => {
            HoldOut::of_frames(mapping, sequence.entries.iter().map(|entry| entry.index))
        }
    }
}

/// Pose and time stamp of a frame, where the pose is known when it comes.
pub(super) fn stamped_pose(update: &FrameUpdate, frame: &Frame) -> Option<StampedPose> {
    let timestamp = frame.timestamp;
    update.pose.map(|world_from_camera| StampedPose { timestamp, world_from_camera })
}

/// Intrinsics of a sequence: known, or a guess that is adjusted.
pub(super) fn intrinsics(sequence: &Sequence, estimate_distortion: bool) -> Intrinsics {
    match (sequence.camera_is_guess, estimate_distortion) {
        (true, true) => Intrinsics::GuessWithDistortion(sequence.camera),
        (true, false) => Intrinsics::Guess(sequence.camera),
        (false, _) => Intrinsics::Known(sequence.camera),
    }
}

/// Passes the progress of visual odometry on, and a forecast as soon as there is one.
pub(super) fn odometry_progress(
    context: &RunContext,
    forecasts: Option<Arc<RunForecasts>>,
) -> OdometryProgress {
    let observer: Arc<dyn Observer> = Arc::clone(&context.observer);
    OdometryProgress::new(context.cancellation.clone(), move |stage, done, of| {
        observer.progress(Stage::Odometry(stage), done, of);
        let forecast = forecasts.as_ref().and_then(|all| all.after_progress(stage, done, of));
        forecast.iter().for_each(|forecast| observer.forecast(forecast));
    })
}

/// Warnings about a path, with frames numbered as in the sequence.
fn path_warnings(sequence: &Sequence, found: &OdometrySource) -> Vec<Warning> {
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
        OdometryWarning::PhotographsNotPlaced { .. } => {
            format!("{warning}: {}", not_placed(sequence, found)).into()
        }
        _ => match warning.frames() {
            Some([first, last]) => {
                let text = warning.to_string();
                let last_frame = (first != last).then_some(last);
                Warning { frame: Some(first), last_frame, text, time_s: None }
            }
            None => warning.to_string().into(),
        },
    });
    found.refused().iter().map(left_out).chain(warnings).collect()
}

/// Names of the files of pictures without a pose.
fn not_placed(sequence: &Sequence, found: &OdometrySource) -> String {
    let poses = found.reconstruction().poses.iter().enumerate();
    let places = poses.filter(|(_, pose)| pose.is_none()).filter_map(|(i, _)| found.position(i));
    let entries = places.filter_map(|place| sequence.entries.get(place));
    let names = entries.filter_map(|entry| Some(entry.colour.file_name()?.to_string_lossy()));
    listed(&names.collect::<Vec<_>>())
}

/// The picture at a place of a sequence.
pub(super) fn picture(sequence: &Sequence, place: usize) -> Result<Frame, PictureError> {
    Ok(sequence.load(place)?)
}

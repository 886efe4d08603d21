//! Keyframes with poses, found by visual odometry or imported.

use super::RunOptions;
use super::camera::CameraEstimate;
use super::driver::{BetweenFrames, Input, Item, KEYFRAMES};
use super::error::RunError;
use super::forecast::RunForecasts;
use super::observer::{Observer, RunContext, Stage};
use super::preview::MapPreview;
use super::stream::TrackedFrames;
use crate::config::{HoldOut, MapKind, TrackingMethod};
use crate::keyframes::{
    self, BoxedLoader, ImportDepth, ImportOptions, Intrinsics, KeyframeSource, MonocularError,
    MonocularSource, OdometryError, OdometryProgress, OdometryWarning, PictureError, RefinedImport,
    TrackedPictures, import,
};
use crate::session::{MappedFrames, scratch_store};
use crate::warning::Warning;
use i2slam_dataset::import::ImportedKeyframes;
use i2slam_dataset::{DepthPicture, Frame, Sequence};
use i2slam_geometry::{Pose, StampedPose};
use i2slam_odometry::{FrameUpdate, FrontEnd, PoseDeviation};
use i2slam_storage::listed;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

/// Longer side of the pictures for visual odometry, where they were recorded so large [px]:
/// smaller ones, which a map may be made of, locate points less exactly.
pub(super) const ODOMETRY_SIDE: usize = 640;

/// Path of the camera, and the frames that were mapped while they came, if any.
pub(super) struct FoundPath {
    pub(super) source: MonocularSource<BoxedLoader>,
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

/// All keyframes of a source, without any frame between them.
fn keyframes_of(
    mut source: Box<dyn KeyframeSource>,
    count: usize,
    frame_rate: f64,
) -> Input<'static> {
    Input {
        count,
        keyframes: count,
        kind: &KEYFRAMES,
        camera: *source.camera(),
        is_unordered: source.is_unordered(),
        readout: source.readout(),
        items: Box::new(std::iter::from_fn(move || {
            Some(source.next_keyframe()?.map(|keyframe| Item::Keyframe(Box::new(keyframe))))
        })),
        frame_rate,
        between: Box::new(std::iter::empty()),
        path: Vec::new(),
        online_trajectory: Vec::new(),
        deviations: BTreeMap::new(),
        frames_given: count,
        estimate: None,
        undistorted: None,
        mapped: None,
    }
}

/// Finds the path of the camera from the pictures, with dense depth of the keyframes, and their
/// lens distortion if asked; frames of a stream may have been `tracked` already.
pub(super) fn from_odometry(
    sequence: &Sequence,
    (estimate_distortion, tracked): (bool, Option<TrackedFrames>),
    options: &RunOptions,
    context: &RunContext,
) -> Result<Input<'static>, RunError> {
    let size = (sequence.camera.width, sequence.camera.height);
    let FoundPath { source, mapped, forecasts } = match tracked {
        Some(TrackedFrames::Mapped(frames)) => frames.into_path(sequence, context)?,
        Some(TrackedFrames::Unmapped(pictures)) => {
            find_path(sequence, (estimate_distortion, Some(*pictures)), options, context)?
        }
        None => find_path(sequence, (estimate_distortion, None), options, context)?,
    };
    let keyframes = source.reconstruction().keyframes.len();
    let found = source.with_pictures(size, |place| picture(sequence, place));
    let camera = CameraEstimate::new(sequence, found.reconstruction());
    context.observer.camera(&camera);
    let undistorted = camera.lens.as_ref().map(|lens| sequence.with_estimated_camera(lens));
    path_warnings(sequence, &found).into_iter().for_each(|warning| context.warn(warning));
    if let Some(sequence) = &undistorted {
        sequence.warnings.iter().for_each(|warning| context.warn(warning.as_str()));
    }
    let pictures = Arc::new(undistorted.as_ref().unwrap_or(sequence).clone());
    let (others, between_keyframes) = (Arc::clone(&pictures), Arc::clone(&pictures));
    let found = match &mapped {
        Some(_) => found,
        None => with_fitted_frames(found, sequence, options),
    };
    let source = found.with_pictures(size, move |place| picture(&pictures, place));
    let by_index = |(place, stamp, pose): (usize, f64, Pose<f64>)| {
        Some((sequence.entries.get(place)?.index, stamp, pose))
    };
    let path = source.trajectory().into_iter().filter_map(by_index).collect();
    let online_trajectory = source.online_trajectory();
    let by_index = |(place, deviation): (usize, PoseDeviation)| {
        Some((sequence.entries.get(place)?.index, deviation))
    };
    let deviations = source.deviations().filter_map(by_index).collect();
    // The paper's system has poses of keyframes alone.
    let is_paper = options.config.tracking.method == TrackingMethod::Adam;
    let between: BetweenFrames = match is_paper {
        true => Box::new(std::iter::empty()),
        false => Box::new(source.non_keyframes(move |place| picture(&others, place))),
    };
    // Their depth adds what keyframes do not see, and every exposure adds to the radiance.
    let is_measured = source.reconstruction().depth_model.is_some();
    let source = match is_measured && !is_paper && options.config.map.kind == MapKind::Gaussian {
        true => source.with_frames_between(move |place| picture(&between_keyframes, place)),
        false => source,
    };
    let source = match &mapped {
        Some(mapped) => source.without_frames(&mapped.current),
        None => source,
    };
    let count = source.remaining();
    let source = match options.config.formation.blur && !is_paper {
        true => source.with_photograph_motions(&context.cancellation),
        false => source,
    };
    let forecasts =
        forecasts.filter(|_| source.is_unordered() && !context.cancellation.is_cancelled());
    let forecast = forecasts.and_then(|forecasts| forecasts.after_placing(count));
    forecast.iter().for_each(|forecast| context.observer.forecast(forecast));
    let on_estimated = |done, of| {
        context.observer.progress(Stage::DenseDepth, done, of);
        !context.cancellation.is_cancelled()
    };
    let source = source.with_dense_depth(context.cancellation.clone());
    let source = Box::new(source.with_depth_prepared(on_estimated));
    Ok(Input {
        between,
        path,
        online_trajectory,
        keyframes,
        frames_given: sequence.len(),
        estimate: Some(camera),
        undistorted,
        deviations,
        mapped,
        ..keyframes_of(source, count, sequence.frame_rate)
    })
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
    let load: BoxedLoader = Box::new(move |place| picture(&large, place));
    match tracked.finish(load, &progress) {
        Ok(source) => Ok(FoundPath { source, mapped: None, forecasts: Some(forecasts) }),
        Err(MonocularError::NoPath { failure: OdometryError::Cancelled, .. }) => {
            Err(RunError::Cancelled { before: "the path of the camera was found" })
        }
        Err(error) => Err(RunError::NoPath(error)),
    }
}

/// With the frames between keyframes that Gaussians are [fitted to](crate::Config::fitted_keyframes).
fn with_fitted_frames<L>(
    source: MonocularSource<L>,
    sequence: &Sequence,
    options: &RunOptions,
) -> MonocularSource<L>
where
    L: FnMut(usize) -> Result<Frame, PictureError>,
{
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
fn odometry_progress(
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
fn not_placed<L>(sequence: &Sequence, found: &MonocularSource<L>) -> String
where
    L: FnMut(usize) -> Result<Frame, PictureError>,
{
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

/// Opens the keyframes of another program in the pictures of a dataset.
pub(super) fn imported(
    (keyframes, pictures): (&Path, &Path),
    import_options: &ImportOptions,
    options: &RunOptions,
    context: &RunContext,
) -> Result<Input<'static>, RunError> {
    let source = import(keyframes, Some(pictures), import_options)?;
    let (count, frame_rate) = (source.files().len(), source.files().frame_rate);
    let refines =
        import_options.depth != ImportDepth::None && options.config.keyframed.refine_imported;
    let refined = refines.then(|| refined(source.files(), context)).flatten();
    source.files().warnings.iter().for_each(|warning| context.warn(warning.as_str()));
    Ok(match refined {
        None => keyframes_of(Box::new(source), count, frame_rate),
        Some(Refined::Keyframes(refined)) => keyframes_of(refined, count, frame_rate),
        Some(Refined::Path(path)) => {
            let pictures = source.files().clone();
            let between = path.non_keyframes(move |place| imported_picture(&pictures, place));
            let (between, keyframes) = (Box::new(between), path.remaining());
            let files = source.files();
            let by_index = |(place, stamp, pose): (usize, f64, Pose<f64>)| {
                Some((files.keyframes.get(place)?.index, stamp, pose))
            };
            let poses = path.trajectory().into_iter().filter_map(by_index).collect();
            let path = path.with_dense_depth(context.cancellation.clone());
            Input {
                between,
                frames_given: count,
                path: poses,
                ..keyframes_of(Box::new(path), keyframes, frame_rate)
            }
        }
    })
}

/// Imported keyframes as visual odometry makes them.
enum Refined {
    /// The keyframes, with its poses or dense depth.
    Keyframes(Box<dyn KeyframeSource>),
    /// Its own path: no pose of a single moment explains rows that were exposed one after the other.
    Path(Box<MonocularSource<BoxedLoader>>),
}

/// Imported keyframes with poses refined by visual odometry, where these come without depth with its
/// dense depth in place of that of a few points, too; none if they come with dense depth that was computed
/// with poses, or if no path is found in their pictures, which is noted.
fn refined(files: &ImportedKeyframes, context: &RunContext) -> Option<Refined> {
    if files.has_variance && !files.has_sparse_depth {
        return None;
    }
    let kept = match (files.has_sparse_depth, files.has_depth) {
        (true, _) => "the imported poses stay as they are, with depth at their points alone",
        (false, true) => "the imported poses stay as they are",
        (false, false) => "the imported poses stay as they are, without depth",
    };
    let note = |line: &str| context.observer.note(line);
    let large = files.at_least(ODOMETRY_SIDE);
    let load = |place: usize| imported_picture(&large, place);
    let camera = Intrinsics::Known(large.camera);
    let poses: Vec<Pose<f64>> = files.keyframes.iter().map(|k| k.world_from_camera).collect();
    let progress = odometry_progress(context, None);
    let found = match MonocularSource::find_near((camera, &poses), large.len(), load, &progress) {
        Ok(found) => found,
        Err(MonocularError::NoPath { failure: OdometryError::Cancelled, .. }) => {
            note("ended during visual odometry: the imported poses stay as they are");
            return None;
        }
        Err(failure) => {
            note(&format!("{kept}: {failure}"));
            return None;
        }
    };
    let own = files.clone();
    let load: BoxedLoader = Box::new(move |place| imported_picture(&own, place));
    if found.reconstruction().rolling_shutter_readout != 0.0 {
        let size = (files.camera.width, files.camera.height);
        let Some(found) = found.near(&poses) else {
            note(&format!("{kept}: odometry found too few of them"));
            return None;
        };
        note(
            "the pictures show a rolling shutter: poses are those found from them, near the imported ones",
        );
        return Some(Refined::Path(Box::new(found.with_pictures(size, load))));
    }
    let refined =
        RefinedImport::new(files.camera, poses, &found, load, context.cancellation.clone());
    let Some(refined) = refined else {
        note(&format!("{kept}: odometry found too few of them"));
        return None;
    };
    note(&refined.summary());
    Some(Refined::Keyframes(Box::new(refined)))
}

fn imported_picture(files: &ImportedKeyframes, place: usize) -> Result<Frame, PictureError> {
    let keyframe = files.load(place)?;
    let (index, timestamp) = (keyframe.index, keyframe.timestamp);
    let measured = keyframe.depth.filter(|_| !files.has_sparse_depth);
    let depth = measured.map(|depth| DepthPicture { image: Arc::new(depth), timestamp });
    Ok(Frame { depth, ..Frame::colour_only(index, timestamp, keyframe.colour) })
}

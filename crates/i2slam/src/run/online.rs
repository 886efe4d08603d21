//! Frames with depth of a known camera, mapped in Gaussians while they come.

use super::RunOptions;
use super::driver::{KEYFRAMES, new_session};
use super::error::RunError;
use super::forecast::Forecaster;
use super::keyframes::{FoundPath, ODOMETRY_SIDE, picture};
use super::observer::{Observer, RunContext, Stage};
use crate::config::{MapKind, TrackingMethod};
use crate::keyframes::{
    self, BoxedLoader, GivenPictures, MonocularError, MonocularSource, OdometryProgress,
    OdometryReconstruction, in_usual_unit,
};
use crate::reconstruction::FrameEstimate;
use crate::session::{MappedFrames, OnlineMapping, OnlineSession, SessionError};
use i2slam_dataset::Sequence;
use i2slam_geometry::StampedPose;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Frames and corrections that wait for the map at most.
const MAX_WAITING: usize = 32;

/// True if frames are mapped while they come; others are mapped after the last one. By colour alone
/// depth is estimated with poses, and those known when a frame comes are not good enough: 6 dB on
/// dining-room.
pub(super) fn is_possible(sequence: &Sequence, options: &RunOptions) -> bool {
    let config = &options.config;
    options.poses.uses_depth()
        && sequence.frames_with_depth() > 0
        && !sequence.camera_is_guess
        && config.tracking.method == TrackingMethod::SecondOrder
        && config.map.kind == MapKind::Gaussian
}

/// Finds the path of the camera, and maps frames while they come. After cancellation the path so far,
/// with what was mapped.
pub(super) fn find_path(
    sequence: &Sequence,
    options: &RunOptions,
    context: &RunContext,
) -> Result<FoundPath, RunError> {
    let mapped = Arc::new(MappedCount::new(sequence.len()));
    let forecaster = Forecaster::of_online(&options.config, sequence);
    let large = sequence.at_least(ODOMETRY_SIDE);
    let camera = (sequence.camera, sequence.frame_rate);
    let session = new_session(&KEYFRAMES, options, context, (camera, sequence));
    let on_mapped = listener(sequence, context, Arc::clone(&mapped), forecaster);
    let mut online = OnlineSession::of(session, large.camera, on_mapped);
    let progress = progress(context);
    let is_one_size = large.camera == sequence.camera;
    let given = GivenPictures::give(sequence.len(), &progress, |place| {
        let tracked = picture(&large, place)?;
        let mapped = if is_one_size { tracked.clone() } else { picture(sequence, place)? };
        online.wait_for_map(MAX_WAITING);
        let update = online.push_sizes(&tracked, mapped)?;
        let timestamp = update.timestamp;
        let pose = update
            .world_from_camera
            .map(|world_from_camera| StampedPose { timestamp, world_from_camera });
        pose.iter().for_each(|pose| context.observer.pose(pose));
        Ok(update.is_keyframe)
    });
    let (path, mapping) = match online.into_path(&progress) {
        Ok(found) => found,
        Err(failure) => {
            let refused = given.refused;
            return Err(RunError::NoPath(MonocularError::NoPath { failure, refused }));
        }
    };
    mapped.total.store(mapping.sent(), Ordering::Relaxed);
    context.observer.progress(KEYFRAMES.stage, mapped.done(), mapping.sent());
    let load: BoxedLoader = Box::new(move |place| picture(&large, place));
    Ok(match finish_mapping(mapping, &path, context) {
        Some(mapped) => FoundPath {
            source: MonocularSource::of_path(mapped.path.clone(), given, load),
            mapped: Some(mapped),
        },
        None => FoundPath {
            source: MonocularSource::of_path(in_usual_unit(path), given, load),
            mapped: None,
        },
    })
}

/// The mapped frames, their poses corrected to the path; `None` if all frames have to be mapped after
/// the last one.
fn finish_mapping(
    mapping: OnlineMapping,
    path: &OdometryReconstruction,
    context: &RunContext,
) -> Option<MappedFrames> {
    if !mapping.is_metric(path) && !context.cancellation.is_cancelled() {
        context.observer.note("depth gave lengths no unit when frames came: they are mapped again");
        return None;
    }
    let failure = match mapping.finish(path.clone()) {
        Ok(mut mapped) => {
            let is_map = |error: &SessionError| matches!(error, SessionError::Map { .. });
            match mapped.errors.iter().position(is_map) {
                None => return Some(mapped),
                Some(place) => mapped.errors.swap_remove(place).to_string(),
            }
        }
        Err(panic) => panic.to_string(),
    };
    context.warn(format!("{failure}; all frames are mapped again, after the last one"));
    None
}

/// Number of frames that were mapped, of all that will be as far as is known.
struct MappedCount {
    done: AtomicUsize,
    total: AtomicUsize,
}

impl MappedCount {
    fn new(total: usize) -> Self {
        Self { done: AtomicUsize::new(0), total: AtomicUsize::new(total) }
    }

    fn done(&self) -> usize {
        self.done.load(Ordering::Relaxed)
    }
}

/// Passes every frame on that was mapped, and a forecast as soon as there is one.
fn listener(
    sequence: &Sequence,
    context: &RunContext,
    mapped: Arc<MappedCount>,
    mut forecaster: Forecaster,
) -> impl FnMut(&FrameEstimate) + Send + 'static {
    let observer: Arc<dyn Observer> = Arc::clone(&context.observer);
    let indices: Vec<usize> = sequence.entries.iter().map(|entry| entry.index).collect();
    let mut keyframes = 0;
    move |estimate| {
        let done = mapped.done.fetch_add(1, Ordering::Relaxed) + 1;
        observer.frame(estimate, done, mapped.total.load(Ordering::Relaxed).max(done));
        keyframes += usize::from(estimate.keyframe);
        let through = indices.partition_point(|index| *index <= estimate.index);
        forecaster.after(through, keyframes).iter().for_each(|f| observer.forecast(f));
    }
}

/// Passes the progress of visual odometry on.
fn progress(context: &RunContext) -> OdometryProgress {
    let observer: Arc<dyn Observer> = Arc::clone(&context.observer);
    OdometryProgress::new(context.cancellation.clone(), move |stage, done, of| {
        let stage = match stage {
            keyframes::Stage::Tracking { .. } => Stage::Online,
            stage => Stage::Odometry(stage),
        };
        observer.progress(stage, done, of);
    })
}

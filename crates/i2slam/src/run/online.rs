//! Frames with depth of a known camera, mapped in Gaussians while they come.

use super::RunOptions;
use super::driver::{KEYFRAMES, new_session};
use super::error::RunError;
use super::forecast::Forecaster;
use super::keyframes::{FoundPath, ODOMETRY_SIDE, avoided_keyframes, picture};
use super::observer::{Observer, RunContext, Stage};
use crate::config::{MapKind, TrackingMethod};
use crate::keyframes::{
    self, BoxedLoader, GivenPictures, MonocularError, MonocularSource, OdometryProgress,
    OdometryReconstruction, PictureError, in_usual_unit,
};
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::session::{MappedFrames, OnlineMapping, OnlineSession, OnlineUpdate, SessionError};
use i2slam_dataset::{Frame, Sequence};
use i2slam_geometry::StampedPose;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

/// Frames and corrections that wait for the map at most.
const MAX_WAITING: usize = 32;

/// True if frames of a source with depth and a known camera are mapped while they come; others are
/// mapped after the last one. By colour alone depth is estimated with poses, and those known when a
/// frame comes are not good enough: 6 dB on dining-room.
pub(super) fn is_possible(options: &RunOptions, (has_depth, is_guess): (bool, bool)) -> bool {
    let config = &options.config;
    options.poses.uses_depth()
        && has_depth
        && !is_guess
        && config.tracking.method == TrackingMethod::SecondOrder
        && config.map.kind == MapKind::Gaussian
}

/// Logarithm of the ratio of frame rates up to which a map counts on the right one.
const MAX_RATE_CHANGE: f64 = 0.2;

/// Finds the path of the camera, and maps frames while they come. After cancellation the path so far,
/// with what was mapped.
pub(super) fn find_path(
    sequence: &Sequence,
    options: &RunOptions,
    context: &RunContext,
) -> Result<FoundPath, RunError> {
    let large = sequence.at_least(ODOMETRY_SIDE);
    let forecaster = Forecaster::of_online(&options.config, sequence);
    let mut frames = OnlineFrames::start((sequence, &large), options, context);
    frames.session.set_hold_out(avoided_keyframes(options, Some(sequence)));
    let progress = forecasting_progress(context, forecaster, Arc::clone(&frames.mapped));
    let is_one_size = large.camera == sequence.camera;
    let given = GivenPictures::give(sequence.len(), &progress, |place| {
        let tracked = picture(&large, place)?;
        let mapped = if is_one_size { tracked.clone() } else { picture(sequence, place)? };
        frames.session.wait_for_map(MAX_WAITING);
        let update = frames.session.push_sizes(&tracked, mapped)?;
        update.stamped_pose().iter().for_each(|pose| context.observer.pose(pose));
        Ok(update.is_keyframe)
    });
    OnlineFrames { given, ..frames }.into_path(sequence, context)
}

/// Frames that are mapped while they come.
pub(super) struct OnlineFrames {
    session: OnlineSession,
    mapped: Arc<MappedCount>,
    pub(super) given: GivenPictures,
    /// Time stamp of the first frame [s].
    first: Option<f64>,
    /// That the map counts on [1/s].
    frame_rate: f64,
}

impl OnlineFrames {
    /// None so far, of a source whose frames are mapped as those of `sequence`, and tracked as those of
    /// `large`.
    pub(super) fn start(
        (sequence, large): (&Sequence, &Sequence),
        options: &RunOptions,
        context: &RunContext,
    ) -> Self {
        let mapped = Arc::<MappedCount>::default();
        let camera = (sequence.camera, sequence.frame_rate);
        let session = new_session(&KEYFRAMES, options, context, (camera, sequence));
        let on_mapped = listener(sequence, context, Arc::clone(&mapped));
        let session = OnlineSession::of(session, large.camera, on_mapped);
        let (given, frame_rate) = (GivenPictures::default(), sequence.frame_rate);
        Self { session, mapped, given, first: None, frame_rate }
    }

    /// Tracks the frame of a camera at a position, in the sizes that are tracked and mapped; returns its
    /// pose, where it is known. One that does not fit is refused.
    pub(super) fn push(&mut self, position: usize, sizes: (Frame, Frame)) -> Option<StampedPose> {
        let (tracked, mapped) = sizes;
        match self.first {
            None => self.first = Some(tracked.timestamp),
            // No frame is mapped before.
            Some(first) if position == 1 && tracked.timestamp > first => {
                self.frame_rate = (tracked.timestamp - first).recip();
                self.session.set_frame_rate(self.frame_rate);
            }
            Some(_) => {}
        }
        let pushed = self.session.push_from_camera(&tracked, mapped);
        let pose = pushed.as_ref().ok().and_then(OnlineUpdate::stamped_pose);
        let pushed = pushed.map(|update| update.is_keyframe).map_err(PictureError::from);
        self.given.add(position, pushed);
        pose
    }

    /// Adjusts all poses of the frames of `sequence` together; the path so far after cancellation.
    pub(super) fn into_path(
        self,
        sequence: &Sequence,
        context: &RunContext,
    ) -> Result<FoundPath, RunError> {
        let Self { session, mapped, given, frame_rate, .. } = self;
        let (path, mapping) = match session.into_path(&progress(context)) {
            Ok(found) => found,
            Err(failure) => {
                let refused = given.refused;
                return Err(RunError::NoPath(MonocularError::NoPath { failure, refused }));
            }
        };
        mapped.total.store(mapping.sent(), Ordering::Relaxed);
        context.observer.progress(Stage::Mapping, mapped.done(), mapping.sent());
        let large = sequence.at_least(ODOMETRY_SIDE);
        let load: BoxedLoader = Box::new(move |place| picture(&large, place));
        let is_rate_right = (frame_rate / sequence.frame_rate).ln().abs() < MAX_RATE_CHANGE;
        let mapped = if is_rate_right || context.cancellation.is_cancelled() {
            finish_mapping(mapping, &path, context)
        } else {
            context.observer.note(&format!(
                "the first two frames came at {frame_rate:.1} frames a second, all at {:.1}: they are \
                 mapped again",
                sequence.frame_rate
            ));
            None
        };
        let path = match &mapped {
            Some(mapped) => mapped.path.clone(),
            None => in_usual_unit(path),
        };
        Ok(FoundPath { source: MonocularSource::of_path(path, given, load), mapped })
    }
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
                None => {
                    note_outdated(mapped.outdated, context);
                    return Some(mapped);
                }
                Some(place) => mapped.errors.swap_remove(place).to_string(),
            }
        }
        Err(panic) => panic.to_string(),
    };
    context.warn(format!("{failure}; all frames are mapped again, after the last one"));
    None
}

/// Tells why frames that are in the map are mapped a second time.
fn note_outdated(frames: usize, context: &RunContext) {
    if frames > 0 && !context.cancellation.is_cancelled() {
        context.observer.note(&format!(
            "the rolling shutter, or the delay or offset of depth, is known exactly only after the last \
             frame: {} mapped again",
            if frames == 1 { "one frame is".to_owned() } else { format!("{frames} frames are") }
        ));
    }
}

/// Number of frames that were mapped, of all that will be as far as is known.
#[derive(Default)]
struct MappedCount {
    done: AtomicUsize,
    total: AtomicUsize,
}

impl MappedCount {
    fn done(&self) -> usize {
        self.done.load(Ordering::Relaxed)
    }
}

/// Passes every frame on that was mapped.
fn listener(
    sequence: &Sequence,
    context: &RunContext,
    mapped: Arc<MappedCount>,
) -> impl FnMut(&FrameEstimate, &dyn Fn() -> Reconstruction) + Send + 'static {
    let observer: Arc<dyn Observer> = Arc::clone(&context.observer);
    mapped.total.store(sequence.len(), Ordering::Relaxed);
    move |estimate, current| {
        let done = mapped.done.fetch_add(1, Ordering::Relaxed) + 1;
        observer.frame(estimate, done, mapped.total.load(Ordering::Relaxed).max(done));
        observer.map(current);
    }
}

/// Passes the progress of visual odometry on, and a forecast as soon as there is one.
fn forecasting_progress(
    context: &RunContext,
    forecaster: Forecaster,
    mapped: Arc<MappedCount>,
) -> OdometryProgress {
    let observer: Arc<dyn Observer> = Arc::clone(&context.observer);
    let (passed_on, forecaster) = (progress(context), Mutex::new(forecaster));
    OdometryProgress::new(context.cancellation.clone(), move |stage, done, of| {
        passed_on.report(stage, done, of);
        let keyframes::Stage::Tracking { keyframes } = stage else { return };
        let Ok(mut forecaster) = forecaster.lock() else { return };
        let forecast = forecaster.after(done, keyframes, mapped.done());
        forecast.iter().for_each(|forecast| observer.forecast(forecast));
    })
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

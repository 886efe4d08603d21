//! Frames with depth of a known camera, mapped in Gaussians while they come.

use super::RunOptions;
use super::driver::new_session;
use super::error::RunError;
use super::input::KEYFRAMES;
use super::observer::{Observer, RunContext, Stage};
use super::odometry::{FoundPath, ODOMETRY_SIDE, picture};
use crate::config::{MapKind, TrackingMethod};
use crate::keyframes::{
    self, BoxedLoader, GivenPictures, MonocularError, MonocularSource, OdometryProgress,
    OdometryReconstruction, PictureError, in_usual_unit,
};
use crate::reconstruction::{FrameEstimate, Reconstruction};
use crate::session::{MappedFrames, OnlineMapping, OnlineSession, OnlineUpdate, SessionError};
use i2slam_dataset::{Frame, Sequence};
use i2slam_geometry::StampedPose;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// True if frames of a stream with depth and a known camera are mapped while they come. Others are mapped
/// after the last one: by colour alone depth is estimated with poses, and those known when a frame comes
/// are not good enough (6 dB on dining-room). So are those of files, which nobody waits for: the delay and
/// offset of depth and the readout are known exactly only then, and what was mapped with others is lost.
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

/// Frames that are mapped while they come.
pub(super) struct OnlineFrames {
    session: OnlineSession,
    mapped: Arc<MappedCount>,
    pub(super) given: GivenPictures,
    /// Time stamp of the first frame [s].
    first: Option<f64>,
    /// One of so many frames of the camera comes.
    stride: usize,
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
        let (first, stride) = (None, options.open.stride);
        Self { session, mapped, given, first, stride, frame_rate }
    }

    /// Tracks the frame of a camera at a position, in the sizes that are tracked and mapped; returns its
    /// pose, where it is known. One that does not fit is refused.
    pub(super) fn push(&mut self, position: usize, sizes: (Frame, Frame)) -> Option<StampedPose> {
        let (tracked, mapped) = sizes;
        match self.first {
            None => self.first = Some(tracked.timestamp),
            // No frame is mapped before.
            Some(first) if position == 1 && tracked.timestamp > first => {
                // That of the camera: frames that are left out count.
                self.frame_rate = self.stride as f64 / (tracked.timestamp - first);
                self.session.set_frame_rate(self.frame_rate);
            }
            Some(_) => {}
        }
        let pushed = self.session.push_in_sizes(&tracked, mapped);
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
        let source = MonocularSource::of_path(path, given, load);
        Ok(FoundPath { source, mapped, forecasts: None })
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
    // A new map is as good, and frames that still wait need not be mapped for it.
    if mapping.is_outdated(path) && !context.cancellation.is_cancelled() {
        note_outdated("all frames are", context);
        return None;
    }
    let failure = match mapping.finish(path.clone()) {
        Ok(mut mapped) => {
            let is_map = |error: &SessionError| matches!(error, SessionError::Map { .. });
            match mapped.errors.iter().position(is_map) {
                None => {
                    let outdated = mapped.outdated;
                    if outdated > 0 && !context.cancellation.is_cancelled() {
                        let one = "one frame is".to_owned();
                        let frames =
                            if outdated == 1 { one } else { format!("{outdated} frames are") };
                        note_outdated(&frames, context);
                    }
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
fn note_outdated(frames: &str, context: &RunContext) {
    context.observer.note(&format!(
        "the rolling shutter, or the delay or offset of depth, is known exactly only after the last \
         frame: {frames} mapped again"
    ));
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

//! Streams: frames are tracked while they come. Those with depth are mapped, too; others are mapped
//! when the stream has ended.

use super::camera::is_focal_length_changed;
use super::observer::{Observer, RunContext, Stage};
use super::odometry::{ODOMETRY_SIDE, avoided_keyframes, intrinsics, stamped_pose};
use super::online::{self, OnlineFrames};
use super::preview::MapPreview;
use super::{PoseSource, RunError, RunOptions, has_small_pictures};
use crate::keyframes::{self, GivenPictures, TrackedPictures};
use crate::session::scratch_store;
use i2slam_dataset::{Frame, LiveSequence, Sequence};
use i2slam_geometry::StampedPose;
use std::sync::PoisonError;
use std::time::Instant;

/// Delay of poses without a note [s].
const MAX_LAG: f64 = 1.0;

/// A stream whose frames were tracked while they came.
///
/// ```no_run
/// use i2slam::run::{TrackedStream, reconstruct_stream};
/// use i2slam::{CancellationToken, RunOptions};
///
/// let options = RunOptions::colour_alone();
/// let live = options.open_stream("rtsp://camera/1".as_ref(), CancellationToken::default())?;
/// let tracked = TrackedStream::track(&live, &options, ())?;
/// let recorded = live.finish()?;
/// let outcome = reconstruct_stream(&recorded.sequence, tracked, &options, ())?;
/// println!("{}", outcome.reconstruction.map);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct TrackedStream {
    pub(super) frames: Option<TrackedFrames>,
    /// Time stamps of all frames and their depth [s].
    timestamps: Vec<(f64, Option<f64>)>,
}

/// Frames of a stream.
struct Source<'a> {
    /// Its first frame, in the size that is mapped and in the one that is tracked.
    first: &'a Sequence,
    large: &'a Sequence,
    has_depth: bool,
}

impl Source<'_> {
    /// True if frames are mapped while they come, as part of the result.
    fn is_mapped(&self, options: &RunOptions) -> bool {
        online::is_possible(options, (self.has_depth, self.first.camera_is_guess))
    }
}

/// Frames that a front end was given.
pub(super) enum TrackedFrames {
    /// To be mapped when the path of all is known.
    Unmapped(Box<TrackedPictures>),
    /// Mapped while they came.
    Mapped(Box<OnlineFrames>),
}

impl TrackedStream {
    /// Tracks the frames of a stream until it ends, and maps them where depth is measured and the
    /// camera is known. `observer` sees every pose as soon as it is known; its token does not end the
    /// stream, but the mapping of frames. Where poses do not come from the front end, nothing is done
    /// before the stream has ended.
    ///
    /// # Errors
    ///
    /// A decoder that cannot be started.
    pub fn track(
        live: &LiveSequence,
        options: &RunOptions,
        observer: impl Observer + 'static,
    ) -> Result<Self, RunError> {
        let estimate_distortion = match &options.poses {
            PoseSource::FrontEnd { estimate_distortion, .. } => *estimate_distortion,
            PoseSource::Map | PoseSource::Files { .. } => return Ok(Self::untracked()),
        };
        let (first, large) = (live.first(), live.first().at_least(ODOMETRY_SIDE));
        if options.poses.uses_depth() && has_small_pictures(first) {
            return Ok(Self::untracked());
        }
        let context = RunContext::new(observer);
        let source = Source { first, large: &large, has_depth: live.has_depth() };
        let of_preview = (first, source.has_depth);
        let makes_map =
            source.is_mapped(options) || MapPreview::is_wanted(of_preview, options, &context);
        // Decoded twice where a map is made of smaller pictures.
        let smaller = match makes_map && large.camera != first.camera {
            true => Some(live.frames(first)?),
            false => None,
        };
        let mut lag = Lag::default();
        let frames =
            live.frames(&large)?.inspect(|frame| lag.frame(frame.timestamp, Instant::now()));
        let settings = (options, estimate_distortion);
        let tracked = Self::of_frames(&source, (frames, smaller), settings, &context);
        lag.end(Instant::now());
        lag.note().iter().for_each(|note| context.observer.note(note));
        Ok(tracked)
    }

    /// Tracks frames in the size that is tracked until they end; others are the same in the size that is
    /// mapped, where it is another one.
    fn of_frames(
        source: &Source<'_>,
        (frames_tracked, mut smaller): (
            impl Iterator<Item = Frame>,
            Option<impl Iterator<Item = Frame>>,
        ),
        (options, estimate_distortion): (&RunOptions, bool),
        context: &RunContext,
    ) -> Self {
        let Source { first, large, has_depth } = *source;
        let camera = intrinsics(large, estimate_distortion);
        let is_mapped = source.is_mapped(options);
        let mut frames = match is_mapped {
            true => {
                let frames = OnlineFrames::start((first, large), options, context);
                TrackedFrames::Mapped(Box::new(frames))
            }
            false => {
                let hold_out = avoided_keyframes(options, None);
                let scratch = scratch_store(&options.config, &options.scratch_folder);
                let pictures = TrackedPictures::new(camera, hold_out).with_scratch(scratch);
                TrackedFrames::Unmapped(Box::new(pictures))
            }
        };
        let mut preview = match is_mapped {
            true => None,
            false => MapPreview::start((first, has_depth), options, context),
        };
        let mut timestamps = Vec::new();
        let mut focal_length = large.camera.fx;
        for (position, tracked) in frames_tracked.enumerate() {
            let stamps = timestamps_of(&tracked);
            let mapped = match &mut smaller {
                Some(smaller) => smaller.next().filter(|mapped| timestamps_of(mapped) == stamps),
                None => Some(tracked.clone()),
            };
            let mapped = match mapped {
                Some(mapped) => mapped,
                // One of the two went on without its depth: what was recorded has it.
                None if is_mapped => break,
                // A preview never ends the tracking of a stream.
                None => {
                    (preview, smaller) = (None, None);
                    tracked.clone()
                }
            };
            timestamps.push(stamps);
            let pose = frames.push(position, (tracked, mapped), preview.as_mut());
            let now = frames.focal_length();
            if let Some(now) = now.filter(|now| is_focal_length_changed(focal_length, *now)) {
                let width = large.camera.width;
                context.observer.note(&format!(
                    "the focal length is {now:.0} px now at a width of {width}, {focal_length:.0} before"
                ));
                focal_length = now;
            }
            pose.iter().for_each(|pose| context.observer.pose(pose));
            context.observer.progress(frames.stage(), position + 1, 0);
        }
        Self { frames: Some(frames), timestamps }
    }

    fn untracked() -> Self {
        Self { frames: None, timestamps: Vec::new() }
    }

    /// The frames, if all of the recorded sequence were tracked with the same time stamps and depth.
    /// Stamps that are missing in the stream are interpolated once it has ended, and differ.
    pub(super) fn of_sequence(self, sequence: &Sequence) -> Option<TrackedFrames> {
        let stamps = sequence.entries.iter().map(|entry| {
            let depth = entry.depth.as_ref().filter(|_| sequence.frames_with_depth() > 0);
            (entry.timestamp, depth.map(|depth| depth.timestamp))
        });
        let is_same = stamps.eq(self.timestamps);
        self.frames.filter(|frames| is_same && frames.given().refused.is_empty())
    }
}

/// Delay of the poses of a stream against its time stamps, counted from the first frame on. A file that is piped in
/// has one, too, where it is tracked more slowly than it was filmed.
#[derive(Clone, Copy, Debug, Default)]
struct Lag {
    /// Moment and time stamp of the first frame [s].
    first: Option<(Instant, f64)>,
    /// Time stamp of the last frame that was taken for tracking [s].
    last: f64,
    largest: f64,
}

impl Lag {
    /// A frame is taken for tracking, so that the one before has its pose.
    fn frame(&mut self, timestamp: f64, now: Instant) {
        match self.first {
            None => self.first = Some((now, timestamp)),
            Some(_) => self.end(now),
        }
        self.last = timestamp;
    }

    /// The last frame that was taken has its pose.
    fn end(&mut self, now: Instant) {
        if let Some((begin, stamp)) = self.first {
            let delay = (now - begin).as_secs_f64() - (self.last - stamp);
            self.largest = self.largest.max(delay);
        }
    }

    /// A note if poses came late.
    fn note(&self) -> Option<String> {
        (self.largest > MAX_LAG).then(|| {
            format!(
                "poses came up to {:.1} s late: fewer frames a second can be tracked in time",
                self.largest
            )
        })
    }
}

/// Time stamps of a frame and its depth [s].
fn timestamps_of(frame: &Frame) -> (f64, Option<f64>) {
    (frame.timestamp, frame.depth.as_ref().map(|depth| depth.timestamp))
}

impl TrackedFrames {
    fn push(
        &mut self,
        position: usize,
        (tracked, mapped): (Frame, Frame),
        preview: Option<&mut MapPreview<'_>>,
    ) -> Option<StampedPose> {
        let pictures = match self {
            Self::Unmapped(pictures) => pictures,
            Self::Mapped(frames) => return frames.push(position, (tracked, mapped)),
        };
        let tracking = preview.as_ref().map(|preview| preview.tracking());
        let _held = tracking.as_ref().map(|t| t.lock().unwrap_or_else(PoisonError::into_inner));
        let mut pose = None;
        pictures.push(position, &tracked, |front_end, update| {
            pose = stamped_pose(update, &tracked);
            if let Some(preview) = preview {
                preview.add(front_end, update, mapped);
            }
        });
        pose
    }

    /// Focal length with which the last pose was found [px], where the map does not count on it.
    fn focal_length(&self) -> Option<f64> {
        match self {
            Self::Unmapped(pictures) => Some(pictures.camera().fx),
            Self::Mapped(_) => None,
        }
    }

    fn given(&self) -> &GivenPictures {
        match self {
            Self::Unmapped(pictures) => &pictures.given,
            Self::Mapped(frames) => &frames.given,
        }
    }

    fn stage(&self) -> Stage {
        let keyframes = self.given().keyframes;
        match self {
            Self::Unmapped(_) => Stage::Odometry(keyframes::Stage::Tracking { keyframes }),
            Self::Mapped(_) => Stage::Online,
        }
    }
}

#[cfg(test)]
mod tests;

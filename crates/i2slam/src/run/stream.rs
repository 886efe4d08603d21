//! Streams: frames are tracked while they come, and mapped when the stream has ended.

use super::keyframes::{ODOMETRY_SIDE, intrinsics};
use super::observer::{Observer, Stage};
use super::{PoseSource, RunError, RunOptions};
use crate::keyframes::{self, TrackedPictures};
use i2slam_dataset::{LiveSequence, Sequence};

/// A stream by colour alone whose frames were tracked while they came.
///
/// ```no_run
/// use i2slam::run::{TrackedStream, reconstruct_stream};
/// use i2slam::{CancellationToken, RunOptions};
///
/// let options = RunOptions::colour_alone();
/// let live = options.open_stream("rtsp://camera/1".as_ref(), CancellationToken::default())?;
/// let tracked = TrackedStream::track(&live, &options, &())?;
/// let recorded = live.finish()?;
/// let outcome = reconstruct_stream(&recorded.sequence, tracked, &options, ())?;
/// println!("{}", outcome.reconstruction.map);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct TrackedStream {
    pub(super) pictures: TrackedPictures,
}

impl TrackedStream {
    /// Tracks the frames of a stream until it ends. `observer` sees every pose as soon as it is known,
    /// and cannot cancel: the stream can be ended.
    ///
    /// # Errors
    ///
    /// Poses that do not come from the front end by colour alone, and a decoder that cannot be
    /// started.
    pub fn track(
        live: &LiveSequence,
        options: &RunOptions,
        observer: &dyn Observer,
    ) -> Result<Self, RunError> {
        let PoseSource::FrontEnd { with_depth: false, estimate_distortion } = options.poses else {
            let (preset, with_depth) = (options.config.preset.clone(), true);
            return Err(RunError::Preset { preset, with_depth });
        };
        let large = live.first().at_least(ODOMETRY_SIDE);
        let mut pictures = TrackedPictures::new(intrinsics(&large, estimate_distortion));
        for (position, frame) in live.frames(&large)?.enumerate() {
            pictures.push(position, &frame).iter().for_each(|pose| observer.pose(pose));
            let keyframes = pictures.given.keyframes;
            let stage = keyframes::Stage::Tracking { keyframes };
            observer.progress(Stage::Odometry(stage), position + 1, 0);
        }
        Ok(Self { pictures })
    }

    /// True if all frames of the recorded sequence were tracked with the same time stamps. Stamps that
    /// are missing in the stream are interpolated once it has ended, and differ.
    pub(super) fn is_of(&self, sequence: &Sequence) -> bool {
        let TrackedPictures { given, timestamps, .. } = &self.pictures;
        let times = sequence.entries.iter().map(|entry| &entry.timestamp);
        given.refused.is_empty() && times.eq(timestamps)
    }
}

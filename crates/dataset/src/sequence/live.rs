//! Streams, whose frames are had while they come, and which are sequences once they have ended.

use super::{DEFAULT_FRAME_RATE, Frame, Sequence};
use crate::video::{LiveFrames, Recording};
use crate::{DatasetError, OpenOptions};
use i2slam_compute::CancellationToken;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Interval at which a stream without a whole frame so far is looked at.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// A stream that is being recorded: an address, a named pipe, or the standard input (see
/// [`is_stream`](crate::is_stream)).
#[derive(Debug)]
pub struct LiveSequence {
    recording: Recording,
    options: OpenOptions,
    first: Sequence,
}

/// A stream that has ended, in a temporary file that is removed on drop.
#[derive(Debug)]
pub struct RecordedSequence {
    /// All frames.
    pub sequence: Sequence,
    recording: Recording,
}

impl LiveSequence {
    /// Waits for the first frame of a stream, and records it until it ends by itself, `end` is
    /// cancelled, or [`MAX_RECORDING_BYTES`](crate::MAX_RECORDING_BYTES) are reached.
    ///
    /// # Errors
    ///
    /// No ffmpeg, a stream that gives no picture, no room on the disk, options that do not fit.
    pub fn open(
        stream: &Path,
        options: &OpenOptions,
        end: CancellationToken,
    ) -> Result<Self, DatasetError> {
        options.validate()?;
        let mut recording = Recording::start(stream, end)?;
        let of_first = OpenOptions { frames: Some(0..1), stride: 1, ..options.clone() };
        let mut tried = 0;
        let first = loop {
            let growing = recording.growing_bytes();
            if growing.is_none() {
                // What has no frame by now fails for a reason.
                recording.wait()?;
            }
            if growing.is_none_or(|bytes| bytes > tried) {
                tried = growing.unwrap_or_default();
                match Sequence::open(&recording.path(), &of_first) {
                    // Nothing can be decoded yet; other errors would stay.
                    Err(DatasetError::File { .. }) if growing.is_some() => {}
                    opened => break opened?,
                }
            }
            std::thread::sleep(POLL_INTERVAL);
        };
        Ok(Self { recording, options: options.clone(), first })
    }

    /// The stream as if it had its first frame alone: camera, and size of delivered frames.
    pub fn first(&self) -> &Sequence {
        &self.first
    }

    /// The frames as they come, delivered as those of `like`, which is [`first`](Self::first) or a
    /// larger copy of it. Frames that nobody asks for wait.
    ///
    /// # Errors
    ///
    /// The decoder cannot be started.
    pub fn frames(&self, like: &Sequence) -> Result<LiveFrameStream, DatasetError> {
        let Some(video) = like.loader.video.as_deref() else {
            return Err(DatasetError::file(&self.recording.path(), "expected a video"));
        };
        let decoded = video.follow(&self.recording)?;
        let like = like.clone();
        Ok(LiveFrameStream { decoded, like, options: self.options.clone(), next: 0, last: None })
    }

    /// Waits for the end of the stream.
    ///
    /// # Errors
    ///
    /// The recording failed, or no frame of it is asked for.
    pub fn finish(mut self) -> Result<RecordedSequence, DatasetError> {
        let warning = self.recording.wait()?;
        let mut sequence = Sequence::open(&self.recording.path(), &self.options)?;
        sequence.warnings.splice(0..0, warning);
        Ok(RecordedSequence { sequence, recording: self.recording })
    }
}

impl RecordedSequence {
    /// Path of the recorded video.
    pub fn path(&self) -> PathBuf {
        self.recording.path()
    }
}

/// Iterator over the chosen frames of a stream, each when it comes. Time stamps that are missing or
/// not increasing are extrapolated: a sequence of the whole stream interpolates them.
#[derive(Debug)]
pub struct LiveFrameStream {
    decoded: LiveFrames,
    like: Sequence,
    options: OpenOptions,
    /// Index of the next frame.
    next: usize,
    /// Time stamp of the last one [s].
    last: Option<f64>,
}

impl Iterator for LiveFrameStream {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        let range = self.options.frames.clone().unwrap_or(0..usize::MAX);
        while self.next < range.end {
            let (own, image) = self.decoded.next_frame()?;
            let index = self.next;
            self.next += 1;
            let last = self.last.unwrap_or(f64::NEG_INFINITY);
            let usual = self.last.map_or(0.0, |last| last + DEFAULT_FRAME_RATE.recip());
            let timestamp = own.filter(|own| *own > last).unwrap_or(usual);
            self.last = Some(timestamp);
            if index >= range.start && (index - range.start).is_multiple_of(self.options.stride) {
                return Some(self.like.loader.deliver(&image, (index, timestamp)));
            }
        }
        None
    }
}

//! Streams, whose frames are had while they come, and which are sequences once they have ended.

use super::live_pairing::{LivePairing, Paired};
use super::{DEFAULT_FRAME_RATE, Frame, Sequence};
use crate::formats::video_rules;
use crate::video::{LiveFrames, Recording, Video};
use crate::{DatasetError, DepthPairing, OpenOptions};
use i2slam_compute::CancellationToken;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

/// Interval at which a stream without a whole frame so far is looked at.
const POLL_INTERVAL: Duration = Duration::from_millis(50);

/// Time for which one track is looked at before the other is.
const TRACK_INTERVAL: Duration = Duration::from_millis(2);

/// A colour picture waits for depth while fewer than this have come after it, or depth comes.
const LATER_FRAMES: usize = 2;

/// Time for which depth was waited for in vain, after which none comes any more. Decoders take turns
/// with other threads, so that one may be late though its picture is in the file.
const SILENCE: Duration = Duration::from_secs(1);

/// Colour pictures that wait for depth, at most.
const MAX_WAITING: usize = 32;

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
        let mut recording = Recording::start((stream, !options.colour_only), end)?;
        let of_first = of_first(options);
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
                    Ok(first) if growing.is_some() && first.awaits_second_track() => {}
                    opened => break opened?,
                }
            }
            std::thread::sleep(POLL_INTERVAL);
        };
        Ok(Self { recording, options: options.clone(), first })
    }

    /// The stream with other options.
    ///
    /// # Errors
    ///
    /// Options that do not fit, or ask for depth where those before were for colour alone.
    pub fn with_options(self, options: &OpenOptions) -> Result<Self, DatasetError> {
        if *options == self.options {
            return Ok(self);
        }
        options.validate()?;
        if self.options.colour_only && !options.colour_only {
            let reason = "the stream is being recorded without depth";
            return Err(DatasetError::option("colour_only", reason));
        }
        let first = Sequence::open(&self.recording.path(), &of_first(options))?;
        Ok(Self { options: options.clone(), first, ..self })
    }

    /// The stream as if it had its first frame alone: camera, and size of delivered frames.
    pub fn first(&self) -> &Sequence {
        &self.first
    }

    /// Path of the video that is recorded, which grows, and is removed in the end.
    pub fn recording(&self) -> PathBuf {
        self.recording.path()
    }

    /// True if the stream has a depth track. Its first frame may lack depth.
    pub fn has_depth(&self) -> bool {
        self.first.loader.video.as_deref().is_some_and(Video::has_depth)
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
        let (colour, depth) = video.follow(&self.recording)?;
        Ok(LiveFrameStream {
            pairing: LivePairing::new(video_rules(&self.options), depth.is_some()),
            colour,
            depth,
            silence: Duration::ZERO,
            like: like.clone(),
            options: self.options.clone(),
            next: 0,
        })
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

impl Sequence {
    /// True while no picture of a second video track can be decoded.
    fn awaits_second_track(&self) -> bool {
        self.loader.video.as_deref().is_some_and(|video| video.awaits_second_track)
    }
}

/// Options for the first frame. Colour without depth is one: depth may begin later.
fn of_first(options: &OpenOptions) -> OpenOptions {
    let depth_pairing = DepthPairing::OneToOne;
    OpenOptions { frames: Some(0..1), stride: 1, depth_pairing, ..options.clone() }
}

impl RecordedSequence {
    /// Path of the recorded video.
    pub fn path(&self) -> PathBuf {
        self.recording.path()
    }
}

/// Iterator over the chosen frames of a stream, each when it comes and its depth is known. Time stamps
/// that are missing or not increasing are extrapolated: a sequence of the whole stream interpolates
/// them.
#[derive(Debug)]
pub struct LiveFrameStream {
    colour: LiveFrames,
    depth: Option<LiveFrames>,
    pairing: LivePairing<Vec<u8>, Arc<Vec<u8>>>,
    /// Time that depth was waited for since the last picture of it.
    silence: Duration,
    like: Sequence,
    options: OpenOptions,
    /// Index of the next frame.
    next: usize,
}

impl Iterator for LiveFrameStream {
    type Item = Frame;

    fn next(&mut self) -> Option<Frame> {
        let range = self.options.frames.clone().unwrap_or(0..usize::MAX);
        while self.next < range.end {
            let paired = self.next_paired()?;
            let index = self.next;
            self.next += usize::from(paired.is_frame);
            let is_chosen =
                index >= range.start && (index - range.start).is_multiple_of(self.options.stride);
            if paired.is_frame && is_chosen {
                return self.deliver(index, paired);
            }
        }
        None
    }
}

impl LiveFrameStream {
    fn deliver(&self, index: usize, paired: Paired<Vec<u8>, Arc<Vec<u8>>>) -> Option<Frame> {
        let loader = &self.like.loader;
        let video = loader.video.as_deref()?;
        let (timestamp, colour) = paired.colour;
        let mut frame = loader.deliver(&video.colour_image(&colour), (index, timestamp));
        if let Some((timestamp, depth)) = paired.depth {
            loader.deliver_depth(video.depth_image(&depth)?, timestamp, &mut frame);
        }
        Some(frame)
    }

    /// Waits for the next colour picture and its depth; `None` at the end.
    fn next_paired(&mut self) -> Option<Paired<Vec<u8>, Arc<Vec<u8>>>> {
        loop {
            let waiting = self.pairing.waiting();
            let is_silent = waiting > LATER_FRAMES && self.silence > SILENCE;
            if let Some(paired) = self.pairing.next(is_silent) {
                return Some(paired);
            }
            if self.pairing.waiting() == 0 && self.pairing.colour_has_ended {
                return None;
            }
            self.receive();
        }
    }

    /// Takes what has come of both tracks, or comes soon. Neither waits for the other.
    fn receive(&mut self) {
        let interval = DEFAULT_FRAME_RATE.recip();
        let (pairing, begun) = (&mut self.pairing, Instant::now());
        let mut has_come = false;
        if let Some(depth) = self.depth.as_ref().filter(|_| !pairing.depth_has_ended) {
            match depth.next_within(TRACK_INTERVAL) {
                Ok((own, bytes)) => {
                    pairing.push_depth(own, Arc::new(bytes), interval);
                    has_come = true;
                }
                Err(ended) => pairing.depth_has_ended = ended == RecvTimeoutError::Disconnected,
            }
        }
        if pairing.waiting() < MAX_WAITING && !pairing.colour_has_ended {
            match self.colour.next_within(TRACK_INTERVAL) {
                Ok((own, bytes)) => pairing.push_colour(own, bytes, interval),
                Err(ended) => pairing.colour_has_ended = ended == RecvTimeoutError::Disconnected,
            }
        }
        // The time that the receiver of frames takes is none that depth was waited for.
        self.silence = if has_come { Duration::ZERO } else { self.silence + begun.elapsed() };
    }
}

//! Loading of frames from their files, on demand or ahead on a thread.

use crate::DatasetError;
use crate::camera::Orientation;
use crate::formats::{DepthEntry, FrameEntry};
use crate::image::{
    DepthEncoding, ExpectedSize, Resampler, decode_colour, decode_depth, decode_doubtful,
};
use crate::video::Video;
use i2slam_geometry::Image;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, sync_channel};
use std::thread::JoinHandle;

/// Mean colour value below which a frame counts as black: two steps of 8 bits.
const BLACK: f64 = 2.0 / 255.0;

/// Mean colour value above which a frame counts as white.
const WHITE: f64 = 253.0 / 255.0;

/// One frame, ready to use.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Index in the associated stream, before the choice by range and stride.
    pub index: usize,
    /// Time stamp of the colour image [s].
    pub timestamp: f64,
    /// 3 planes R, G, B in `[0, 1]`, as recorded (display space).
    pub colour: Arc<Image<f32>>,
    /// Its depth; `None` for a frame without, and where only colour is read.
    pub depth: Option<DepthPicture>,
    /// Warnings: no valid depth, a black or a white image.
    pub warnings: Vec<String>,
}

/// The depth of a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct DepthPicture {
    /// 1 plane of the size of colour, depth along the optical axis [m], 0 where invalid.
    pub image: Arc<Image<f32>>,
    /// Time stamp [s]; the colour image's where depth has none of its own.
    pub timestamp: f64,
}

impl Frame {
    /// A frame without depth.
    pub fn colour_only(index: usize, timestamp: f64, colour: impl Into<Arc<Image<f32>>>) -> Self {
        Self { index, timestamp, colour: colour.into(), depth: None, warnings: Vec::new() }
    }

    /// Its depth image, if it has one: 1 plane [m], 0 where invalid.
    pub fn depth_image(&self) -> Option<&Image<f32>> {
        self.depth.as_ref().map(|depth| &*depth.image)
    }
}

/// Loads frames from files as configured when the sequence was opened.
#[derive(Clone, Debug)]
pub(crate) struct FrameLoader {
    pub(crate) resampler: Resampler,
    /// Depth image value of one metre.
    pub(crate) depth_scale: f64,
    /// Depth beyond this is invalid [m]; infinite for none.
    pub(crate) max_depth: f64,
    /// Encoding of depth images.
    pub(crate) depth_encoding: DepthEncoding,
    /// Depth image value that means "no reading", beside 0.
    pub(crate) invalid_depth: Option<u16>,
    /// Whether depth is not read.
    pub(crate) colour_only: bool,
    /// Orientation applied to colour images.
    pub(crate) orientation: Orientation,
    /// Decoder of the images, if the sequence is a video.
    pub(crate) video: Option<Arc<Video>>,
}

impl FrameLoader {
    /// Reads and resamples both images of a frame.
    pub(crate) fn load(&self, entry: &FrameEntry) -> Result<Frame, DatasetError> {
        let colour = match self.video.as_deref().filter(|video| video.is_at(&entry.colour)) {
            Some(video) => video.decode(entry.image_index)?,
            None => {
                let (shown, _) = self.resampler.recorded_sizes();
                // A transposition is its own inverse.
                let size = self.orientation.apply_to_size(shown);
                let expected = ExpectedSize { size, reference: "the other colour images" };
                let stored = decode_colour(&entry.colour, entry.colour_part(), expected)?;
                self.orientation.apply(stored)
            }
        };
        let mut frame = self.deliver(&colour, (entry.index, entry.timestamp));
        if let Some(depth) = entry.depth.as_ref().filter(|_| !self.colour_only) {
            self.deliver_depth(self.recorded_depth(entry, depth)?, depth.timestamp, &mut frame);
        }
        Ok(frame)
    }

    /// A frame without depth, resampled from a decoded image.
    pub(super) fn deliver(&self, decoded: &Image<f32>, (index, timestamp): (usize, f64)) -> Frame {
        let colour = self.resampler.colour(decoded);
        let warnings = colour_warning(&colour).into_iter().collect();
        Frame { warnings, ..Frame::colour_only(index, timestamp, colour) }
    }

    /// Size of the depth images.
    fn expected_depth(&self) -> ExpectedSize<'static> {
        let (colour, size) = self.resampler.recorded_sizes();
        let reference = if size == colour { "the colour images" } else { "the other depth images" };
        ExpectedSize { size, reference }
    }

    /// Reads the depth image of a frame as it was recorded, without readings of the least confidence.
    pub(super) fn recorded_depth(
        &self,
        entry: &FrameEntry,
        depth: &DepthEntry,
    ) -> Result<Image<u16>, DatasetError> {
        match self.video.as_deref().filter(|video| video.is_at(&depth.path)) {
            Some(video) => video.decode_depth(depth.index),
            None => {
                let (encoding, expected) = (self.depth_encoding, self.expected_depth());
                let mut image = decode_depth(&depth.path, entry.depth_part(), encoding, expected)?;
                if let Some(file) = &depth.confidence {
                    let part = entry.confidence_part();
                    let doubtful = decode_doubtful(file, part, encoding, expected)?;
                    let readings = image.data.iter_mut().zip(doubtful);
                    readings.filter(|(_, is_doubtful)| *is_doubtful).for_each(|(z, _)| *z = 0);
                }
                Ok(image)
            }
        }
    }

    /// Resamples recorded depth of a time [s] for a frame.
    pub(super) fn deliver_depth(&self, mut depth: Image<u16>, timestamp: f64, frame: &mut Frame) {
        if let Some(invalid) = self.invalid_depth {
            depth.data.iter_mut().filter(|value| **value == invalid).for_each(|value| *value = 0);
        }
        let image = self.resampler.depth(&depth, self.depth_scale, self.max_depth);
        frame.warnings.splice(0..0, depth_warning(&image));
        frame.depth = Some(DepthPicture { image: Arc::new(image), timestamp });
    }
}

fn depth_warning(depth: &Image<f32>) -> Option<String> {
    depth.data.iter().all(|&z| z == 0.0).then(|| "no pixel has a valid depth".to_owned())
}

fn colour_warning(colour: &Image<f32>) -> Option<String> {
    let sum: f64 = colour.data.iter().map(|&v| f64::from(v)).sum();
    let mean = sum / colour.data.len() as f64;
    if mean < BLACK {
        Some("the colour image is black".to_owned())
    } else if mean > WHITE {
        Some("the colour image is white".to_owned())
    } else {
        None
    }
}

/// Frames buffered ahead, which bounds memory.
const READ_AHEAD: usize = 4;

/// Iterator over all frames of a sequence in order; dropping it stops the reading thread.
#[derive(Debug)]
pub struct FrameStream {
    source: StreamSource,
}

#[derive(Debug)]
enum StreamSource {
    /// A thread reads ahead; `None` only while the stream is being dropped.
    Ahead { frames: Option<Receiver<Result<Frame, DatasetError>>>, thread: Option<JoinHandle<()>> },
    /// No thread could be started: frames are read on demand.
    OnDemand { entries: VecDeque<FrameEntry>, loader: Arc<FrameLoader> },
}

impl FrameStream {
    pub(crate) fn start(entries: Vec<FrameEntry>, loader: Arc<FrameLoader>) -> Self {
        let (sender, receiver) = sync_channel(READ_AHEAD);
        let (thread_entries, thread_loader) = (entries.clone(), Arc::clone(&loader));
        let read = move || {
            for entry in &thread_entries {
                if sender.send(thread_loader.load(entry)).is_err() {
                    break;
                }
            }
        };
        let source = match std::thread::Builder::new().name("read frames".into()).spawn(read) {
            Ok(thread) => StreamSource::Ahead { frames: Some(receiver), thread: Some(thread) },
            Err(_) => StreamSource::OnDemand { entries: entries.into(), loader },
        };
        Self { source }
    }
}

impl Iterator for FrameStream {
    type Item = Result<Frame, DatasetError>;

    fn next(&mut self) -> Option<Self::Item> {
        match &mut self.source {
            StreamSource::Ahead { frames, thread } => match frames.as_ref()?.recv() {
                Ok(frame) => Some(frame),
                Err(_) => {
                    propagate_panic(thread.take());
                    None
                }
            },
            StreamSource::OnDemand { entries, loader } => {
                entries.pop_front().map(|entry| loader.load(&entry))
            }
        }
    }
}

/// Propagates a panic of the reading thread, which must not look like the end of the sequence.
fn propagate_panic(thread: Option<JoinHandle<()>>) {
    if let Some(Err(panic)) = thread.map(JoinHandle::join) {
        std::panic::resume_unwind(panic);
    }
}

impl Drop for FrameStream {
    fn drop(&mut self) {
        if let StreamSource::Ahead { frames, thread } = &mut self.source {
            // Without a receiver the thread ends at its next frame.
            drop(frames.take());
            if let Some(thread) = thread.take() {
                // Its frames are no longer wanted, so a panic there does not matter.
                let _ = thread.join();
            }
        }
    }
}

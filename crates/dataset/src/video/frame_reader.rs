//! Random access to the frames of a video, with bounded memory.
//!
//! The decoder outputs frames in order. Steps forward wait for it, short steps back hit a cache of
//! recent frames, and longer ones restart the decoder at the first frame: slow, but exact in every
//! format, which seeking is not.

use super::ffmpeg::{Ffmpeg, parse_log};
use super::track::Pictures;
use crate::DatasetError;
use std::collections::VecDeque;
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;
use std::process::{Child, ChildStdout};
use std::sync::Arc;
use std::thread::JoinHandle;

/// Size of the cache of decoded frames [bytes].
const CACHE_BYTES: usize = 64 << 20;

/// Buffer size of the pipe [bytes].
const BUFFER_BYTES: usize = 1 << 18;

/// Reader of the pictures of a track.
#[derive(Debug)]
pub(super) struct FrameReader {
    ffmpeg: Ffmpeg,
    pictures: Pictures,
    decoder: Option<Decoder>,
    /// First frame that could not be decoded.
    ends_at: Option<usize>,
    /// Capacity of the cache [frames].
    capacity: usize,
    /// The last frames decoded, in order, with their numbers.
    cache: VecDeque<(usize, Arc<Vec<u8>>)>,
}

/// A running ffmpeg.
#[derive(Debug)]
struct Decoder {
    child: Child,
    images: BufReader<ChildStdout>,
    /// Thread that drains the log, which would block ffmpeg otherwise; gives the error.
    log: Option<JoinHandle<String>>,
    /// Number of the frame that comes next.
    next: usize,
}

impl FrameReader {
    pub(super) fn new(ffmpeg: Ffmpeg, pictures: Pictures) -> Self {
        let capacity = (CACHE_BYTES / pictures.bytes().max(1)).max(1);
        Self { ffmpeg, pictures, decoder: None, ends_at: None, capacity, cache: VecDeque::new() }
    }

    /// Sets the capacity of the cache [frames].
    #[cfg(test)]
    pub(super) fn with_capacity(self, capacity: usize) -> Self {
        Self { capacity, ..self }
    }

    /// Decodes the frame with a number, or takes it from the cache.
    pub(super) fn frame(
        &mut self,
        path: &Path,
        number: usize,
    ) -> Result<Arc<Vec<u8>>, DatasetError> {
        if let Some((_, image)) = self.cache.iter().find(|(cached, _)| *cached == number) {
            return Ok(Arc::clone(image));
        }
        if self.ends_at.is_some_and(|end| number >= end) {
            return Err(DatasetError::image(path, format!("frame {number} cannot be decoded")));
        }
        if self.decoder.as_ref().is_none_or(|decoder| decoder.next > number) {
            self.decoder = None;
            self.decoder = Some(Decoder::start(&self.ffmpeg, path, self.pictures)?);
            self.cache.clear();
        }
        while let Some(decoder) = &mut self.decoder {
            let this = decoder.next;
            let mut bytes = vec![0; self.pictures.bytes()];
            if let Err(error) = decoder.images.read_exact(&mut bytes) {
                self.ends_at = Some(this);
                let message = self.decoder.take().map(Decoder::end).unwrap_or_default();
                return Err(decode_error(path, this, &error, &message));
            }
            decoder.next += 1;
            let image = Arc::new(bytes);
            self.add_to_cache(this, &image);
            if this == number {
                return Ok(image);
            }
        }
        Err(DatasetError::file(path, format!("frame {number} cannot be decoded")))
    }

    fn add_to_cache(&mut self, number: usize, image: &Arc<Vec<u8>>) {
        self.cache.push_back((number, Arc::clone(image)));
        while self.cache.len() > self.capacity {
            self.cache.pop_front();
        }
    }
}

fn decode_error(path: &Path, at: usize, error: &std::io::Error, message: &str) -> DatasetError {
    let why = match error.kind() {
        ErrorKind::UnexpectedEof if message.is_empty() => "the decoder ended".to_owned(),
        ErrorKind::UnexpectedEof => format!("ffmpeg says: {message}"),
        _ => error.to_string(),
    };
    DatasetError::image(path, format!("frame {at} cannot be decoded: {why}"))
}

impl Decoder {
    fn start(ffmpeg: &Ffmpeg, path: &Path, pictures: Pictures) -> Result<Self, DatasetError> {
        let mut child = ffmpeg.decode(path, pictures)?;
        let Some(images) = child.stdout.take() else {
            return Err(DatasetError::file(path, "ffmpeg gives no pictures"));
        };
        let log = child.stderr.take().and_then(|stream| {
            let read = move || parse_log(stream).error().unwrap_or_default().to_owned();
            std::thread::Builder::new().name("ffmpeg log".into()).spawn(read).ok()
        });
        let images = BufReader::with_capacity(BUFFER_BYTES, images);
        Ok(Self { child, images, log, next: 0 })
    }

    /// Stops ffmpeg; returns its error, empty if there is none.
    fn end(mut self) -> String {
        let log = self.log.take();
        drop(self);
        log.and_then(|thread| thread.join().ok()).unwrap_or_default()
    }
}

impl Drop for Decoder {
    fn drop(&mut self) {
        // Fails only if ffmpeg has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

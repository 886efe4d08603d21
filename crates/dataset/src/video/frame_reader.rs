//! Decoded pictures of a video by their number, with bounded memory.
//!
//! A running decoder gives its frames in order. Whoever goes through a sequence from front to back
//! gets them as they come; a short way back leads to pictures that are kept, a longer one starts
//! the decoder anew at the first frame, which is slow but exact in every format.

use super::program::{Ffmpeg, words};
use crate::DatasetError;
use std::collections::VecDeque;
use std::io::{BufReader, ErrorKind, Read};
use std::path::Path;
use std::process::{Child, ChildStdout};
use std::sync::Arc;
use std::thread::JoinHandle;

/// Pictures kept take this much memory at most [bytes].
const KEPT: usize = 64 << 20;

/// Bytes of the pipe that are read at once.
const BUFFER: usize = 1 << 18;

/// The pictures of a video: three bytes a pixel, R G B.
#[derive(Debug)]
pub(super) struct Reader {
    ffmpeg: Ffmpeg,
    size: (usize, usize),
    running: Option<Running>,
    /// The first frame that did not come.
    ends_at: Option<usize>,
    /// How many pictures are kept.
    most: usize,
    /// The last pictures decoded, in order, under their numbers.
    kept: VecDeque<(usize, Arc<Vec<u8>>)>,
}

/// A decoder at work.
#[derive(Debug)]
struct Running {
    child: Child,
    pictures: BufReader<ChildStdout>,
    /// What it complains of; it would stand still if nobody listened.
    complaints: Option<JoinHandle<String>>,
    /// Number of the frame that comes next.
    next: usize,
}

impl Reader {
    pub(super) fn new(ffmpeg: Ffmpeg, size: (usize, usize)) -> Self {
        let most = (KEPT / (3 * size.0 * size.1).max(1)).max(1);
        Self { ffmpeg, size, running: None, ends_at: None, most, kept: VecDeque::new() }
    }

    /// The same, with so many pictures kept at most.
    #[cfg(test)]
    pub(super) fn keeping(self, most: usize) -> Self {
        Self { most, ..self }
    }

    /// The picture with a number.
    pub(super) fn picture(
        &mut self,
        path: &Path,
        number: usize,
    ) -> Result<Arc<Vec<u8>>, DatasetError> {
        if let Some((_, picture)) = self.kept.iter().find(|(kept, _)| *kept == number) {
            return Ok(Arc::clone(picture));
        }
        if self.ends_at.is_some_and(|end| number >= end) {
            return Err(DatasetError::image(path, format!("frame {number} cannot be decoded")));
        }
        if self.running.as_ref().is_none_or(|running| running.next > number) {
            self.running = None;
            self.running = Some(Running::start(&self.ffmpeg, path, self.size)?);
            self.kept.clear();
        }
        let length = 3 * self.size.0 * self.size.1;
        while let Some(running) = &mut self.running {
            let this = running.next;
            let mut bytes = vec![0; length];
            if let Err(error) = running.pictures.read_exact(&mut bytes) {
                self.ends_at = Some(this);
                let complaint = self.running.take().map(Running::end).unwrap_or_default();
                return Err(broken_off(path, this, &error, &complaint));
            }
            running.next += 1;
            let picture = Arc::new(bytes);
            self.keep(this, &picture);
            if this == number {
                return Ok(picture);
            }
        }
        Err(DatasetError::video(path, format!("frame {number} cannot be decoded")))
    }

    fn keep(&mut self, number: usize, picture: &Arc<Vec<u8>>) {
        self.kept.push_back((number, Arc::clone(picture)));
        while self.kept.len() > self.most {
            self.kept.pop_front();
        }
    }
}

fn broken_off(path: &Path, at: usize, error: &std::io::Error, complaint: &str) -> DatasetError {
    let why = match error.kind() {
        ErrorKind::UnexpectedEof if complaint.is_empty() => "the decoder ended".to_owned(),
        ErrorKind::UnexpectedEof => format!("ffmpeg says: {complaint}"),
        _ => error.to_string(),
    };
    DatasetError::image(path, format!("frame {at} cannot be decoded: {why}"))
}

impl Running {
    fn start(ffmpeg: &Ffmpeg, path: &Path, size: (usize, usize)) -> Result<Self, DatasetError> {
        let mut child = ffmpeg.decode(path, size)?;
        let Some(pictures) = child.stdout.take() else {
            return Err(DatasetError::video(path, "ffmpeg gives no pictures"));
        };
        let complaints = child.stderr.take().and_then(|stream| {
            let listen = move || words(stream).error().unwrap_or_default().to_owned();
            std::thread::Builder::new().name("hear ffmpeg".into()).spawn(listen).ok()
        });
        let pictures = BufReader::with_capacity(BUFFER, pictures);
        Ok(Self { child, pictures, complaints, next: 0 })
    }

    /// Ends it; what it complained of.
    fn end(mut self) -> String {
        let complaints = self.complaints.take();
        drop(self);
        complaints.and_then(|thread| thread.join().ok()).unwrap_or_default()
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

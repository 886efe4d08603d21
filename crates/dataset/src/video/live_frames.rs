//! Pictures of a video file that is still being written.
//!
//! The file is handed to the decoder as it grows. Reading does not hold up writing: frames that are
//! not asked for wait in the file.

use super::ffmpeg::{Ffmpeg, push_lines};
use super::ffmpeg_log::FfmpegLog;
use super::track::Pictures;
use crate::DatasetError;
use std::fs::File;
use std::io::{self, BufReader, Read, Write};
use std::path::Path;
use std::process::Child;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel, sync_channel};
use std::time::Duration;

/// Buffer size of the pipes [bytes].
const BUFFER_BYTES: usize = 1 << 18;
/// Interval at which a file is looked at that has no more to read yet.
const POLL_INTERVAL: Duration = Duration::from_millis(5);

/// The bytes of a picture and its own time stamp [s], if it has one.
pub(crate) type LivePicture = (Option<f64>, Vec<u8>);

/// Decoder of a track of a growing file: pictures in order.
#[derive(Debug)]
pub(crate) struct LiveFrames {
    child: Child,
    pictures: Receiver<LivePicture>,
    /// Tells the thread that reads the file to end.
    is_dropped: Arc<AtomicBool>,
}

impl LiveFrames {
    /// Decodes a track of a file from its beginning, waiting for more at its end until it is complete.
    pub(super) fn start(
        ffmpeg: &Ffmpeg,
        path: &Path,
        is_complete: Arc<AtomicBool>,
        pictures: Pictures,
    ) -> Result<Self, DatasetError> {
        let file = i2slam_storage::open(path).map_err(|e| DatasetError::read(path, e))?;
        let mut child = ffmpeg.follow(pictures)?;
        let (Some(to), Some(images), Some(log)) =
            (child.stdin.take(), child.stdout.take(), child.stderr.take())
        else {
            return Err(DatasetError::file(path, "ffmpeg gives no pictures"));
        };
        let is_dropped = Arc::<AtomicBool>::default();
        let ends = Arc::clone(&is_dropped);
        // An error ends the frames early, which who compares them with the complete file finds.
        std::thread::spawn(move || copy_growing(file, to, &is_complete, &ends));
        let (sender, timestamps) = channel();
        std::thread::spawn(move || {
            let (mut parsed, mut sent) = (FfmpegLog::default(), 0);
            push_lines(log, &mut parsed, |parsed| {
                while sent < parsed.frames.len() {
                    // Nobody may want them any more.
                    let _ = sender.send(parsed.own_timestamp(sent));
                    sent += 1;
                }
            });
        });
        // One picture is decoded ahead; what nobody asks for stays in the file.
        let (sender, decoded) = sync_channel(0);
        std::thread::spawn(move || {
            let mut images = BufReader::with_capacity(BUFFER_BYTES, images);
            let mut bytes = vec![0; pictures.bytes()];
            while images.read_exact(&mut bytes).is_ok() {
                let picture = (timestamps.recv().ok().flatten(), bytes.clone());
                if sender.send(picture).is_err() {
                    break;
                }
            }
        });
        Ok(Self { child, pictures: decoded, is_dropped })
    }

    /// The next picture, if it comes within a time; [`RecvTimeoutError::Disconnected`] after the last
    /// one.
    pub(crate) fn next_within(&self, time: Duration) -> Result<LivePicture, RecvTimeoutError> {
        self.pictures.recv_timeout(time)
    }
}

impl Drop for LiveFrames {
    fn drop(&mut self) {
        self.is_dropped.store(true, Ordering::Relaxed);
        // Fails only if ffmpeg has already ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Copies a file to the end that it has when it is complete.
fn copy_growing(
    mut from: File,
    mut to: impl Write,
    is_complete: &AtomicBool,
    is_dropped: &AtomicBool,
) -> io::Result<()> {
    let mut buffer = vec![0; BUFFER_BYTES];
    while !is_dropped.load(Ordering::Relaxed) {
        // Asked before reading: what is read then is all there is.
        let is_last = is_complete.load(Ordering::Acquire);
        let length = from.read(&mut buffer)?;
        to.write_all(&buffer[..length])?;
        match length {
            0 if is_last => return to.flush(),
            0 => std::thread::sleep(POLL_INTERVAL),
            _ => {}
        }
    }
    Ok(())
}

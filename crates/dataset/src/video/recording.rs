//! Streams that can be read only once: network addresses, named pipes and the standard input.
//!
//! A run reads its images several times, so a stream is first transcoded without loss (FFV1) into a
//! temporary video file.

use super::ffmpeg::{Ffmpeg, parse_log};
use super::ffmpeg_log::FfmpegLog;
use super::undecodable;
use crate::DatasetError;
use std::fs::{self, File};
use std::io::{self, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};
use std::process::Child;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Largest recording, approximately [bytes].
pub const MAX_RECORDING_BYTES: u64 = 8 << 30;

/// Interval at which the end condition is checked.
const POLL_INTERVAL: Duration = Duration::from_millis(20);
/// Time that ffmpeg gets to finish after an interrupt, before it is killed.
const GRACE_PERIOD: Duration = Duration::from_secs(3);
/// Buffer size of the pipe [bytes].
const BUFFER_BYTES: usize = 1 << 18;

/// Whether a path is a stream: `-` for the standard input, an address such as `rtsp://camera/1`, or
/// a named pipe.
pub fn is_stream(path: &Path) -> bool {
    is_standard_input(path) || is_address(path) || is_pipe(path)
}

fn is_standard_input(path: &Path) -> bool {
    path.as_os_str() == "-"
}

fn is_address(path: &Path) -> bool {
    path.to_str().is_some_and(|text| text.contains("://")) && !path.exists()
}

#[cfg(unix)]
fn is_pipe(path: &Path) -> bool {
    use std::os::unix::fs::FileTypeExt;
    fs::metadata(path).is_ok_and(|found| found.file_type().is_fifo())
}

#[cfg(not(unix))]
fn is_pipe(_: &Path) -> bool {
    false
}

/// The error for opening a stream as a sequence, if `path` is one.
pub(crate) fn refused_stream(path: &Path) -> Option<DatasetError> {
    is_stream(path).then(|| {
        let from = path.display();
        let reason = format!(
            "a stream can be read only once, by `i2slam run`: for anything else record it first, for \
             example with `ffmpeg -i {from} -t 60 -c copy clip.mkv`, and take that file"
        );
        DatasetError::file(path, reason)
    })
}

/// A recorded stream in a temporary file, which is removed on drop.
#[derive(Debug)]
pub struct Recording {
    folder: PathBuf,
    /// Warnings for the user, a sentence each.
    pub warnings: Vec<String>,
}

impl Recording {
    /// Records a stream until it ends, `should_end` returns true, or [`MAX_RECORDING_BYTES`] are
    /// reached.
    ///
    /// # Errors
    ///
    /// No ffmpeg, a stream that gives no picture, no room on the disk.
    pub fn record(stream: &Path, should_end: &dyn Fn() -> bool) -> Result<Self, DatasetError> {
        if is_standard_input(stream) && io::stdin().is_terminal() {
            let reason = "the standard input is a terminal, expected a video: \
                          `some program | i2slam run - --out DIR`";
            return Err(DatasetError::file(stream, reason));
        }
        Self::record_with(Ffmpeg::find(), stream, MAX_RECORDING_BYTES, should_end)
    }

    pub(super) fn record_with(
        mut ffmpeg: Ffmpeg,
        stream: &Path,
        max_bytes: u64,
        should_end: &dyn Fn() -> bool,
    ) -> Result<Self, DatasetError> {
        let mut recording = Self { folder: new_folder()?, warnings: Vec::new() };
        let mut ended = recording.read(&ffmpeg, stream, max_bytes, should_end)?;
        if ended.bytes == 0 && ffmpeg.retry_with_older_options(&ended.log) {
            // The options were refused before the stream was opened, so nothing is lost.
            ended = recording.read(&ffmpeg, stream, max_bytes, should_end)?;
        }
        if ended.bytes == 0 {
            return Err(undecodable(stream, &ended.log));
        }
        recording.warnings.extend(ended.warning(max_bytes));
        Ok(recording)
    }

    /// Path of the recorded video.
    pub fn path(&self) -> PathBuf {
        self.folder.join("stream.nut")
    }

    fn read(
        &self,
        ffmpeg: &Ffmpeg,
        stream: &Path,
        max_bytes: u64,
        should_end: &dyn Fn() -> bool,
    ) -> Result<RecordingEnd, DatasetError> {
        let path = self.path();
        let file = File::create(&path).map_err(|e| DatasetError::write(&path, e))?;
        let mut running = RecordingProcess::start(ffmpeg, stream, file)?;
        let mut interrupted_at = None;
        while !running.copying.is_finished() {
            let is_full = running.copied.load(Ordering::Relaxed) >= max_bytes;
            match interrupted_at {
                None if is_full || should_end() => {
                    running.interrupt();
                    interrupted_at = Some(Instant::now());
                }
                Some(when) if when.elapsed() > GRACE_PERIOD => running.kill(),
                _ => {}
            }
            std::thread::sleep(POLL_INTERVAL);
        }
        running.end(interrupted_at.is_none()).map_err(|e| DatasetError::write(&path, e))
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        // Failure leaves a file in the temporary folder, which the system cleans.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Creates an empty temporary folder.
fn new_folder() -> Result<PathBuf, DatasetError> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    loop {
        let number = COUNT.fetch_add(1, Ordering::Relaxed);
        let name = format!("i2slam-stream-{}-{number}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        match fs::create_dir(&folder) {
            Ok(()) => return Ok(folder),
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => {}
            Err(e) => return Err(DatasetError::write(&folder, e)),
        }
    }
}

/// Outcome of a recording.
struct RecordingEnd {
    bytes: u64,
    log: FfmpegLog,
    /// Whether the stream ended without being interrupted.
    by_itself: bool,
}

impl RecordingEnd {
    fn warning(&self, max_bytes: u64) -> Option<String> {
        if self.bytes >= max_bytes {
            let gigabytes = max_bytes as f64 / f64::from(1 << 30);
            return Some(format!(
                "the stream was read up to {gigabytes:.0} GB of pictures, which is all that is kept \
                 of one"
            ));
        }
        let error = self.log.error().filter(|_| self.by_itself)?;
        Some(format!("parts of the stream may be missing (ffmpeg says: {error})"))
    }
}

/// A running ffmpeg and the threads that drain its output and its log.
struct RecordingProcess {
    child: Child,
    copying: JoinHandle<io::Result<()>>,
    log: JoinHandle<FfmpegLog>,
    copied: Arc<AtomicU64>,
}

impl RecordingProcess {
    fn start(ffmpeg: &Ffmpeg, stream: &Path, file: File) -> Result<Self, DatasetError> {
        let mut child = ffmpeg.record(stream)?;
        let (Some(images), Some(log)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(DatasetError::file(stream, "ffmpeg gives no pictures"));
        };
        let copied = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&copied);
        let copying = std::thread::spawn(move || copy(images, file, &count));
        let log = std::thread::spawn(move || parse_log(log));
        Ok(Self { child, copying, log, copied })
    }

    /// Interrupts ffmpeg as Ctrl-C does, so that it completes the last frame.
    fn interrupt(&mut self) {
        #[cfg(unix)]
        let asked = {
            let mut kill = std::process::Command::new("kill");
            let kill = kill.arg("-INT").arg(self.child.id().to_string());
            kill.stderr(std::process::Stdio::null()).status().is_ok_and(|status| status.success())
        };
        #[cfg(not(unix))]
        let asked = false;
        if !asked {
            self.kill();
        }
    }

    fn kill(&mut self) {
        // Fails only if ffmpeg has already ended.
        let _ = self.child.kill();
    }

    fn end(mut self, by_itself: bool) -> io::Result<RecordingEnd> {
        let copied = self.copying.join().unwrap_or_else(|_| Err(io::Error::other("broken off")));
        // If writing failed, ffmpeg is still running.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let log = self.log.join().unwrap_or_default();
        copied?;
        Ok(RecordingEnd { bytes: self.copied.load(Ordering::Relaxed), log, by_itself })
    }
}

/// Copies to the end, counting bytes.
fn copy(mut from: impl Read, mut to: File, copied: &AtomicU64) -> io::Result<()> {
    let mut buffer = vec![0; BUFFER_BYTES];
    loop {
        let length = from.read(&mut buffer)?;
        if length == 0 {
            return Ok(());
        }
        to.write_all(&buffer[..length])?;
        copied.fetch_add(length as u64, Ordering::Relaxed);
    }
}

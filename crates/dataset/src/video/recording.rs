//! Streams that can be read only once: network addresses, named pipes and the standard input.
//!
//! A run reads its images several times, so a stream is transcoded without loss (FFV1) into a
//! temporary video file, whose frames can be read [while it grows](super::live_frames).

use super::ffmpeg::{Ffmpeg, parse_log};
use super::ffmpeg_log::FfmpegLog;
use super::undecodable;
use crate::DatasetError;
use i2slam_compute::CancellationToken;
use std::fs::{self, File};
use std::io::{self, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};
use std::process::Child;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
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

/// A stream that is recorded into a temporary file, which is removed on drop.
#[derive(Debug)]
pub(crate) struct Recording {
    folder: PathBuf,
    /// Set by the thread when the file is complete.
    is_complete: Arc<AtomicBool>,
    /// Set on drop.
    is_dropped: Arc<AtomicBool>,
    /// Gives a warning for the user.
    thread: Option<JoinHandle<Result<Option<String>, DatasetError>>>,
}

impl Recording {
    /// Starts to record a stream until it ends, `end` is cancelled, or [`MAX_RECORDING_BYTES`] are
    /// reached; `with_depth`: with a second video track, if there is one.
    pub(crate) fn start(
        (stream, with_depth): (&Path, bool),
        end: CancellationToken,
    ) -> Result<Self, DatasetError> {
        if is_standard_input(stream) && io::stdin().is_terminal() {
            let reason = "the standard input is a terminal, expected a video: \
                          `some program | i2slam run - --out DIR`";
            return Err(DatasetError::file(stream, reason));
        }
        Self::start_with(Ffmpeg::find(), (stream, with_depth), MAX_RECORDING_BYTES, end)
    }

    pub(super) fn start_with(
        ffmpeg: Ffmpeg,
        (stream, with_depth): (&Path, bool),
        max_bytes: u64,
        end: CancellationToken,
    ) -> Result<Self, DatasetError> {
        let folder = new_folder()?;
        let (is_complete, is_dropped) =
            (Arc::<AtomicBool>::default(), Arc::<AtomicBool>::default());
        let mut recording = Self { folder, is_complete, is_dropped, thread: None };
        let (path, stream) = (recording.path(), stream.to_path_buf());
        let is_complete = CompleteOnDrop(Arc::clone(&recording.is_complete));
        let is_dropped = Arc::clone(&recording.is_dropped);
        let ends = move || end.is_cancelled() || is_dropped.load(Ordering::Relaxed);
        recording.thread = Some(std::thread::spawn(move || {
            let recorded = record(ffmpeg, (&stream, with_depth), (&path, max_bytes), &ends);
            drop(is_complete);
            recorded
        }));
        Ok(recording)
    }

    /// Path of the recorded video, which grows.
    pub(crate) fn path(&self) -> PathBuf {
        self.folder.join("stream.nut")
    }

    /// A flag that is set when the video is complete.
    pub(super) fn is_complete(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.is_complete)
    }

    /// Size of the video so far [bytes]; `None` once it is complete.
    pub(crate) fn growing_bytes(&self) -> Option<u64> {
        let bytes = fs::metadata(self.path()).map_or(0, |file| file.len());
        (!self.is_complete.load(Ordering::Acquire)).then_some(bytes)
    }

    /// Waits until the video is complete; returns a warning for the user, once.
    ///
    /// # Errors
    ///
    /// No ffmpeg, a stream that gives no picture, no room on the disk.
    pub(crate) fn wait(&mut self) -> Result<Option<String>, DatasetError> {
        let Some(thread) = self.thread.take() else { return Ok(None) };
        thread.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        self.is_dropped.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
        // Failure leaves a file in the temporary folder, which the system cleans.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// Sets a flag when the thread that holds it ends, in whatever way.
struct CompleteOnDrop(Arc<AtomicBool>);

impl Drop for CompleteOnDrop {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Release);
    }
}

/// Records a stream into a file of a largest size; returns a warning for the user.
fn record(
    mut ffmpeg: Ffmpeg,
    stream: (&Path, bool),
    file: (&Path, u64),
    ends: &dyn Fn() -> bool,
) -> Result<Option<String>, DatasetError> {
    let mut ended = record_once(&ffmpeg, stream, file, ends)?;
    if ended.bytes == 0 && ffmpeg.retry_with_older_options(&ended.log) {
        // The options were refused before the stream was opened, so nothing is lost.
        ended = record_once(&ffmpeg, stream, file, ends)?;
    }
    if ended.bytes == 0 {
        return Err(undecodable(stream.0, &ended.log));
    }
    Ok(ended.warning(file.1))
}

fn record_once(
    ffmpeg: &Ffmpeg,
    stream: (&Path, bool),
    (path, max_bytes): (&Path, u64),
    ends: &dyn Fn() -> bool,
) -> Result<RecordingEnd, DatasetError> {
    let file = File::create(path).map_err(|e| DatasetError::write(path, e))?;
    let mut running = RecordingProcess::start(ffmpeg, stream, file)?;
    let mut interrupted_at = None;
    while !running.copying.is_finished() {
        let is_full = running.copied.load(Ordering::Relaxed) >= max_bytes;
        match interrupted_at {
            None if is_full || ends() => {
                running.interrupt();
                interrupted_at = Some(Instant::now());
            }
            Some(when) if when.elapsed() > GRACE_PERIOD => running.kill(),
            _ => {}
        }
        std::thread::sleep(POLL_INTERVAL);
    }
    running.end(interrupted_at.is_none()).map_err(|e| DatasetError::write(path, e))
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
    fn start(
        ffmpeg: &Ffmpeg,
        (stream, with_depth): (&Path, bool),
        file: File,
    ) -> Result<Self, DatasetError> {
        let mut child = ffmpeg.record(stream, with_depth)?;
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

//! Streams: what the program ffmpeg can read and nobody can read twice, such as an address, a named
//! pipe or the standard input.
//!
//! A run needs its pictures several times. So a stream is decoded once, from its beginning to its
//! end, and kept without loss (FFV1) in a file of its own, which is a video like any other and goes
//! when the recording does.

use super::program::{Ffmpeg, words};
use super::refusal;
use super::words::Words;
use crate::DatasetError;
use std::fs::{self, File};
use std::io::{self, IsTerminal, Read, Write};
use std::path::{Path, PathBuf};
use std::process::Child;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// A recording takes about this much of the disk at most [bytes].
pub const MAX_RECORDING_BYTES: u64 = 8 << 30;

/// How often it is asked whether the reading should end.
const PATIENCE: Duration = Duration::from_millis(20);
/// How long it may take to end once it is asked to, before it is stopped.
const GRACE: Duration = Duration::from_secs(3);
/// Bytes that are copied at once.
const BUFFER: usize = 1 << 18;

/// Whether a path is no file but something that flows: `-` for the standard input, an address such
/// as `rtsp://camera/1`, or a named pipe.
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

/// Why a stream is no sequence as it is.
pub(crate) fn refused_stream(path: &Path) -> Option<DatasetError> {
    is_stream(path).then(|| {
        let from = path.display();
        let reason = format!(
            "a stream can be read only once, by `i2slam run`: for anything else record it first, for \
             example with `ffmpeg -i {from} -t 60 -c copy clip.mkv`, and take that file"
        );
        DatasetError::video(path, reason)
    })
}

/// What a stream gave, in a file that is removed with it.
#[derive(Debug)]
pub struct Recording {
    folder: PathBuf,
    /// What a user should know of it.
    pub warnings: Vec<String>,
}

impl Recording {
    /// Reads a stream until it ends, until `should_end` says so, or until there is no more room for
    /// it ([`MAX_RECORDING_BYTES`]).
    ///
    /// # Errors
    ///
    /// No ffmpeg, a stream that gives no picture, no room on the disk.
    pub fn of(stream: &Path, should_end: &dyn Fn() -> bool) -> Result<Self, DatasetError> {
        if is_standard_input(stream) && io::stdin().is_terminal() {
            let reason = "the standard input is a terminal, expected a video: \
                          `some program | i2slam run - --out DIR`";
            return Err(DatasetError::video(stream, reason));
        }
        Self::with(Ffmpeg::find(), stream, MAX_RECORDING_BYTES, should_end)
    }

    pub(super) fn with(
        mut ffmpeg: Ffmpeg,
        stream: &Path,
        most: u64,
        should_end: &dyn Fn() -> bool,
    ) -> Result<Self, DatasetError> {
        let mut recording = Self { folder: new_folder()?, warnings: Vec::new() };
        let mut ended = recording.read(&ffmpeg, stream, most, should_end)?;
        if ended.bytes == 0 && ffmpeg.is_older(&ended.words) {
            // It refused the words it was called with, before it opened the stream.
            ended = recording.read(&ffmpeg, stream, most, should_end)?;
        }
        if ended.bytes == 0 {
            return Err(refusal(stream, &ended.words));
        }
        recording.warnings.extend(ended.warning(most));
        Ok(recording)
    }

    /// The video.
    pub fn path(&self) -> PathBuf {
        self.folder.join("stream.nut")
    }

    fn read(
        &self,
        ffmpeg: &Ffmpeg,
        stream: &Path,
        most: u64,
        should_end: &dyn Fn() -> bool,
    ) -> Result<Ended, DatasetError> {
        let path = self.path();
        let file = File::create(&path).map_err(|e| DatasetError::write(&path, e))?;
        let mut running = Running::start(ffmpeg, stream, file)?;
        let mut asked = None;
        while !running.copying.is_finished() {
            let is_full = running.copied.load(Ordering::Relaxed) >= most;
            match asked {
                None if is_full || should_end() => {
                    running.ask_to_end();
                    asked = Some(Instant::now());
                }
                Some(when) if when.elapsed() > GRACE => running.stop(),
                _ => {}
            }
            std::thread::sleep(PATIENCE);
        }
        running.end(asked.is_none()).map_err(|e| DatasetError::write(&path, e))
    }
}

impl Drop for Recording {
    fn drop(&mut self) {
        // What cannot be removed is left to the system.
        let _ = fs::remove_dir_all(&self.folder);
    }
}

/// An empty folder of our own.
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

/// How the reading came to its end.
struct Ended {
    bytes: u64,
    words: Words,
    /// Nobody asked it to.
    by_itself: bool,
}

impl Ended {
    fn warning(&self, most: u64) -> Option<String> {
        if self.bytes >= most {
            let gigabytes = most as f64 / f64::from(1 << 30);
            return Some(format!(
                "the stream was read up to {gigabytes:.0} GB of pictures, which is all that is kept \
                 of one"
            ));
        }
        let error = self.words.error().filter(|_| self.by_itself)?;
        Some(format!("parts of the stream may be missing (ffmpeg says: {error})"))
    }
}

/// A decoder at work, and who copies what it gives.
struct Running {
    child: Child,
    copying: JoinHandle<io::Result<()>>,
    hearing: JoinHandle<Words>,
    copied: Arc<AtomicU64>,
}

impl Running {
    fn start(ffmpeg: &Ffmpeg, stream: &Path, file: File) -> Result<Self, DatasetError> {
        let mut child = ffmpeg.record(stream)?;
        let (Some(pictures), Some(said)) = (child.stdout.take(), child.stderr.take()) else {
            return Err(DatasetError::video(stream, "ffmpeg gives no pictures"));
        };
        let copied = Arc::new(AtomicU64::new(0));
        let count = Arc::clone(&copied);
        let copying = std::thread::spawn(move || copy(pictures, file, &count));
        let hearing = std::thread::spawn(move || words(said));
        Ok(Self { child, copying, hearing, copied })
    }

    /// As Ctrl-C asks it: its last frame is then whole.
    fn ask_to_end(&mut self) {
        #[cfg(unix)]
        let asked = {
            let mut kill = std::process::Command::new("kill");
            let kill = kill.arg("-INT").arg(self.child.id().to_string());
            kill.stderr(std::process::Stdio::null()).status().is_ok_and(|status| status.success())
        };
        #[cfg(not(unix))]
        let asked = false;
        if !asked {
            self.stop();
        }
    }

    fn stop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
    }

    fn end(mut self, by_itself: bool) -> io::Result<Ended> {
        let copied = self.copying.join().unwrap_or_else(|_| Err(io::Error::other("broken off")));
        // Where nothing more can be written it would go on.
        let _ = self.child.kill();
        let _ = self.child.wait();
        let words = self.hearing.join().unwrap_or_default();
        copied?;
        Ok(Ended { bytes: self.copied.load(Ordering::Relaxed), words, by_itself })
    }
}

/// Copies until the end.
fn copy(mut from: impl Read, mut to: File, copied: &AtomicU64) -> io::Result<()> {
    let mut buffer = vec![0; BUFFER];
    loop {
        let length = from.read(&mut buffer)?;
        if length == 0 {
            return Ok(());
        }
        to.write_all(&buffer[..length])?;
        copied.fetch_add(length as u64, Ordering::Relaxed);
    }
}

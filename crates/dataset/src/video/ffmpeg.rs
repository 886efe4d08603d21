//! The program `ffmpeg`, which decodes.

use super::words::Words;
use crate::DatasetError;
use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Names the program where it is not on the search path.
const VARIABLE: &str = "I2SLAM_FFMPEG";

/// How every frame is passed on once, whatever its time: the name of that option since ffmpeg 5.1,
/// and before.
const ALL_FRAMES: [[&str; 2]; 2] = [["-fps_mode", "passthrough"], ["-vsync", "0"]];

/// A program that decodes a file.
#[derive(Clone, Debug)]
pub(super) struct Ffmpeg {
    program: PathBuf,
    /// Place in [`ALL_FRAMES`].
    era: usize,
}

impl Ffmpeg {
    /// The program that the environment names, else the one on the search path.
    pub(super) fn find() -> Self {
        let named = std::env::var_os(VARIABLE).filter(|name| !name.is_empty());
        Self::at(named.unwrap_or_else(|| OsString::from("ffmpeg")).into())
    }

    /// The program of a name or path.
    pub(super) fn at(program: PathBuf) -> Self {
        Self { program, era: 0 }
    }

    /// What is said of the video in `path` while its frames, `count` of them at most, pass through
    /// `filter` to nowhere.
    pub(super) fn listen(
        &mut self,
        path: &Path,
        filter: &str,
        count: Option<usize>,
    ) -> Result<Words, DatasetError> {
        let words = self.listen_once(path, filter, count)?;
        if words.frames.is_empty() && self.is_older(&words) {
            return self.listen_once(path, filter, count);
        }
        Ok(words)
    }

    /// Whether it did not know how frames are passed on, and is to be asked in older words from now
    /// on.
    pub(super) fn is_older(&mut self, words: &Words) -> bool {
        let is_older = self.era + 1 < ALL_FRAMES.len() && words.blames("fps_mode");
        self.era += usize::from(is_older);
        is_older
    }

    fn listen_once(
        &self,
        path: &Path,
        filter: &str,
        count: Option<usize>,
    ) -> Result<Words, DatasetError> {
        let mut command = self.command("level+info", path, filter);
        if let Some(count) = count {
            command.args(["-frames:v", &count.to_string()]);
        }
        command.args(["-f", "null", "-"]).stdout(Stdio::null());
        let mut child = self.start(&mut command)?;
        let words = child.stderr.take().map(words).unwrap_or_default();
        // How it ended is in what it said.
        let _ = child.wait();
        Ok(words)
    }

    /// Starts to decode: pictures of `width` times `height` pixels, three bytes each, R G B, one
    /// behind the other on its standard output.
    pub(super) fn decode(
        &self,
        path: &Path,
        (width, height): (usize, usize),
    ) -> Result<Child, DatasetError> {
        let filter = format!(
            "scale={width}:{height}:flags=area+accurate_rnd+full_chroma_int,setsar=1,format=rgb24"
        );
        let mut command = self.command("level+error", path, &filter);
        command.args(["-f", "rawvideo", "-"]).stdout(Stdio::piped());
        self.start(&mut command)
    }

    /// Starts to decode what can be read once only: every frame once, without loss, as a video on
    /// its standard output.
    pub(super) fn record(&self, stream: &Path) -> Result<Child, DatasetError> {
        let mut command = self.reading("level+warning", stream.as_os_str());
        command.args(["-c:v", "ffv1", "-flush_packets", "1", "-f", "nut", "-"]);
        if stream.as_os_str() == "-" {
            command.stdin(Stdio::inherit());
        }
        self.start(command.stdout(Stdio::piped()))
    }

    fn command(&self, level: &str, path: &Path, filter: &str) -> Command {
        // An absolute path is never taken for a protocol or an option.
        let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
        let mut command = self.reading(level, whole.as_os_str());
        command.args(["-vf", filter]);
        command
    }

    /// The first video of a source, frame by frame.
    fn reading(&self, level: &str, source: &OsStr) -> Command {
        let mut command = Command::new(&self.program);
        command.args(["-hide_banner", "-nostdin", "-nostats", "-v", level, "-i"]).arg(source);
        command.args(["-map", "0:V:0"]).args(ALL_FRAMES[self.era]);
        command.stdin(Stdio::null()).stderr(Stdio::piped());
        apart(&mut command);
        command
    }

    fn start(&self, command: &mut Command) -> Result<Child, DatasetError> {
        command.spawn().map_err(|source| DatasetError::NoFfmpeg {
            program: self.program.clone(),
            named: std::env::var_os(VARIABLE).is_some_and(|name| !name.is_empty()),
            source,
        })
    }
}

/// Ctrl-C is for this program, which still has pictures to read when it ends a run.
fn apart(command: &mut Command) {
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(command, 0);
    #[cfg(windows)]
    {
        const CREATE_NEW_PROCESS_GROUP: u32 = 0x200;
        std::os::windows::process::CommandExt::creation_flags(command, CREATE_NEW_PROCESS_GROUP);
    }
    #[cfg(not(any(unix, windows)))]
    let _ = command;
}

/// Everything that is said, to the end.
pub(super) fn words(stream: impl Read) -> Words {
    let mut words = Words::default();
    let mut reader = BufReader::new(stream);
    let mut line = Vec::new();
    while matches!(reader.read_until(b'\n', &mut line), Ok(length) if length > 0) {
        words.take_in(String::from_utf8_lossy(&line).trim());
        line.clear();
    }
    words
}

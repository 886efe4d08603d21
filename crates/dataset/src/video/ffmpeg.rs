//! Calls of the program `ffmpeg`.

use super::allowed::Allowed;
use super::encode::VideoFormat;
use super::ffmpeg_log::FfmpegLog;
use super::track::{Pictures, Track};
use crate::DatasetError;
use std::ffi::{OsStr, OsString};
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Environment variable with the path of ffmpeg.
const FFMPEG_VARIABLE: &str = "I2SLAM_FFMPEG";

/// Filters of pictures that are encoded: even sides, and the colours of BT.709 as the file says.
const ENCODED: &str =
    "crop=trunc(iw/2)*2:trunc(ih/2)*2:0:0,scale=out_color_matrix=bt709:out_range=tv";

/// Option that outputs every frame once whatever its time, since ffmpeg 5.1 and before.
const PASSTHROUGH: [[&str; 2]; 2] = [["-fps_mode", "passthrough"], ["-vsync", "0"]];

/// Part of a track, from its start.
#[derive(Clone, Copy, Debug)]
pub(super) enum Part {
    All,
    /// At most so many frames.
    Frames(usize),
    /// A length in time [s].
    Seconds(f64),
}

/// The ffmpeg program.
#[derive(Clone, Debug)]
pub(super) struct Ffmpeg {
    program: PathBuf,
    /// Index into [`PASSTHROUGH`].
    option_version: usize,
}

impl Ffmpeg {
    /// The program named by `I2SLAM_FFMPEG`, else the one on the search path.
    pub(super) fn find() -> Self {
        let named = std::env::var_os(FFMPEG_VARIABLE).filter(|name| !name.is_empty());
        Self::at(named.unwrap_or_else(|| OsString::from("ffmpeg")).into())
    }

    /// The program with a name or path.
    pub(super) fn at(program: PathBuf) -> Self {
        Self { program, option_version: 0 }
    }

    /// Decodes `part` of a track of a video through `filter`, discards it and parses the log.
    pub(super) fn read_log(
        &mut self,
        (path, track): (&Path, Track),
        filter: &str,
        part: Part,
    ) -> Result<FfmpegLog, DatasetError> {
        let log = self.read_log_once((path, track), filter, part)?;
        if log.frames.is_empty() && self.retry_with_older_options(&log) {
            return self.read_log_once((path, track), filter, part);
        }
        Ok(log)
    }

    /// Switches to the options of older versions if the log says that the current ones are unknown;
    /// true if the call is to be repeated.
    pub(super) fn retry_with_older_options(&mut self, log: &FfmpegLog) -> bool {
        let is_older = self.option_version + 1 < PASSTHROUGH.len() && log.mentions("fps_mode");
        self.option_version += usize::from(is_older);
        is_older
    }

    fn read_log_once(
        &self,
        (path, track): (&Path, Track),
        filter: &str,
        part: Part,
    ) -> Result<FfmpegLog, DatasetError> {
        let mut command = self.command("level+info", (path, track), filter);
        match part {
            Part::All => {}
            Part::Frames(count) => {
                command.args(["-frames:v", &count.to_string()]);
            }
            Part::Seconds(length) => {
                command.args(["-t", &format!("{length:.6}")]);
            }
        }
        command.args(["-f", "null", "-"]).stdout(Stdio::null());
        let mut child = self.start(&mut command)?;
        let log = child.stderr.take().map(parse_log).unwrap_or_default();
        // The log holds the cause of any failure.
        let _ = child.wait();
        Ok(log)
    }

    /// Starts decoding to standard output.
    pub(super) fn decode(&self, path: &Path, pictures: Pictures) -> Result<Child, DatasetError> {
        let filter = pictures.filter();
        let mut command = self.command("level+error", (path, pictures.track), &filter);
        command.args(["-f", "rawvideo", "-"]).stdout(Stdio::piped());
        self.start(&mut command)
    }

    /// Starts decoding a recording from standard input as [`decode`](Self::decode) does, with the time
    /// stamps of pictures in the log, each as soon as it can be.
    pub(super) fn follow(&self, pictures: Pictures) -> Result<Child, DatasetError> {
        let at_once = ["-fpsprobesize", "0", "-threads", "1", "-f", "nut"];
        let allowed = Allowed::stream(Path::new("-"));
        let mut command = self.input_command("level+info", ("-".as_ref(), &at_once), &allowed);
        command.args(["-map", pictures.track.map()]);
        command.args(["-vf", &format!("showinfo,{}", pictures.filter())]);
        // On several threads even raw pictures are encoded a picture late.
        command.args(["-threads", "1", "-flush_packets", "1", "-f", "rawvideo", "-"]);
        self.start(command.stdin(Stdio::piped()).stdout(Stdio::piped()))
    }

    /// Starts transcoding a stream to standard output: lossless FFV1, every frame once. `with_depth`:
    /// the second video track too, if there is one.
    pub(super) fn record(&self, stream: &Path, with_depth: bool) -> Result<Child, DatasetError> {
        let allowed = Allowed::stream(stream);
        // Twenty frames would be read before the first one is handed on, to guess a frame rate, and
        // decoders that work on several frames at a time are as many frames late.
        let at_once = ["-fpsprobesize", "0", "-thread_type", "slice"];
        let source = (stream.as_os_str(), &at_once[..]);
        let mut command = self.input_command("level+warning", source, &allowed);
        command.args(["-map", Track::Colour.map()]);
        if with_depth {
            command.args(["-map", &format!("{}?", Track::Depth.map())]);
        }
        // Stamps are rounded to multiples of a guessed frame interval otherwise, each track to others,
        // and a track waits for the other.
        command.args(["-enc_time_base", "1/1000000", "-max_interleave_delta", "1"]);
        command.args(["-c:v", "ffv1", "-flush_packets", "1", "-f", "nut", "-"]);
        if stream.as_os_str() == "-" {
            command.stdin(Stdio::inherit());
        }
        self.start(command.stdout(Stdio::piped()))
    }

    /// Starts encoding pictures from standard input to a new MP4 file.
    pub(super) fn encode(
        &self,
        path: &Path,
        format: VideoFormat<'_>,
    ) -> Result<Child, DatasetError> {
        let has_h264 = self.has_encoder("libx264")?;
        let codec: &[&str] = match has_h264 {
            true => &["-c:v", "libx264", "-crf", "18"],
            false => &["-c:v", "mpeg4", "-q:v", "2"],
        };
        let (width, height) = format.size;
        let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
        let mut command = Command::new(&self.program);
        command.args(["-hide_banner", "-nostats", "-v", "error", "-n", "-f", "rawvideo"]);
        command.args(["-pix_fmt", "rgb24", "-s", &format!("{width}x{height}")]);
        command.args(["-r", &format.rate.to_string(), "-i", "-"]);
        command.args(["-vf", ENCODED, "-pix_fmt", "yuv420p"]);
        // Players take what is not said for BT.709 or for BT.601, by the size.
        command.args(["-colorspace", "bt709", "-color_primaries", "bt709"]);
        command.args(["-color_trc", "bt709", "-color_range", "tv"]);
        command.args(codec).args(["-movflags", "+faststart"]);
        command.args(["-metadata", &format!("comment={}", format.comment), "-f", "mp4"]);
        command.arg(whole).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        detach_from_terminal(&mut command);
        self.start(&mut command)
    }

    fn has_encoder(&self, name: &str) -> Result<bool, DatasetError> {
        let mut command = Command::new(&self.program);
        command.args(["-hide_banner", "-v", "error", "-encoders"]).stdin(Stdio::null());
        command.stdout(Stdio::piped()).stderr(Stdio::null());
        detach_from_terminal(&mut command);
        let list = self.start(&mut command)?.wait_with_output();
        Ok(list.is_ok_and(|list| String::from_utf8_lossy(&list.stdout).contains(name)))
    }

    fn command(&self, level: &str, (path, track): (&Path, Track), filter: &str) -> Command {
        // An absolute path is never taken for a protocol or an option.
        let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
        let mut command = self.input_command(level, (whole.as_os_str(), &[]), &Allowed::file());
        command.args(["-map", track.map(), "-vf", filter]);
        command
    }

    /// The arguments that read a source with some options, every frame once.
    fn input_command(
        &self,
        level: &str,
        (source, options): (&OsStr, &[&str]),
        allowed: &Allowed,
    ) -> Command {
        let mut command = Command::new(&self.program);
        command.args(["-hide_banner", "-nostdin", "-nostats", "-v", level]);
        command.args(["-protocol_whitelist", &allowed.protocols]);
        command.args(["-format_whitelist", &allowed.containers]).args(options);
        command.arg("-i").arg(source);
        command.args(PASSTHROUGH[self.option_version]);
        command.stdin(Stdio::null()).stderr(Stdio::piped());
        detach_from_terminal(&mut command);
        command
    }

    fn start(&self, command: &mut Command) -> Result<Child, DatasetError> {
        command.spawn().map_err(|source| DatasetError::NoFfmpeg {
            program: self.program.clone(),
            named: std::env::var_os(FFMPEG_VARIABLE).is_some_and(|name| !name.is_empty()),
            source,
        })
    }
}

/// Gives ffmpeg a process group of its own: Ctrl-C must not end it, since the run still reads
/// images while it stops.
fn detach_from_terminal(command: &mut Command) {
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

/// Largest part of a line that is parsed at once [bytes]: a file decides what ffmpeg logs about it.
const MAX_LINE: u64 = 1 << 16;

/// Parses a log to its end.
pub(super) fn parse_log(stream: impl Read) -> FfmpegLog {
    let mut log = FfmpegLog::default();
    push_lines(stream, &mut log, |_| {});
    log
}

/// Parses a log to its end, and calls `on_line` after every line.
pub(super) fn push_lines(
    stream: impl Read,
    log: &mut FfmpegLog,
    mut on_line: impl FnMut(&FfmpegLog),
) {
    let mut reader = BufReader::new(stream);
    let mut line = Vec::new();
    let mut next = |line: &mut Vec<u8>| (&mut reader).take(MAX_LINE).read_until(b'\n', line);
    while matches!(next(&mut line), Ok(length) if length > 0) {
        log.push_line(String::from_utf8_lossy(&line).trim());
        on_line(log);
        line.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_without_an_end_is_read_in_parts() {
        let frame = b"\nshowinfo n: 0 pts: 0 pts_time:0 sar:0/1 s:2x2 i:P\n".as_slice();
        let log = parse_log(std::io::repeat(b'x').take(3 << 16).chain(frame));
        assert_eq!(log.frames.len(), 1);
        assert_eq!(log.message().len(), 1 << 16);
    }
}

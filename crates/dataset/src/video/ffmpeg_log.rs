//! Parser of ffmpeg's log.

use super::high_dynamic_range::Transfer;
use super::timestamps::{RepairedTimestamps, repaired};

/// Beginnings of errors that only repeat an earlier one.
const SECONDARY_ERRORS: [&str; 4] =
    ["Error opening output", "Error opening input", "Conversion failed", "Error parsing options"];

/// Contents of the log.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct FfmpegLog {
    /// Frames that came through the filter `showinfo`, in order.
    pub(super) frames: Vec<LoggedFrame>,
    /// Unit of their time stamps [s].
    time_base: Option<f64>,
    /// Length claimed by the file [s].
    pub(super) duration: Option<f64>,
    /// Codec of the first video stream.
    pub(super) codec: Option<String>,
    /// Transfer function of the frames, where that is one of high dynamic range.
    pub(super) transfer: Option<Transfer>,
    /// True if their primaries are those of BT.2020, as with HLG and PQ unless BT.709 is named.
    pub(super) has_wide_primaries: bool,
    /// Whether the track that was asked for is not there.
    pub(super) lacks_track: bool,
    /// First error that is not [secondary](SECONDARY_ERRORS).
    error: Option<String>,
    /// Last error of any kind.
    last_error: Option<String>,
    /// Last line that is neither empty nor about a frame.
    last_line: Option<String>,
}

/// A frame logged by the filter `showinfo`.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct LoggedFrame {
    /// Presentation time [ticks].
    ticks: Option<f64>,
    /// Width and height [px] after the rotation that the file asks for.
    pub(super) size: (usize, usize),
    /// Width of a pixel over its height.
    pub(super) pixel_aspect: f64,
    /// Whether its pixels are one grey value of 16 bits.
    pub(super) is_grey16: bool,
}

impl FfmpegLog {
    /// Parses the next line.
    pub(super) fn push_line(&mut self, line: &str) {
        if line.contains("showinfo") {
            if let Some(name) = word(line, "color_trc:") {
                self.transfer = Transfer::named_in(name);
                self.has_wide_primaries = word(line, "color_primaries:") != Some("bt709");
            }
            if let Some(base) = after(line, "config in time_base:") {
                self.time_base = ratio(base.split([',', ' ']).next().unwrap_or_default(), '/');
            }
            self.frames.extend(LoggedFrame::parse(line));
            return;
        }
        if let Some(length) = after(line, "Duration:").filter(|_| self.duration.is_none()) {
            self.duration = parse_duration(length.split(',').next().unwrap_or_default());
        }
        // Titles and comments come first, and may say anything.
        let is_stream = without_prefix(line).starts_with("Stream #");
        if let Some(video) = after(line, " Video:").filter(|_| is_stream && self.codec.is_none()) {
            self.codec = video.split(',').next().map(str::to_owned);
            // Versions before 4.3 do not say it of frames.
            self.transfer = Transfer::named_in(video);
            self.has_wide_primaries = !video.contains("/bt709/");
        }
        self.lacks_track |= line.contains("matches no streams");
        let is_error = line.contains("[error]") || line.contains("[fatal]");
        let line = without_prefix(line);
        if line.is_empty() {
            return;
        }
        if is_error {
            self.last_error = Some(line.to_owned());
            if !SECONDARY_ERRORS.iter().any(|start| line.starts_with(start)) {
                self.error.get_or_insert_with(|| line.to_owned());
            }
        }
        self.last_line = Some(line.to_owned());
    }

    /// The most informative error, if any.
    pub(super) fn error(&self) -> Option<&str> {
        self.error.as_deref().or(self.last_error.as_deref())
    }

    /// The most informative error, else the last line.
    pub(super) fn message(&self) -> &str {
        self.error().or(self.last_line.as_deref()).unwrap_or("nothing")
    }

    /// Whether that message contains `what`.
    pub(super) fn mentions(&self, what: &str) -> bool {
        self.message().contains(what)
    }

    /// The time stamp of a frame as it was logged [s].
    pub(super) fn own_timestamp(&self, frame: usize) -> Option<f64> {
        Some(self.frames.get(frame)?.ticks? * self.time_base?)
    }

    /// Time stamps of the frames [s], see [`repaired`].
    pub(super) fn timestamps(&self) -> Option<RepairedTimestamps> {
        let stamps: Vec<Option<f64>> =
            (0..self.frames.len()).map(|frame| self.own_timestamp(frame)).collect();
        repaired(&stamps)
    }
}

impl LoggedFrame {
    /// Parses a line such as `n:  1 pts:  512 pts_time:0.03 fmt:yuv420p sar:0/1 s:320x240 i:P ...`.
    fn parse(line: &str) -> Option<Self> {
        let ticks = after(line, " pts:")?;
        let size = word(line, " s:")?;
        let (width, height) = size.split_once('x')?;
        let format = word(line, " fmt:");
        let aspect = word(line, " sar:").and_then(|text| ratio(text, '/'));
        Some(Self {
            ticks: ticks.split(' ').next()?.parse().ok(),
            size: (width.parse().ok()?, height.parse().ok()?),
            pixel_aspect: aspect.filter(|a| a.is_finite() && *a > 0.0).unwrap_or(1.0),
            is_grey16: matches!(format, Some("gray16le" | "gray16be")),
        })
    }
}

/// Rest of a line behind `name`, without leading blanks.
fn after<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    line.find(name).map(|at| line[at + name.len()..].trim_start())
}

fn word<'a>(line: &'a str, name: &str) -> Option<&'a str> {
    after(line, name).and_then(|rest| rest.split(' ').next())
}

fn ratio(text: &str, sign: char) -> Option<f64> {
    let (above, below) = text.trim().split_once(sign)?;
    Some(above.parse::<f64>().ok()? / below.parse::<f64>().ok()?).filter(|r| r.is_finite())
}

/// Parses `HH:MM:SS.cc` [s].
fn parse_duration(text: &str) -> Option<f64> {
    text.trim().split(':').try_fold(0.0, |sum, part| Some(60.0 * sum + part.parse::<f64>().ok()?))
}

/// A line without the `[context] [level]` prefix.
fn without_prefix(line: &str) -> &str {
    let mut rest = line.trim();
    while let Some((_, behind)) = rest.strip_prefix('[').and_then(|inner| inner.split_once(']')) {
        rest = behind.trim_start();
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log_of(text: &str) -> FfmpegLog {
        let mut log = FfmpegLog::default();
        text.lines().for_each(|line| log.push_line(line));
        log
    }

    #[test]
    fn frames_sizes_and_durations_are_parsed() {
        let log = log_of(
            "[info]   Duration: 00:01:02.50, start: 0.000000, bitrate: 920 kb/s\n\
             [info]   Stream #0:0(und): Video: h264 (High) (avc1 / 0x3163), yuv420p, 320x240\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] config in time_base: 1/15360, frame_rate: 30/1\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] config out time_base: 0/0, frame_rate: 0/0\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] n:   0 pts:      0 pts_time:0 duration: 512 \
             fmt:yuv420p cl:left sar:0/1 s:320x240 i:P iskey:1 type:I\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] color_range:unknown color_space:unknown\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] n:   1 pts:    512 pts_time:0.0333333 pos: 48 \
             fmt:gray16le sar:4/3 s:320x240 i:P",
        );
        assert_eq!(log.duration, Some(62.5));
        assert_eq!(log.codec.as_deref(), Some("h264 (High) (avc1 / 0x3163)"));
        assert_eq!(log.timestamps().map(|s| s.seconds), Some(vec![0.0, 512.0 / 15360.0]));
        assert_eq!((log.frames[0].size, log.frames[0].pixel_aspect), ((320, 240), 1.0));
        assert_eq!(log.frames[1].pixel_aspect, 4.0 / 3.0);
        assert_eq!([log.frames[0].is_grey16, log.frames[1].is_grey16], [false, true]);
        assert_eq!((log.error(), log.transfer), (None, None));
    }

    #[test]
    fn high_dynamic_range_is_recognised() {
        let of = |transfer: &str| {
            let format = format!("yuv420p10le(tv, bt2020nc/bt2020/{transfer})");
            log_of(&format!("[info] Stream #0:0: Video: hevc (Main 10), {format}, 1920x1080"))
                .transfer
        };
        let found = ["arib-std-b67", "smpte2084", "bt709"].map(of);
        assert_eq!(found, [Some(Transfer::Hlg), Some(Transfer::Pq), None]);
        let title = "[info]     title           : My HDR Video: sunset, arib-std-b67\n";
        let stream = "[info] Stream #0:0: Video: h264, yuv420p(tv, bt709), 64x48\n";
        let frame = "[Parsed_showinfo_0 @ 0x1] [info] color_range:tv color_space:bt2020nc \
                     color_primaries:bt2020 color_trc:arib-std-b67";
        let standard = log_of(&format!("{title}{stream}"));
        assert_eq!((standard.transfer, standard.codec.as_deref()), (None, Some("h264")));
        let high = log_of(&format!("{title}{stream}{frame}"));
        assert_eq!((high.transfer, high.has_wide_primaries), (Some(Transfer::Hlg), true));
    }

    #[test]
    fn time_stamps_are_scaled_by_the_time_base() {
        let base = "showinfo config in time_base: 1/10, frame_rate: 30/1\n";
        let frame = |ticks: &str| format!("showinfo n: 0 pts: {ticks} pts_time:x s:8x8 i:P\n");
        let of = |ticks: &[&str]| {
            let frames: String = ticks.iter().map(|t| frame(t)).collect();
            log_of(&(base.to_owned() + &frames)).timestamps().map(|s| (s.seconds, s.repaired))
        };
        assert_eq!(of(&["3", "5"]), Some((vec![3.0 * 0.1, 5.0 * 0.1], vec![])));
        assert_eq!(of(&["3", "3"]), None);
        let (seconds, bad) = of(&["2", "NOPTS", "4"]).expect("two of three");
        assert!((seconds[1] - 0.3).abs() < 1e-12 && bad == [1]);
    }

    #[test]
    fn the_informative_error_is_chosen() {
        let log = log_of(
            "[in#0 @ 0x5622e4265100] [error] moov atom not found\n\
             [in#0 @ 0x5622e4264d80] [error] Error opening input: Invalid data found\n\
             [fatal] Error opening input files: Invalid data found",
        );
        assert_eq!(log.error(), Some("moov atom not found"));
        let log = log_of("[error] Error opening input: Permission denied");
        assert_eq!(log.message(), "Error opening input: Permission denied");
        assert_eq!(log_of("no such thing\n\n").message(), "no such thing");
        assert_eq!(log_of("").message(), "nothing");
    }
}

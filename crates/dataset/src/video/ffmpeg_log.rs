//! What ffmpeg says of a video, line by line.

use super::stamps::{Stamps, mended};

/// Beginnings of lines that only repeat what was said before.
const REPEATS: [&str; 4] =
    ["Error opening output", "Error opening input", "Conversion failed", "Error parsing options"];

/// What was said.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Words {
    /// Frames that came through the filter `showinfo`, in order.
    pub(super) frames: Vec<Shown>,
    /// Seconds of one tick of their stamps.
    tick: Option<f64>,
    /// Length that the file claims [s].
    pub(super) duration: Option<f64>,
    /// The first codec of a video in it.
    pub(super) codec: Option<String>,
    /// The first error that says something, and the last one of all.
    error: Option<String>,
    last_error: Option<String>,
    /// The last line that is neither empty nor about a frame.
    last: Option<String>,
}

/// A frame.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shown {
    /// Presentation time [ticks].
    ticks: Option<f64>,
    /// Width and height [px], turned as the file asks.
    pub(super) size: (usize, usize),
    /// Width of a pixel over its height.
    pub(super) pixel_aspect: f64,
}

impl Words {
    /// Takes in the next line.
    pub(super) fn take_in(&mut self, line: &str) {
        if line.contains("showinfo") {
            if let Some(base) = after(line, "config in time_base:") {
                self.tick = ratio(base.split([',', ' ']).next().unwrap_or_default(), '/');
            }
            self.frames.extend(Shown::read(line));
            return;
        }
        if let Some(length) = after(line, "Duration:").filter(|_| self.duration.is_none()) {
            self.duration = seconds(length.split(',').next().unwrap_or_default());
        }
        if let Some(video) = after(line, " Video:").filter(|_| self.codec.is_none()) {
            self.codec = video.split(',').next().map(str::to_owned);
        }
        let is_error = line.contains("[error]") || line.contains("[fatal]");
        let line = without_brackets(line);
        if line.is_empty() {
            return;
        }
        if is_error {
            self.last_error = Some(line.to_owned());
            if !REPEATS.iter().any(|start| line.starts_with(start)) {
                self.error.get_or_insert_with(|| line.to_owned());
            }
        }
        self.last = Some(line.to_owned());
    }

    /// The line that tells most about what went wrong, if an error was told.
    pub(super) fn error(&self) -> Option<&str> {
        self.error.as_deref().or(self.last_error.as_deref())
    }

    /// That line, else the last one.
    pub(super) fn blame(&self) -> &str {
        self.error().or(self.last.as_deref()).unwrap_or("nothing")
    }

    /// Whether the error is about `what`.
    pub(super) fn blames(&self, what: &str) -> bool {
        self.blame().contains(what)
    }

    /// Stamps of the frames [s]; see [`mended`](super::stamps::mended).
    pub(super) fn stamps(&self) -> Option<Stamps> {
        let tick = self.tick?;
        let stamps: Vec<Option<f64>> =
            self.frames.iter().map(|frame| frame.ticks.map(|ticks| ticks * tick)).collect();
        mended(&stamps)
    }
}

impl Shown {
    /// From a line such as `n:  1 pts:  512 pts_time:0.03 fmt:yuv420p sar:0/1 s:320x240 i:P ...`.
    fn read(line: &str) -> Option<Self> {
        let ticks = after(line, " pts:")?;
        let size = word(line, " s:")?;
        let (width, height) = size.split_once('x')?;
        let aspect = word(line, " sar:").and_then(|text| ratio(text, '/'));
        Some(Self {
            ticks: ticks.split(' ').next()?.parse().ok(),
            size: (width.parse().ok()?, height.parse().ok()?),
            pixel_aspect: aspect.filter(|a| a.is_finite() && *a > 0.0).unwrap_or(1.0),
        })
    }
}

/// What follows `name` in a line, without leading blanks.
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

/// Seconds of `HH:MM:SS.cc`.
fn seconds(text: &str) -> Option<f64> {
    text.trim().split(':').try_fold(0.0, |sum, part| Some(60.0 * sum + part.parse::<f64>().ok()?))
}

/// A line without the names and levels in brackets before it.
fn without_brackets(line: &str) -> &str {
    let mut rest = line.trim();
    while let Some((_, behind)) = rest.strip_prefix('[').and_then(|inner| inner.split_once(']')) {
        rest = behind.trim_start();
    }
    rest
}

#[cfg(test)]
mod tests {
    use super::*;

    fn heard(text: &str) -> Words {
        let mut words = Words::default();
        text.lines().for_each(|line| words.take_in(line));
        words
    }

    #[test]
    fn frames_have_times_and_sizes() {
        let words = heard(
            "[info]   Duration: 00:01:02.50, start: 0.000000, bitrate: 920 kb/s\n\
             [info]   Stream #0:0(und): Video: h264 (High) (avc1 / 0x3163), yuv420p, 320x240\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] config in time_base: 1/15360, frame_rate: 30/1\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] config out time_base: 0/0, frame_rate: 0/0\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] n:   0 pts:      0 pts_time:0 duration: 512 \
             fmt:yuv420p cl:left sar:0/1 s:320x240 i:P iskey:1 type:I\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] color_range:unknown color_space:unknown\n\
             [Parsed_showinfo_0 @ 0x7f7e] [info] n:   1 pts:    512 pts_time:0.0333333 pos: 48 \
             fmt:yuv420p sar:4/3 s:320x240 i:P",
        );
        assert_eq!(words.duration, Some(62.5));
        assert_eq!(words.codec.as_deref(), Some("h264 (High) (avc1 / 0x3163)"));
        assert_eq!(words.stamps().map(|s| s.seconds), Some(vec![0.0, 512.0 / 15360.0]));
        assert_eq!((words.frames[0].size, words.frames[0].pixel_aspect), ((320, 240), 1.0));
        assert_eq!(words.frames[1].pixel_aspect, 4.0 / 3.0);
        assert_eq!(words.error(), None);
    }

    #[test]
    fn stamps_count_in_their_ticks() {
        let base = "showinfo config in time_base: 1/10, frame_rate: 30/1\n";
        let frame = |ticks: &str| format!("showinfo n: 0 pts: {ticks} pts_time:x s:8x8 i:P\n");
        let of = |ticks: &[&str]| {
            let frames: String = ticks.iter().map(|t| frame(t)).collect();
            heard(&(base.to_owned() + &frames)).stamps().map(|s| (s.seconds, s.bad))
        };
        assert_eq!(of(&["3", "5"]), Some((vec![3.0 * 0.1, 5.0 * 0.1], vec![])));
        assert_eq!(of(&["3", "3"]), None);
        let (seconds, bad) = of(&["2", "NOPTS", "4"]).expect("two of three");
        assert!((seconds[1] - 0.3).abs() < 1e-12 && bad == [1]);
    }

    #[test]
    fn the_telling_error_is_found() {
        let words = heard(
            "[in#0 @ 0x5622e4265100] [error] moov atom not found\n\
             [in#0 @ 0x5622e4264d80] [error] Error opening input: Invalid data found\n\
             [fatal] Error opening input files: Invalid data found",
        );
        assert_eq!(words.error(), Some("moov atom not found"));
        let words = heard("[error] Error opening input: Permission denied");
        assert_eq!(words.blame(), "Error opening input: Permission denied");
        assert_eq!(heard("no such thing\n\n").blame(), "no such thing");
        assert_eq!(heard("").blame(), "nothing");
    }
}

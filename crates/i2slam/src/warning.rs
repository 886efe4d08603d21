//! Warnings of a run.

use serde::{Deserialize, Serialize};
use std::fmt;

/// Something unusual, and what was done about it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Warning {
    /// Affected frame, or the first of several: position in the associated stream.
    pub frame: Option<usize>,
    /// Last of several affected frames.
    pub last_frame: Option<usize>,
    /// Time stamp of `frame` [s].
    pub time_s: Option<f64>,
    /// Message, which names the frames.
    pub text: String,
}

impl Warning {
    /// A warning about one frame.
    pub fn of_frame(frame: usize, text: impl fmt::Display) -> Self {
        Self { frame: Some(frame), text: format!("frame {frame}: {text}"), ..Self::default() }
    }

    /// Calls its frame by `name` in place of the number, if it is about a single one.
    #[must_use]
    pub fn with_frame_name(mut self, name: impl Fn(usize) -> String) -> Self {
        if let (Some(frame), None) = (self.frame, self.last_frame)
            && let Some(rest) = self.text.strip_prefix(&format!("frame {frame}"))
            && rest.starts_with([':', ' '])
        {
            let name = name(frame);
            let is_clause = rest.starts_with(' ') && name != frame.to_string();
            self.text = format!("frame {name}{}{rest}", if is_clause { "," } else { "" });
        }
        self
    }

    /// A warning about a range of frames, named in `text`.
    pub fn of_frames((first, last): (usize, usize), text: impl Into<String>) -> Self {
        let (frame, last_frame) = (Some(first), Some(last));
        Self { frame, last_frame, text: text.into(), ..Self::default() }
    }

    /// Adds the time stamp of its frame if known.
    #[must_use]
    pub fn with_time(self, stamp: impl Fn(usize) -> Option<f64>) -> Self {
        Self { time_s: self.time_s.or_else(|| self.frame.and_then(stamp)), ..self }
    }
}

impl From<String> for Warning {
    fn from(text: String) -> Self {
        Self { text, ..Self::default() }
    }
}

impl From<&str> for Warning {
    fn from(text: &str) -> Self {
        text.to_owned().into()
    }
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_named_and_timed() {
        let stamp = |frame: usize| (frame == 7).then_some(0.25);
        let one = Warning::of_frame(7, "it is black").with_time(stamp);
        assert_eq!((one.to_string().as_str(), one.time_s), ("frame 7: it is black", Some(0.25)));
        let some = Warning::of_frames((8, 9), "frames 8 to 9 are lost").with_time(stamp);
        assert_eq!((some.frame, some.last_frame, some.time_s), (Some(8), Some(9), None));
        assert_eq!(Warning::from("no frame").with_time(|_| Some(1.0)).time_s, None);
    }

    #[test]
    fn a_single_frame_is_called_by_its_name() {
        let name = |frame: usize| format!("{frame}, IMG_{frame}.png");
        let named = Warning::of_frame(7, "left out: frame 7: damaged").with_frame_name(name);
        assert_eq!(named.text, "frame 7, IMG_7.png: left out: frame 7: damaged");
        for other in [
            Warning::of_frames((7, 7), "frame 7: named already"),
            "frame 7: of nobody".into(),
            Warning { frame: Some(70), text: "frame 7: black".into(), ..Warning::default() },
            Warning { frame: Some(7), text: "frame 70 is black".into(), ..Warning::default() },
        ] {
            assert_eq!(other.clone().with_frame_name(name), other);
        }
        let black = Warning { text: "frame 7 is black".into(), ..named };
        assert_eq!(black.clone().with_frame_name(|frame| frame.to_string()), black);
        assert_eq!(black.with_frame_name(name).text, "frame 7, IMG_7.png, is black");
    }
}

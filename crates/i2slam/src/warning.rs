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
}

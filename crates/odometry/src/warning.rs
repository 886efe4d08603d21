//! Warnings about a reconstruction.

/// Degradation of a reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Warning {
    /// Frames without a pose.
    #[error("{lost} of {frames} frames have no pose: they share too little with the others")]
    FramesLost {
        /// Frames without a pose.
        lost: usize,
        /// All frames.
        frames: usize,
    },
    /// Photographs without a pose.
    #[error(
        "{count} of {photographs} photographs are not placed: too blurred, or with too little of what others show; some taken from between, at most 20 degrees apart, would help"
    )]
    PhotographsNotPlaced {
        /// Number of photographs without a pose.
        count: usize,
        /// Number of all.
        photographs: usize,
    },
    /// Consecutive frames with points of their own, but too few in common with the others.
    #[error(
        "{} could not be connected to the others: they show another place, or too little of the same one; to map them, run those frames alone",
        subject(*.frames)
    )]
    DisconnectedFrames {
        /// First and last frame.
        frames: [usize; 2],
    },
    /// No two keyframes have enough parallax to begin a map.
    #[error(
        "the camera hardly moves beside turning: its path may be off by several times the claimed deviations; walk sideways, or give depth"
    )]
    LittleParallax,
    /// Consecutive frames without points to track.
    #[error(
        "{} without points to track: the lens was covered, or it is too dark or too blurred there",
        are(*.frames)
    )]
    UntrackableFrames {
        /// First and last frame.
        frames: [usize; 2],
    },
    /// Consecutive frames whose pictures are black or of one colour.
    #[error("{} black or of one colour: the lens was covered, or the camera gave no signal", are(*.frames))]
    BlankFrames {
        /// First and last frame.
        frames: [usize; 2],
    },
    /// Frames that repeat the picture before them, though the camera has moved on.
    #[error(
        "{} the picture before while the camera moves on, as a source does that stalls: they get no pose",
        repeat(*.frames, *.count)
    )]
    FrozenFrames {
        /// First and last frame.
        frames: [usize; 2],
        /// Number of frozen frames among them.
        count: usize,
    },
    /// Consecutive frames whose pictures are in another order than their timestamps.
    #[error(
        "{} not in the order of time: in another order the camera moves far less; put the pictures in order, or run the frames before and behind apart",
        are(*.frames)
    )]
    ShuffledFrames {
        /// First and last frame.
        frames: [usize; 2],
    },
    /// A large part of the picture that moves on its own.
    #[error(
        "in {} about {:.0} percent of the picture do not move with the rest, as a large moving object or a mirror: poses rest on what does, and may be off",
        subject(*.frames), 100.0 * .share
    )]
    MovingObject {
        /// First and last frame.
        frames: [usize; 2],
        /// Share of the picture, in [0, 1].
        share: f64,
    },
    /// Depth pictures that were left out, because they were taken long before or after their colour
    /// pictures.
    #[error(
        "{count} depth pictures were taken {seconds:.2} s from their colour pictures (median) and are not used: give every picture the depth nearest in time, by one clock"
    )]
    DepthNotInTime {
        /// Number of depth pictures.
        count: usize,
        /// Median of the time in between [s].
        seconds: f64,
    },
    /// Depth on which no length rests, because hardly any point has a reading that agrees with others.
    #[error(
        "{count} frames came with depth, but hardly any point of the path has a reading, so that lengths have no unit: check that depth is not blank, in metres, and registered to the colour pictures"
    )]
    DepthNotUsed {
        /// Number of frames with depth.
        count: usize,
    },
    /// Consecutive frames, as in a fast turn, that hardly bind the scale of the path behind them to
    /// that before.
    #[error(
        "frames {} to {} link the path before and behind them weakly: lengths of both compare only to {percent:.0} percent, and the path may jump there; turn slower, or give depth",
        .frames[0], .frames[1]
    )]
    ScaleUncertain {
        /// First and last frame.
        frames: [usize; 2],
        /// Deviation of the ratio of scales, in percent; 100 where it is not determined.
        percent: f64,
    },
    /// Another focal length than the given one fits much better.
    #[error(
        "the focal length was given as {given:.1} px at a width of {width} ({:.1} degrees across), but {fitting:.1} px ({:.1} degrees) fits the pictures much better: check it, or by colour alone leave it out, to have it estimated",
        field_of_view(*.width, *.given), field_of_view(*.width, *.fitting)
    )]
    FocalLengthMismatch {
        /// As given [px].
        given: f64,
        /// Best fit [px].
        fitting: f64,
        /// Width of the pictures [px].
        width: usize,
    },
    /// The focal length is only vaguely observable.
    #[error(
        "the pictures determine the focal length only to {percent:.0} percent: give it if it is known, or take pictures from all sides, some of them turned"
    )]
    FocalLengthUncertain {
        /// Relative standard deviation, in percent.
        percent: f64,
    },
    /// The focal length is not observable.
    #[error(
        "the pictures do not determine the focal length, {focal_length:.1} px ({:.1} degrees across) is a guess: give it if it is known, or take pictures from all sides, some of them turned",
        field_of_view(*.width, *.focal_length)
    )]
    FocalLengthUndetermined {
        /// Focal length that was used [px].
        focal_length: f64,
        /// Width of the pictures [px].
        width: usize,
    },
    /// The focal length was estimated together with a rolling shutter.
    #[error(
        "the focal length was estimated together with a rolling shutter, which is hard to tell apart for a turning camera: its error may exceed its deviation; give it if it is known"
    )]
    RollingShutterFocalLength,
    /// The distortion was estimated and is not observable.
    #[error(
        "the pictures do not determine the distortion of the lens: none is assumed (k1 = k2 = 0); walk to all sides and turn while filming"
    )]
    DistortionUndetermined,
}

/// Frames as a subject: "frame 3", "frames 3 to 5".
fn subject([first, last]: [usize; 2]) -> String {
    match first == last {
        true => format!("frame {first}"),
        false => format!("frames {first} to {last}"),
    }
}

/// Frames as a subject with its verb: "frame 3 is", "frames 3 to 5 are".
fn are(frames: [usize; 2]) -> String {
    let verb = if frames[0] == frames[1] { "is" } else { "are" };
    format!("{} {verb}", subject(frames))
}

/// As [`are`] for `count` frames that repeat something.
fn repeat([first, last]: [usize; 2], count: usize) -> String {
    match last + 1 - first {
        1 => format!("frame {first} repeats"),
        all if all == count => format!("frames {first} to {last} repeat"),
        _ => format!("{count} of the frames {first} to {last} repeat"),
    }
}

/// Horizontal field of view [degrees].
fn field_of_view(width: usize, focal_length: f64) -> f64 {
    2.0 * (0.5 * width as f64 / focal_length).atan().to_degrees()
}

impl Warning {
    /// The warning for pictures of another width [px].
    #[must_use]
    pub fn resized(self, to: usize) -> Self {
        match self {
            Self::FocalLengthMismatch { given, fitting, width } => {
                let scale = to as f64 / width as f64;
                let (given, fitting) = (given * scale, fitting * scale);
                Self::FocalLengthMismatch { given, fitting, width: to }
            }
            Self::FocalLengthUndetermined { focal_length, width } => {
                let focal_length = focal_length * to as f64 / width as f64;
                Self::FocalLengthUndetermined { focal_length, width: to }
            }
            other => other,
        }
    }

    /// The warning with other frame numbers.
    #[must_use]
    pub fn with_frame_numbers(mut self, number: impl Fn(usize) -> usize) -> Self {
        if let Some(frames) = self.frames_mut() {
            *frames = frames.map(number);
        }
        self
    }

    /// First and last frame that it is about, if it is about some.
    pub fn frames(mut self) -> Option<[usize; 2]> {
        self.frames_mut().copied()
    }

    fn frames_mut(&mut self) -> Option<&mut [usize; 2]> {
        match self {
            Self::DisconnectedFrames { frames }
            | Self::UntrackableFrames { frames }
            | Self::BlankFrames { frames }
            | Self::FrozenFrames { frames, .. }
            | Self::ShuffledFrames { frames }
            | Self::ScaleUncertain { frames, .. }
            | Self::MovingObject { frames, .. } => Some(frames),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_named_as_elsewhere() {
        let number = |frame: usize| 900 + 3 * frame;
        let lost = Warning::UntrackableFrames { frames: [100, 104] }.with_frame_numbers(number);
        assert!(lost.to_string().starts_with("frames 1200 to 1212 "), "{lost}");
        assert_eq!(lost.frames(), Some([1200, 1212]));
        let blank = Warning::BlankFrames { frames: [4, 4] }.with_frame_numbers(number);
        assert!(blank.to_string().starts_with("frame 912 is black"), "{blank}");
        let moving = Warning::MovingObject { frames: [4, 4], share: 0.3 };
        let moving = moving.with_frame_numbers(number).to_string();
        assert!(moving.starts_with("in frame 912 about 30 percent"), "{moving}");
        let count = Warning::FramesLost { lost: 5, frames: 200 };
        assert_eq!(count.with_frame_numbers(number), count);
    }

    #[test]
    fn a_focal_length_is_given_in_degrees_and_in_pixels_of_the_pictures_used() {
        let far = Warning::FocalLengthMismatch { given: 320.0, fitting: 640.0, width: 640 };
        let text = far.resized(320).to_string();
        for part in ["160.0 px at a width of 320 (90.0 degrees across)", "320.0 px (53.1 degrees)"]
        {
            assert!(text.contains(part), "{text}");
        }
        let guess = Warning::FocalLengthUndetermined { focal_length: 320.0, width: 640 };
        assert!(guess.resized(160).to_string().contains("80.0 px (90.0 degrees across)"));
    }
}

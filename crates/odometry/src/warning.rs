//! Warnings about a reconstruction.

/// Degradation of a reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Warning {
    /// Frames without a pose.
    #[error("{lost} of {frames} frames have no pose: they show too little of what the others show")]
    FramesLost {
        /// Frames without a pose.
        lost: usize,
        /// All frames.
        frames: usize,
    },
    /// Consecutive frames with points of their own, but too few in common with the others, as after
    /// a cut.
    #[error(
        "frames {first} to {last} could not be joined to the others: they show another place, or too little of the same one: to have it mapped, run those frames alone"
    )]
    DisconnectedFrames {
        /// First frame.
        first: usize,
        /// Last frame.
        last: usize,
    },
    /// Consecutive frames without points to track.
    #[error(
        "frames {first} to {last} show nothing that could be followed: the lens was covered, or they are too dark or too blurred"
    )]
    UntrackableFrames {
        /// First frame.
        first: usize,
        /// Last frame.
        last: usize,
    },
    /// Another focal length than the given one fits much better.
    #[error(
        "the focal length was given as {given:.1} px ({:.1} degrees across), but {fitting:.1} px ({:.1} degrees) fits the pictures much better: check it, or have it looked for instead of giving it",
        across(*.width, *.given), across(*.width, *.fitting)
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
        "the pictures tell the focal length only to {percent:.0} percent: give it where it is known; walking to all sides and turning about while filming would tell it better"
    )]
    FocalLengthUncertain {
        /// Relative standard deviation, in percent.
        percent: f64,
    },
    /// The focal length is not observable.
    #[error(
        "the pictures do not determine the focal length beside the path, {focal_length:.1} px ({:.1} degrees across) is no more than a guess: give it where it is known; walking to all sides and turning about while filming would tell it",
        across(*.width, *.focal_length)
    )]
    FocalLengthUndetermined {
        /// Focal length that was used [px].
        focal_length: f64,
        /// Width of the pictures [px].
        width: usize,
    },
    /// The focal length was estimated together with a rolling shutter.
    #[error(
        "rows were read in turn, which pictures of a turning camera hardly tell from another focal length: it may be off by more than its deviation says: give it where it is known"
    )]
    RollingShutterFocalLength,
    /// The distortion was estimated and is not observable.
    #[error(
        "the pictures do not determine the distortion of the lens beside focal length and path: none is assumed (k1 and k2 are 0); walking to all sides and turning about while filming would show it"
    )]
    DistortionUndetermined,
}

/// Horizontal field of view [degrees].
fn across(width: usize, focal_length: f64) -> f64 {
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

    /// First and last frame of a warning about consecutive frames.
    pub fn frame_range(&self) -> Option<(usize, usize)> {
        match *self {
            Self::DisconnectedFrames { first, last } | Self::UntrackableFrames { first, last } => {
                Some((first, last))
            }
            _ => None,
        }
    }

    /// The warning with other frame numbers.
    #[must_use]
    pub fn with_frame_numbers(self, number: impl Fn(usize) -> usize) -> Self {
        match self {
            Self::DisconnectedFrames { first, last } => {
                Self::DisconnectedFrames { first: number(first), last: number(last) }
            }
            Self::UntrackableFrames { first, last } => {
                Self::UntrackableFrames { first: number(first), last: number(last) }
            }
            other => other,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_named_as_elsewhere() {
        let number = |frame: usize| 900 + 3 * frame;
        let lost = Warning::UntrackableFrames { first: 100, last: 104 }.with_frame_numbers(number);
        assert!(lost.to_string().starts_with("frames 1200 to 1212 "), "{lost}");
        assert_eq!(lost.frame_range(), Some((1200, 1212)));
        let count = Warning::FramesLost { lost: 5, frames: 200 };
        assert_eq!(count.with_frame_numbers(number), count);
    }

    #[test]
    fn a_focal_length_is_told_in_degrees_and_in_pixels_of_the_pictures_used() {
        let far = Warning::FocalLengthMismatch { given: 320.0, fitting: 640.0, width: 640 };
        let told = far.resized(320).to_string();
        for part in ["160.0 px (90.0 degrees across)", "320.0 px (53.1 degrees)"] {
            assert!(told.contains(part), "{told}");
        }
        let guess = Warning::FocalLengthUndetermined { focal_length: 320.0, width: 640 };
        assert!(guess.resized(160).to_string().contains("80.0 px (90.0 degrees across)"));
    }
}

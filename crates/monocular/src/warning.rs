//! What a user should know of a result.

/// A degradation of a result.
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
    /// Frames in a row that show points, but not those of the others: as after a cut.
    #[error(
        "frames {first} to {last} could not be joined to the others: they show another place, or too little of the same one: to have it mapped, run those frames alone"
    )]
    AnotherPlace {
        /// First frame.
        first: usize,
        /// Last frame.
        last: usize,
    },
    /// Frames in a row in which no points could be followed.
    #[error(
        "frames {first} to {last} show nothing that could be followed: the lens was covered, or they are too dark or too blurred"
    )]
    NothingToFollow {
        /// First frame.
        first: usize,
        /// Last frame.
        last: usize,
    },
    /// The given focal length is not the one that fits.
    #[error(
        "the focal length was given as {given:.1} px, but {fitting:.1} px fits the pictures much better: check it, or have it looked for instead of giving it"
    )]
    FocalLengthDoubtful {
        /// As given [px].
        given: f64,
        /// That fits best [px].
        fitting: f64,
    },
    /// The pictures hardly determine the focal length.
    #[error(
        "the pictures tell the focal length only to {percent:.0} percent: give it where it is known; walking to all sides and turning about while filming would tell it better"
    )]
    FocalLengthVague {
        /// Relative standard deviation, in percent.
        percent: f64,
    },
    /// The pictures do not determine the focal length at all.
    #[error(
        "the pictures do not determine the focal length beside the path, {focal_length:.1} px is no more than a guess: give it where it is known; walking to all sides and turning about while filming would tell it"
    )]
    FocalLengthUndetermined {
        /// That the path was found with [px].
        focal_length: f64,
    },
    /// Rows were read in turn, and the focal length was looked for.
    #[error(
        "rows were read in turn, which pictures of a turning camera hardly tell from another focal length: it may be off by more than its deviation says: give it where it is known"
    )]
    RowsAndFocalLength,
    /// The distortion of the lens was looked for, and is not told from none.
    #[error(
        "the pictures do not determine the distortion of the lens beside focal length and path: none is assumed (k1 and k2 are 0); walking to all sides and turning about while filming would show it"
    )]
    LensUndetermined,
}

impl Warning {
    /// The same with the numbers that frames have elsewhere.
    #[must_use]
    pub fn numbered(self, number: impl Fn(usize) -> usize) -> Self {
        match self {
            Self::AnotherPlace { first, last } => {
                Self::AnotherPlace { first: number(first), last: number(last) }
            }
            Self::NothingToFollow { first, last } => {
                Self::NothingToFollow { first: number(first), last: number(last) }
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
        let lost = Warning::NothingToFollow { first: 100, last: 104 }.numbered(number);
        assert!(lost.to_string().starts_with("frames 1200 to 1212 "), "{lost}");
        let count = Warning::FramesLost { lost: 5, frames: 200 };
        assert_eq!(count.numbered(number), count);
    }
}

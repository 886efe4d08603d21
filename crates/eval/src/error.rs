//! The error type of all metrics.

use std::error::Error;
use std::fmt::{Display, Formatter, Result};

/// Invalid input of a metric.
#[derive(Clone, Debug, PartialEq)]
pub enum EvalError {
    /// The time tolerance is negative or NaN.
    InvalidTolerance {
        /// The given tolerance [s].
        tolerance: f64,
    },
    /// A step between poses of no frame, or of a time that is not above zero.
    InvalidStep,
    /// No pose of one trajectory was taken at the time of one of the other.
    NoOverlap {
        /// First and last stamp of the estimate [s].
        estimate: [f64; 2],
        /// First and last stamp of the truth [s].
        truth: [f64; 2],
        /// Largest accepted time difference [s].
        tolerance: f64,
    },
    /// Fewer samples (poses, pairs, pixels, numbers) than the measure needs.
    TooFew {
        /// Kind of the samples.
        what: &'static str,
        /// Number of samples.
        found: usize,
        /// Required number.
        needed: usize,
    },
    /// All values of one side coincide, so that no alignment or correlation exists.
    Coincident {
        /// The input.
        what: &'static str,
    },
    /// Both sides vary but share no direction: their covariance is zero.
    Uncorrelated,
    /// A NaN or an infinity in the input.
    NotFinite {
        /// The input.
        what: &'static str,
    },
    /// A value that must be above zero is not.
    NotPositive {
        /// The input.
        what: &'static str,
    },
    /// Two inputs that must have the same shape have not.
    ShapeMismatch {
        /// The two inputs.
        what: &'static str,
        /// Shape of the first: width, height, channels, or a length.
        first: Vec<usize>,
        /// Shape of the second.
        second: Vec<usize>,
    },
}

impl Display for EvalError {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        match self {
            Self::InvalidTolerance { tolerance } => {
                write!(f, "the time tolerance must be at least 0 s, not {tolerance}")
            }
            Self::InvalidStep => {
                write!(f, "the step of a relative error must be at least 1 frame or above 0 s")
            }
            Self::NoOverlap { estimate: [e0, e1], truth: [t0, t1], tolerance } => write!(
                f,
                "no estimated pose is within {tolerance} s of a true one: the estimate covers \
                 {e0} to {e1} s, the truth {t0} to {t1} s"
            ),
            Self::TooFew { what, found, needed } => {
                write!(f, "too few {what}: {found}, at least {needed} needed")
            }
            Self::Coincident { what } => write!(f, "all {what} coincide"),
            Self::Uncorrelated => {
                write!(f, "estimate and truth are uncorrelated: no rotation aligns them")
            }
            Self::NotFinite { what } => write!(f, "NaN or infinity in {what}"),
            Self::NotPositive { what } => write!(f, "{what} must be above zero"),
            Self::ShapeMismatch { what, first, second } => {
                write!(f, "{what} differ in shape: {first:?} and {second:?}")
            }
        }
    }
}

impl Error for EvalError {}

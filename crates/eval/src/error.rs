//! Why something could not be judged.

use std::error::Error;
use std::fmt::{Display, Formatter, Result};

/// Why a number could not be computed.
#[derive(Clone, Debug, PartialEq)]
pub enum EvalError {
    /// The time tolerance is negative or NaN.
    InvalidTolerance {
        /// What was given [s].
        tolerance: f64,
    },
    /// Fewer samples (poses, pairs, pixels, numbers) than the measure needs.
    TooFew {
        /// What there is too little of.
        what: &'static str,
        /// How many there are.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// All values of one side coincide, so that no alignment or correlation exists.
    Coincident {
        /// Which side.
        what: &'static str,
    },
    /// Both sides vary but share no direction: their covariance is zero.
    Uncorrelated,
    /// A NaN or an infinity in the input.
    NotFinite {
        /// In which input.
        what: &'static str,
    },
    /// A value that must be above zero is not.
    NotPositive {
        /// In which input.
        what: &'static str,
    },
    /// Two inputs that must have the same shape have not.
    ShapeMismatch {
        /// Which two.
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

//! The error type of all metrics.

use thiserror::Error;

/// Invalid input of a metric.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum EvalError {
    /// The time tolerance is negative or NaN.
    #[error("the time tolerance must be at least 0 s, not {tolerance}")]
    InvalidTolerance {
        /// The given tolerance [s].
        tolerance: f64,
    },
    /// A step between poses of no frame, or of a time that is not above zero.
    #[error("the step of a relative error must be at least 1 frame or above 0 s")]
    InvalidStep,
    /// No pose of one trajectory was taken at the time of one of the other.
    #[error(
        "no estimated pose is within {tolerance} s of a true one: the estimate covers {} to {} s, the truth {} to {} s",
        .estimate[0], .estimate[1], .truth[0], .truth[1]
    )]
    NoOverlap {
        /// First and last stamp of the estimate [s].
        estimate: [f64; 2],
        /// First and last stamp of the truth [s].
        truth: [f64; 2],
        /// Largest accepted time difference [s].
        tolerance: f64,
    },
    /// Fewer samples (poses, pairs, pixels, numbers) than the measure needs.
    #[error("too few {what}: {found}, at least {needed} needed")]
    TooFew {
        /// Kind of the samples.
        what: &'static str,
        /// Number of samples.
        found: usize,
        /// Required number.
        needed: usize,
    },
    /// All values of one side coincide, so that no alignment or correlation exists.
    #[error("all {what} coincide")]
    Coincident {
        /// The input.
        what: &'static str,
    },
    /// Both sides vary but share no direction: their covariance is zero.
    #[error("estimate and truth are uncorrelated: no rotation aligns them")]
    Uncorrelated,
    /// A NaN or an infinity in the input.
    #[error("NaN or infinity in {what}")]
    NotFinite {
        /// The input.
        what: &'static str,
    },
    /// A value that must be above zero is not.
    #[error("{what} must be above zero")]
    NotPositive {
        /// The input.
        what: &'static str,
    },
    /// Two inputs that must have the same shape have not.
    #[error("{what} differ in shape: {first:?} and {second:?}")]
    ShapeMismatch {
        /// The two inputs.
        what: &'static str,
        /// Shape of the first: width, height, channels, or a length.
        first: Vec<usize>,
        /// Shape of the second.
        second: Vec<usize>,
    },
}

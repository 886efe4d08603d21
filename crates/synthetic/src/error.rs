//! The error type.

use i2slam_dataset::DatasetError;
use std::path::{Path, PathBuf};

/// Failure to render or degrade a sequence.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SyntheticError {
    /// The file of a specification is not TOML, has an unknown key, or a value of a wrong type or out
    /// of its range.
    #[error("{origin}: {message}")]
    Malformed {
        /// File name.
        origin: String,
        /// The parser's message, with the line.
        message: String,
    },
    /// A value outside its range.
    #[error("{key} = {value} is out of range: {expected}")]
    OutOfRange {
        /// Section and key.
        key: String,
        /// Its value.
        value: String,
        /// Allowed values.
        expected: String,
    },
    /// A file or folder cannot be read or written.
    #[error("{}: cannot be {action}: {source}", path.display())]
    Io {
        /// "read" or "written".
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The sequence to be degraded cannot be read.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
    /// Ended by the caller.
    #[error("ended before the sequence was complete")]
    Interrupted,
}

impl SyntheticError {
    pub(crate) fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Io { action: "read", path: path.to_owned(), source }
    }

    pub(crate) fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Io { action: "written", path: path.to_owned(), source }
    }
}

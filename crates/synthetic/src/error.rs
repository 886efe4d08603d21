//! The error type.

use i2slam_dataset::DatasetError;
use std::path::{Path, PathBuf};

/// Failure to render or degrade a sequence.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SyntheticError {
    /// The specification is not TOML, has an unknown key, or a value of a wrong type.
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
    /// A file or folder cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// A file or folder cannot be written.
    #[error("{}: cannot be written: {source}", path.display())]
    Write {
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
        Self::Read { path: path.to_owned(), source }
    }

    pub(crate) fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write { path: path.to_owned(), source }
    }
}

//! The error type.

use i2slam_dataset::DatasetError;
use i2slam_storage::StorageError;
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
    /// The output folder cannot be written, or holds what must not be replaced.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// A file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Read {
        /// The file.
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
}

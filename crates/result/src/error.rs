//! Errors of result folders.

use i2slam_storage::{StorageError, reason, shortened};
use std::io;
use std::path::{Path, PathBuf};

/// A result folder could not be written or read; the message names the file.
#[derive(Debug, thiserror::Error)]
pub enum ResultError {
    /// Writing failed: disk full, no permission, a file of the user's in the way.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// Reading failed.
    #[error("cannot read {}: {}", path.display(), reason(source))]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A file has another content than expected.
    #[error("{}: {message}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The mistake and its place.
        message: String,
    },
    /// A trajectory is none.
    #[error(transparent)]
    Trajectory(#[from] i2slam::dataset::DatasetError),
    /// `config.toml` has settings that no version knows.
    #[error(transparent)]
    Config(#[from] i2slam::ConfigError),
}

impl ResultError {
    pub(crate) fn read(path: &Path, source: io::Error) -> Self {
        Self::Read { path: path.to_owned(), source }
    }

    pub(crate) fn format(path: &Path, message: impl Into<String>) -> Self {
        Self::Format { path: path.to_owned(), message: shortened(&message.into()) }
    }
}

/// Reads a text file.
pub(crate) fn read_text(path: &Path) -> Result<String, ResultError> {
    i2slam_storage::read_text(path).map_err(|e| ResultError::read(path, e))
}

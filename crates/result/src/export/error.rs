//! Errors of exports.

use i2slam::dataset::DatasetError;
use i2slam_storage::StorageError;

/// An export could not be made; the message says why and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// Writing failed: disk full, no permission, a file of the user's in the way.
    #[error(transparent)]
    Storage(#[from] StorageError),
    /// What was asked for cannot be had of this result.
    #[error("{0}")]
    Refused(String),
    /// ffmpeg is missing or failed.
    #[error(transparent)]
    Video(#[from] DatasetError),
    /// The export was cancelled; nothing was written.
    #[error("cancelled")]
    Cancelled,
}

impl ExportError {
    pub(crate) fn refused(reason: impl Into<String>) -> Self {
        Self::Refused(reason.into())
    }
}

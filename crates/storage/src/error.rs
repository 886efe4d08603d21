//! Errors of reading and writing, with the system's reason in words that tell what to do.

use std::io;
use std::path::{Path, PathBuf};

/// An output folder or a file could not be written; the message names it.
#[derive(Debug, thiserror::Error)]
pub enum StorageError {
    /// Writing failed: disk full, no permission, folder gone.
    #[error("cannot write {}: {}", path.display(), reason(source))]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// The folder holds what must not be replaced, or is no folder.
    #[error("{} {reason}", path.display())]
    Refused {
        /// The folder.
        path: PathBuf,
        /// The obstacle, and what to do.
        reason: String,
    },
    /// The folder could not take the files, which were saved elsewhere.
    #[error("{reason}; what was written is in {}", path.display())]
    Saved {
        /// The failure.
        reason: Box<StorageError>,
        /// The folder of the files.
        path: PathBuf,
    },
    /// Another process writes into the folder.
    #[error("{} is being written by {holder}: wait for it, or choose another folder", path.display())]
    Busy {
        /// The folder.
        path: PathBuf,
        /// Process and command.
        holder: String,
    },
}

impl StorageError {
    /// A failure of the system at a path.
    pub fn write(path: &Path, source: io::Error) -> Self {
        Self::Write { path: path.to_owned(), source }
    }

    pub(crate) fn refused(path: &Path, reason: impl Into<String>) -> Self {
        Self::Refused { path: path.to_owned(), reason: reason.into() }
    }
}

/// The system's error in words that tell what to do.
pub fn reason(source: &io::Error) -> String {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            "no space left on the disk".to_owned()
        }
        io::ErrorKind::PermissionDenied => "permission denied".to_owned(),
        io::ErrorKind::ReadOnlyFilesystem => "the file system is read-only".to_owned(),
        io::ErrorKind::NotFound => "no such file or folder".to_owned(),
        _ => source.to_string(),
    }
}

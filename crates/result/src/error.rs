//! What can go wrong with a result folder.

use std::io;
use std::path::PathBuf;

/// A result folder could not be written or read; the message names the file.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// Writing failed: disk full, no permission, folder gone.
    #[error("cannot write {}: {}", path.display(), reason(source))]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// Reading failed.
    #[error("cannot read {}: {}", path.display(), reason(source))]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's error.
        source: io::Error,
    },
    /// A file was read but is not what its name says.
    #[error("{}: {message}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong, and where.
        message: String,
    },
}

impl ExportError {
    /// Whether the disk or the quota is full.
    pub fn is_storage_full(&self) -> bool {
        matches!(self, Self::Write { source, .. } if full(source))
    }
}

fn full(source: &io::Error) -> bool {
    matches!(source.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
}

/// The system's error in the words of someone who wants to mend it.
fn reason(source: &io::Error) -> String {
    match source.kind() {
        _ if full(source) => "no space left on the disk".to_owned(),
        io::ErrorKind::PermissionDenied => "permission denied".to_owned(),
        io::ErrorKind::ReadOnlyFilesystem => "the file system is read-only".to_owned(),
        io::ErrorKind::NotFound => "no such file or folder".to_owned(),
        _ => source.to_string(),
    }
}

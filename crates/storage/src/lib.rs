//! Files: output folders that are written whole or not at all, bounded reading of regular files, and a
//! bound on the memory of pictures.

mod carry;
mod claim;
mod error;
mod file;
mod lock;
mod manifest;
mod message;
mod output;
mod read;
mod scratch;
mod staging;
mod swap;
#[cfg(test)]
mod tests;

pub use claim::{Claim, first_entry};
pub use error::{StorageError, reason};
pub use file::{create, write_file};
pub use lock::FolderLock;
pub use manifest::{FileRecord, MANIFEST, Manifest};
pub use message::{line_at, listed, nearest_key, shortened};
pub use output::{Committed, OutputFolder};
pub use read::{MAX_TEXT, open, read, read_range, read_text, read_text_up_to};
pub use scratch::{ScratchStore, Storable, Stored, append_floats, floats};

use std::path::{Path, PathBuf};

/// Finishes what commands that died left of their work on a folder, before it is read. Returns the
/// folders of parts that were saved.
pub fn recover(folder: &Path) -> Vec<PathBuf> {
    folder.canonicalize().map(|target| swap::recover(&target)).unwrap_or_default()
}

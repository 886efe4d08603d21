//! Writing of files: each appears complete or not at all.

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// A folder that results are written to.
#[derive(Clone, Debug)]
pub struct ResultFolder {
    root: PathBuf,
}

impl ResultFolder {
    /// Creates the folder, and checks that it can be written before a run begins.
    pub fn create(root: &Path) -> Result<Self, ResultError> {
        let probe = root.join(".i2slam-probe");
        fs::create_dir_all(root)
            .and_then(|()| fs::write(&probe, b"i2slam"))
            .and_then(|()| fs::remove_file(&probe))
            .map_err(|source| ResultError::Write { path: root.to_owned(), source })?;
        Ok(Self { root: root.to_owned() })
    }

    /// The folder's path.
    pub fn path(&self) -> &Path {
        &self.root
    }

    /// Writes `relative` (with `/` between folders) under another name, then renames it: an older
    /// file stays until the new one is complete.
    pub fn write(
        &self,
        relative: &str,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), ResultError> {
        let path = self.root.join(relative);
        let partial = partial_name(&path);
        let failed = |source| ResultError::Write { path: path.clone(), source };
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent).map_err(failed)?;
        }
        let written = write_through(&partial, content);
        let placed = written.and_then(|()| fs::rename(&partial, &path));
        placed.map_err(|source| {
            // The error that matters is the first; a partial file that cannot be removed is harmless.
            fs::remove_file(&partial).ok();
            failed(source)
        })
    }

    /// Writes a text file.
    pub fn write_text(&self, relative: &str, text: &str) -> Result<(), ResultError> {
        self.write(relative, |out| out.write_all(text.as_bytes()))
    }

    /// Deletes a file if it exists.
    pub fn remove(&self, relative: &str) -> Result<(), ResultError> {
        let path = self.root.join(relative);
        match fs::remove_file(&path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => {
                Err(ResultError::Write { path, source })
            }
            _ => Ok(()),
        }
    }
}

fn write_through(
    path: &Path,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<()> {
    let mut out = BufWriter::new(fs::File::create(path)?);
    content(&mut out)?;
    out.flush()
}

fn partial_name(path: &Path) -> PathBuf {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    path.with_file_name(format!(".{name}.partial"))
}

/// A result folder could not be written or read; the message names the file.
#[derive(Debug, thiserror::Error)]
pub enum ResultError {
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
    /// A file has another content than expected.
    #[error("{}: {message}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// The mistake and its place.
        message: String,
    },
    /// `config.toml` has settings that no version knows.
    #[error(transparent)]
    Config(#[from] i2slam::ConfigError),
}

impl ResultError {
    pub(crate) fn read(path: &Path, source: io::Error) -> Self {
        Self::Read { path: path.to_owned(), source }
    }

    pub(crate) fn format(path: &Path, message: impl Into<String>) -> Self {
        Self::Format { path: path.to_owned(), message: i2slam_storage::shortened(&message.into()) }
    }
}

/// Reads a text file.
pub(crate) fn read_text(path: &Path) -> Result<String, ResultError> {
    i2slam_storage::read_text(path).map_err(|e| ResultError::read(path, e))
}

/// The system's error in words that tell what to do.
fn reason(source: &io::Error) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn a_full_disk_keeps_the_older_file_and_leaves_no_rest() {
        let scratch = TemporaryFolder::new("full");
        let folder = ResultFolder::create(&scratch.0).expect("a folder");
        folder.write_text("a/kept.txt", "12345").expect("room for five bytes");
        let full = folder.write("a/kept.txt", |out| {
            out.write_all(b"longer than the room")?;
            Err(io::Error::from(io::ErrorKind::StorageFull))
        });
        let message = full.expect_err("full").to_string();
        assert!(message.contains("kept.txt") && message.contains("no space left"), "{message}");
        assert_eq!(fs::read_to_string(scratch.0.join("a/kept.txt")).ok().as_deref(), Some("12345"));
        assert_eq!(fs::read_dir(scratch.0.join("a")).map(Iterator::count).ok(), Some(1));
        let below = ResultFolder::create(&scratch.0.join("a/kept.txt")).expect_err("a file");
        assert!(below.to_string().contains("kept.txt"), "{below}");
    }
}

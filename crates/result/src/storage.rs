//! Writing of files: each appears complete or not at all.

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// The file system operations that results need. [`Disk`] is the real one; tests use one that runs
/// full.
pub trait Storage {
    /// Creates a folder and those above it.
    fn create_folder(&self, path: &Path) -> io::Result<()>;
    /// Creates or empties a file.
    fn create(&self, path: &Path) -> io::Result<Box<dyn Write>>;
    /// Renames a file, replacing an older one.
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()>;
    /// Deletes a file.
    fn remove(&self, path: &Path) -> io::Result<()>;
}

/// The file system of the machine.
#[derive(Clone, Copy, Debug, Default)]
pub struct Disk;

impl Storage for Disk {
    fn create_folder(&self, path: &Path) -> io::Result<()> {
        fs::create_dir_all(path)
    }
    fn create(&self, path: &Path) -> io::Result<Box<dyn Write>> {
        Ok(Box::new(fs::File::create(path)?))
    }
    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        fs::rename(from, to)
    }
    fn remove(&self, path: &Path) -> io::Result<()> {
        fs::remove_file(path)
    }
}

/// A folder that results are written to.
#[derive(Clone, Debug)]
pub struct ResultFolder<S = Disk> {
    root: PathBuf,
    storage: S,
}

impl ResultFolder<Disk> {
    /// Creates the folder, and checks that it can be written before a run begins.
    pub fn create(root: &Path) -> Result<Self, ResultError> {
        let folder = Self::on(root, Disk);
        let probe = root.join(".i2slam-probe");
        let result = folder.storage.create_folder(root).map_err(|e| (root, e)).and_then(|()| {
            fs::write(&probe, b"i2slam")
                .and_then(|()| fs::remove_file(&probe))
                .map_err(|e| (root, e))
        });
        result
            .map(|()| folder.clone())
            .map_err(|(path, source)| ResultError::Write { path: path.to_owned(), source })
    }
}

impl<S: Storage> ResultFolder<S> {
    /// A folder on a given storage.
    pub fn on(root: &Path, storage: S) -> Self {
        Self { root: root.to_owned(), storage }
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
            self.storage.create_folder(parent).map_err(failed)?;
        }
        let written = self.write_through(&partial, content);
        let placed = written.and_then(|()| self.storage.rename(&partial, &path));
        placed.map_err(|source| {
            // The error that matters is the first; a partial file that cannot be removed is harmless.
            self.storage.remove(&partial).ok();
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
        match self.storage.remove(&path) {
            Err(source) if source.kind() != io::ErrorKind::NotFound => {
                Err(ResultError::Write { path, source })
            }
            _ => Ok(()),
        }
    }

    fn write_through(
        &self,
        path: &Path,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<()> {
        let mut out = BufWriter::new(self.storage.create(path)?);
        content(&mut out)?;
        out.flush()
    }
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

    pub(crate) fn format(path: &Path, message: String) -> Self {
        Self::Format { path: path.to_owned(), message }
    }

    /// Whether the disk or the quota is full.
    pub fn is_storage_full(&self) -> bool {
        matches!(self, Self::Write { source, .. } if is_full(source))
    }
}

/// Reads a text file.
pub(crate) fn read_text(path: &Path) -> Result<String, ResultError> {
    fs::read_to_string(path).map_err(|e| ResultError::read(path, e))
}

fn is_full(source: &io::Error) -> bool {
    matches!(source.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
}

/// The system's error in words that tell what to do.
fn reason(source: &io::Error) -> String {
    match source.kind() {
        _ if is_full(source) => "no space left on the disk".to_owned(),
        io::ErrorKind::PermissionDenied => "permission denied".to_owned(),
        io::ErrorKind::ReadOnlyFilesystem => "the file system is read-only".to_owned(),
        io::ErrorKind::NotFound => "no such file or folder".to_owned(),
        _ => source.to_string(),
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;
    use std::cell::RefCell;
    use std::rc::Rc;

    /// A disk with room for so many bytes.
    #[derive(Clone, Debug)]
    pub(crate) struct SmallDisk {
        pub(crate) room: Rc<RefCell<usize>>,
    }

    impl SmallDisk {
        pub(crate) fn new(room: usize) -> Self {
            Self { room: Rc::new(RefCell::new(room)) }
        }
    }

    struct SmallFile {
        file: fs::File,
        room: Rc<RefCell<usize>>,
    }

    impl Write for SmallFile {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            let mut room = self.room.borrow_mut();
            if *room < bytes.len() {
                return Err(io::Error::from_raw_os_error(28));
            }
            *room -= bytes.len();
            self.file.write(bytes)
        }
        fn flush(&mut self) -> io::Result<()> {
            self.file.flush()
        }
    }

    impl Storage for SmallDisk {
        fn create_folder(&self, path: &Path) -> io::Result<()> {
            Disk.create_folder(path)
        }
        fn create(&self, path: &Path) -> io::Result<Box<dyn Write>> {
            let file = fs::File::create(path)?;
            Ok(Box::new(SmallFile { file, room: Rc::clone(&self.room) }))
        }
        fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
            Disk.rename(from, to)
        }
        fn remove(&self, path: &Path) -> io::Result<()> {
            Disk.remove(path)
        }
    }

    #[test]
    fn a_full_disk_keeps_the_older_file_and_leaves_no_rest() {
        let scratch = TemporaryFolder::new("full");
        let folder = ResultFolder::on(&scratch.0, SmallDisk::new(10));
        folder.write_text("a/kept.txt", "12345").expect("room for five bytes");
        let error = folder.write_text("a/kept.txt", "longer than the room").expect_err("full");
        assert!(error.is_storage_full(), "{error}");
        let message = error.to_string();
        assert!(message.contains("kept.txt") && message.contains("no space left"), "{message}");
        assert_eq!(fs::read_to_string(scratch.0.join("a/kept.txt")).ok().as_deref(), Some("12345"));
        assert_eq!(fs::read_dir(scratch.0.join("a")).map(Iterator::count).ok(), Some(1));
    }

    #[test]
    fn a_folder_that_is_a_file_is_refused_at_once() {
        let scratch = TemporaryFolder::new("file");
        let path = scratch.0.join("results");
        fs::write(&path, b"x").expect("a file");
        let error = ResultFolder::create(&path).expect_err("a file, not a folder");
        assert!(error.to_string().contains("results"), "{error}");
    }
}

//! One case: the files given to a reader.

use crate::corpus::Files;
use std::fs;
use std::io;
use std::path::Path;

/// Identity of a case within a run's seed and corpus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CaseId {
    /// The seed with this index, as it is.
    Seed(usize),
    /// The case with this number.
    Number(u64),
}

/// A path that is no regular file, or one too large to be written out.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Oddity {
    /// An empty folder.
    Folder,
    /// A link to nothing.
    DanglingLink,
    /// A link to itself.
    LinkToItself,
    /// A link to a device that never ends.
    EndlessDevice,
    /// A named pipe without a writer.
    Pipe,
    /// A file of zeros of this size [bytes] that takes no room on the disk.
    Sparse(u64),
}

/// Files, and paths that are none.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Case {
    pub(crate) files: Files,
    pub(crate) oddities: Vec<(String, Oddity)>,
}

impl Case {
    /// Writes the case into an empty folder.
    pub(crate) fn write(&self, folder: &Path) -> io::Result<()> {
        fs::create_dir_all(folder)?;
        crate::corpus::write(folder, &self.files)?;
        for (name, oddity) in &self.oddities {
            let path = folder.join(name);
            if let Some(parent) = path.parent() {
                fs::create_dir_all(parent)?;
            }
            oddity.make(&path)?;
        }
        Ok(())
    }

    /// Names of all its files, without folders.
    pub(crate) fn file_names(&self) -> impl Iterator<Item = &str> {
        let odd = self.oddities.iter().map(|(name, _)| name);
        let all = self.files.keys().chain(odd);
        all.map(|name| name.rsplit('/').next().unwrap_or(name))
    }
}

impl Oddity {
    fn make(self, path: &Path) -> io::Result<()> {
        match self {
            Self::Folder => fs::create_dir_all(path),
            Self::Sparse(size) => fs::File::create(path)?.set_len(size),
            Self::DanglingLink => link("nowhere", path),
            Self::LinkToItself => link(path, path),
            Self::EndlessDevice => link("/dev/zero", path),
            Self::Pipe => pipe(path),
        }
    }
}

#[cfg(unix)]
fn link(target: impl AsRef<Path>, path: &Path) -> io::Result<()> {
    std::os::unix::fs::symlink(target, path)
}

#[cfg(not(unix))]
fn link(_: impl AsRef<Path>, path: &Path) -> io::Result<()> {
    fs::create_dir_all(path)
}

#[cfg(target_os = "linux")]
fn pipe(path: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, FileType, Mode, mknodat};
    Ok(mknodat(CWD, path, FileType::Fifo, Mode::RUSR | Mode::WUSR, 0)?)
}

#[cfg(not(target_os = "linux"))]
fn pipe(path: &Path) -> io::Result<()> {
    fs::create_dir_all(path)
}

//! A file that appears whole or not at all.

use crate::error::StorageError;
use crate::manifest::FileRecord;
use std::ffi::OsString;
use std::fs::{self, File};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// Writes a file under a random name beside it, then renames it: an older file stays until the new
/// one is complete, and no link is followed. Folders above it are created.
///
/// # Errors
/// Those of the system; the message names the file.
pub fn write_file(
    path: &Path,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), StorageError> {
    let failed = |source| StorageError::write(path, source);
    let partial = hidden_beside(path);
    if let Some(parent) = path.parent() {
        fs::create_dir_all(parent).map_err(failed)?;
    }
    let written = write_new(&partial, content);
    let written = written.and_then(|_| File::options().write(true).open(&partial)?.sync_all());
    let placed = written.and_then(|()| fs::rename(&partial, path));
    placed.map_err(|source| {
        // The first error matters; a partial file that cannot be removed is harmless.
        fs::remove_file(&partial).ok();
        failed(source)
    })
}

/// Opens a new file for writing in place of an older one; a link is removed, not followed.
///
/// # Errors
/// Those of the system.
pub fn create(path: &Path) -> io::Result<File> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
        _ => {}
    }
    File::create_new(path)
}

/// Writes a file that must not exist.
pub(crate) fn write_new(
    path: &Path,
    content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> io::Result<FileRecord> {
    let file = BufWriter::new(File::create_new(path)?);
    let mut out = Checked { out: file, bytes: 0, sum: crc32fast::Hasher::new() };
    content(&mut out)?;
    // The last bytes are written here, and their errors told.
    out.flush()?;
    Ok(FileRecord::new(out.bytes, out.sum.finalize()))
}

/// A random number for names.
pub(crate) fn random() -> u64 {
    RandomState::new().build_hasher().finish()
}

/// A hidden random name in the same folder.
fn hidden_beside(path: &Path) -> PathBuf {
    let mut name = OsString::from(".");
    name.push(path.file_name().unwrap_or_default());
    name.push(format!(".i2slam-{:016x}", random()));
    path.with_file_name(name)
}

/// A writer that counts its bytes and computes their CRC-32.
struct Checked<W> {
    out: W,
    bytes: u64,
    sum: crc32fast::Hasher,
}

impl<W: Write> Write for Checked<W> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let count = self.out.write(bytes)?;
        self.bytes += count as u64;
        self.sum.update(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn a_full_disk_keeps_the_older_file_and_leaves_no_rest() {
        let scratch = TemporaryFolder::new("full");
        let path = scratch.join("kept.txt");
        write_file(&path, |out| out.write_all(b"12345")).expect("room for five bytes");
        let full = write_file(&path, |out| {
            out.write_all(b"longer than the room")?;
            Err(io::Error::from(io::ErrorKind::StorageFull))
        });
        let message = full.expect_err("full").to_string();
        assert!(message.contains("kept.txt") && message.contains("no space left"), "{message}");
        assert_eq!(fs::read_to_string(&path).ok().as_deref(), Some("12345"));
        assert_eq!(fs::read_dir(&scratch.0).map(Iterator::count).ok(), Some(1));
    }

    #[test]
    #[cfg(unix)]
    fn a_link_is_replaced_and_not_followed() {
        let scratch = TemporaryFolder::new("write-link");
        fs::write(scratch.join("mine.txt"), "mine").expect("room");
        std::os::unix::fs::symlink("mine.txt", scratch.join("list.txt")).expect("a link");
        write_file(&scratch.join("list.txt"), |out| out.write_all(b"new")).expect("room");
        let text = |name| fs::read_to_string(scratch.join(name)).ok();
        assert_eq!(text("mine.txt").as_deref(), Some("mine"));
        assert_eq!(text("list.txt").as_deref(), Some("new"));
    }
}

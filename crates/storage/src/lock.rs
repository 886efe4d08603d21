//! A lock on a folder that ends with its process, however that ends.

use crate::error::StorageError;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

/// Name of the lock file in its folder.
pub(crate) const LOCK: &str = ".i2slam-lock";

/// First word of a lock file, by which it is told from a file of the user's.
const SIGNATURE: &str = "i2slam";

/// Attempts to lock a file that others remove in between.
const MAX_ATTEMPTS: usize = 100;

/// Attempts after which a lock counts as held.
const PATIENCE: usize = 10;

/// Longest first line [bytes].
const MAX_LINE: u64 = 4096;

/// What a locked folder is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// The folder that the user named.
    Output,
    /// The folder in which the next result is prepared.
    Staging,
}

impl Role {
    fn name(self) -> &'static str {
        match self {
            Self::Output => "output",
            Self::Staging => "staging",
        }
    }
}

/// Exclusive access to a folder among processes; released when dropped.
///
/// The lock is one of the system (`flock`), so that a process that died holds none. Its file stays
/// behind then, and is taken over.
#[derive(Debug)]
pub struct FolderLock {
    path: PathBuf,
    file: File,
    /// Whether the file is removed with the lock; that of a dead process stays until its work is
    /// done.
    removes: bool,
}

impl FolderLock {
    /// Locks an output folder for a command.
    ///
    /// # Errors
    /// `Busy` if another process holds it, or another part of this one.
    pub fn acquire(folder: &Path, command: &str) -> Result<Self, StorageError> {
        Self::acquire_as(folder, command, Role::Output)
    }

    pub(crate) fn acquire_as(
        folder: &Path,
        command: &str,
        role: Role,
    ) -> Result<Self, StorageError> {
        let (path, mut file, _) = Self::take(folder, true)?;
        let process = std::process::id();
        let line = format!("{SIGNATURE} {} process {process}, {command}\n", role.name());
        let written = file.set_len(0).and_then(|()| file.rewind());
        let written = written.and_then(|()| file.write_all(line.as_bytes()));
        let lock = Self { path, file, removes: true };
        written.map_err(|source| StorageError::write(&lock.path, source))?;
        Ok(lock)
    }

    /// Takes over the lock of a folder whose process died, with its role and the lines that follow;
    /// `None` where there is no lock file or a process that holds it.
    pub(crate) fn take_over(folder: &Path) -> Option<(Self, Role, Vec<String>)> {
        let (path, mut file, is_locked) = Self::take(folder, false).ok()?;
        // Without locks a living process cannot be told from a dead one.
        if !is_locked {
            return None;
        }
        let mut text = String::new();
        file.read_to_string(&mut text).ok()?;
        let mut lines = text.lines();
        let role = match lines.next().map(|line| line.split(' ').nth(1)) {
            Some(Some("output")) => Role::Output,
            // Empty where the process died before it had written anything.
            None | Some(Some("staging")) => Role::Staging,
            Some(_) => return None,
        };
        // A last line without its end was cut off: the file that it names was never created.
        let cut = usize::from(!text.ends_with('\n'));
        let whole = lines.clone().count().saturating_sub(cut);
        let lines = lines.take(whole).filter(|line| !line.is_empty()).map(str::to_owned).collect();
        Some((Self { path, file, removes: false }, role, lines))
    }

    /// Opens and locks the file of a folder; tells whether the system has locks there.
    fn take(folder: &Path, create: bool) -> Result<(PathBuf, File, bool), StorageError> {
        let path = folder.join(LOCK);
        let failed = |source| StorageError::write(&path, source);
        for attempt in 0..MAX_ATTEMPTS {
            let mut file = open_lock(&path, create).map_err(failed)?;
            let is_locked = match file.try_lock() {
                Ok(()) => true,
                // A process that is being started holds copies of all locks for a moment.
                Err(TryLockError::WouldBlock) if attempt < PATIENCE => {
                    sleep(Duration::from_millis(2));
                    continue;
                }
                Err(TryLockError::WouldBlock) => {
                    return Err(StorageError::Busy {
                        path: folder.to_owned(),
                        holder: holder(file),
                    });
                }
                // Some network file systems have no locks: better no lock than no result.
                Err(TryLockError::Error(_)) => false,
            };
            if !is_ours(&mut file).map_err(failed)? {
                let reason = format!("holds a file {LOCK} that i2slam did not write");
                return Err(StorageError::refused(folder, reason));
            }
            // The one before may have removed the file between opening and locking.
            if is_same_file(&file, &path) {
                return Ok((path, file, is_locked));
            }
        }
        Err(failed(io::Error::other("it changes all the time")))
    }

    /// Adds a line to the lock file; one that a full disk cut off before cannot swallow it.
    pub(crate) fn note(&mut self, line: &str) -> io::Result<()> {
        self.file.write_all(format!("\n{line}\n").as_bytes())
    }

    /// Waits until the lock file is on the disk.
    pub(crate) fn synchronise(&self) -> io::Result<()> {
        self.file.sync_data()
    }

    /// Leaves the file where it is when the lock is dropped.
    pub(crate) fn leave(&mut self) {
        self.removes = false;
    }

    /// Follows the folder to another path.
    pub(crate) fn moved_to(&mut self, folder: &Path) {
        self.path = folder.join(LOCK);
    }
}

impl Drop for FolderLock {
    fn drop(&mut self) {
        // While it is held nobody else can own the file of that name, unless it is another file.
        if self.removes && is_same_file(&self.file, &self.path) {
            fs::remove_file(&self.path).ok();
        }
    }
}

#[cfg(unix)]
fn open_lock(path: &Path, create: bool) -> io::Result<File> {
    use rustix::fs::OFlags;
    use std::os::unix::fs::OpenOptionsExt;
    let flags = OFlags::NOFOLLOW | OFlags::NONBLOCK;
    let mut options = OpenOptions::new();
    options.read(true).write(true).create(create).custom_flags(flags.bits().cast_signed());
    options.open(path)
}

#[cfg(not(unix))]
fn open_lock(path: &Path, create: bool) -> io::Result<File> {
    OpenOptions::new().read(true).write(true).create(create).truncate(false).open(path)
}

/// Whether the file is new, or begins as lock files do.
fn is_ours(file: &mut File) -> io::Result<bool> {
    let found = file.metadata()?;
    if !found.is_file() {
        return Ok(false);
    }
    let mut start = [0; SIGNATURE.len()];
    let read = found.len() == 0 || file.read_exact(&mut start).is_ok();
    file.rewind()?;
    Ok(read && (found.len() == 0 || start == SIGNATURE.as_bytes()))
}

/// Process and command in a lock file.
fn holder(file: File) -> String {
    let mut text = String::new();
    file.take(MAX_LINE).read_to_string(&mut text).ok();
    let words = text.lines().next().and_then(|line| line.splitn(3, ' ').nth(2));
    words.unwrap_or("another process").to_owned()
}

#[cfg(unix)]
fn is_same_file(file: &File, path: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(open), Ok(there)) = (file.metadata(), path.symlink_metadata()) else { return false };
    (open.dev(), open.ino()) == (there.dev(), there.ino())
}

/// Elsewhere an open file cannot be removed.
#[cfg(not(unix))]
fn is_same_file(_: &File, path: &Path) -> bool {
    path.is_file()
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn a_folder_is_locked_once_and_free_again_afterwards() {
        let scratch = TemporaryFolder::new("lock");
        let lock = FolderLock::acquire(&scratch.0, "i2slam run").expect("free");
        let busy = FolderLock::acquire(&scratch.0, "i2slam run").expect_err("held").to_string();
        assert!(busy.contains(&format!("process {}, i2slam run", std::process::id())), "{busy}");
        drop(lock);
        assert!(!scratch.join(LOCK).exists());
        drop(FolderLock::acquire(&scratch.0, "i2slam run").expect("free"));
    }

    #[test]
    fn the_file_of_a_dead_process_is_taken_over() {
        let scratch = TemporaryFolder::new("stale");
        let text = "i2slam staging process 1, i2slam run\na.txt\nb/c.txt\ncut";
        fs::write(scratch.join(LOCK), text).expect("room");
        let (lock, role, lines) = FolderLock::take_over(&scratch.0).expect("nobody holds it");
        assert_eq!((role, lines), (Role::Staging, vec!["a.txt".to_owned(), "b/c.txt".to_owned()]));
        assert!(FolderLock::take_over(&scratch.0).is_none(), "held now");
        drop(lock);
        drop(FolderLock::acquire(&scratch.0, "i2slam run").expect("free"));
        assert!(FolderLock::take_over(&scratch.0).is_none(), "no file");
    }

    #[test]
    #[cfg(unix)]
    fn a_lock_never_touches_files_of_others() {
        let scratch = TemporaryFolder::new("lock-foreign");
        fs::create_dir(scratch.join("out")).expect("room");
        fs::write(scratch.join("mine.txt"), "mine").expect("room");
        std::os::unix::fs::symlink("../mine.txt", scratch.join("out").join(LOCK)).expect("a link");
        FolderLock::acquire(&scratch.join("out"), "i2slam run").expect_err("a link");
        fs::remove_file(scratch.join("out").join(LOCK)).expect("a link");
        fs::write(scratch.join("out").join(LOCK), "mine").expect("room");
        let refusal = FolderLock::acquire(&scratch.join("out"), "i2slam run").expect_err("foreign");
        assert!(refusal.to_string().contains("did not write"), "{refusal}");
        for file in [scratch.join("mine.txt"), scratch.join("out").join(LOCK)] {
            assert_eq!(fs::read_to_string(file).ok().as_deref(), Some("mine"));
        }
    }
}

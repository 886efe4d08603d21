//! The folder in which a result is prepared.

use crate::error::StorageError;
use crate::file::{random, write_new};
use crate::lock::{FolderLock, LOCK, Role};
use crate::manifest::{FileRecord, remove_empty_folders};
use std::collections::{BTreeMap, BTreeSet};
use std::ffi::{OsStr, OsString};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// End of the name of a file that is being written.
const PARTIAL: &str = ".partial";

/// Line of the lock file after which a dead process's work is finished instead of discarded. No
/// path begins so.
pub(crate) const COMMITTED: &str = "//committed";

/// Line of the lock file after which a dead process's work is kept instead of discarded.
pub(crate) const KEPT: &str = "//kept";

/// A new folder of its own, removed when dropped unless it was put in place.
#[derive(Debug)]
pub(crate) struct Staging {
    pub(crate) root: PathBuf,
    state: Mutex<State>,
    /// Whether the files were put in place, or will be by the next command.
    pub(crate) is_done: bool,
}

#[derive(Debug)]
struct State {
    lock: FolderLock,
    /// Files that were begun: each stands in the lock file, so that another process can tell them
    /// from the user's when this one dies.
    noted: BTreeSet<String>,
    /// Files that are complete.
    records: BTreeMap<String, FileRecord>,
    is_kept: bool,
}

impl Staging {
    /// Creates a folder `PREFIX` + random number below `parent`.
    pub(crate) fn create(
        parent: &Path,
        prefix: &OsStr,
        command: &str,
    ) -> Result<Self, StorageError> {
        let (root, lock) = loop {
            let mut name = OsString::from(prefix);
            name.push(format!("{:016x}", random()));
            let root = parent.join(name);
            match fs::create_dir(&root) {
                Ok(()) => {}
                Err(e) if e.kind() == io::ErrorKind::AlreadyExists => continue,
                Err(source) => return Err(StorageError::write(parent, source)),
            }
            match FolderLock::acquire_as(&root, command, Role::Staging) {
                Ok(lock) => break (root, lock),
                // Another process took the empty folder for one of a dead process.
                Err(_) if !root.exists() => {}
                Err(error) => {
                    fs::remove_dir(&root).ok();
                    return Err(error);
                }
            }
        };
        let state =
            State { lock, noted: BTreeSet::new(), records: BTreeMap::new(), is_kept: false };
        Ok(Self { root, state: Mutex::new(state), is_done: false })
    }

    /// Writes a file; a second one of the same name replaces the first when it is complete.
    pub(crate) fn write(
        &self,
        relative: &str,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> io::Result<()> {
        let record = self.place(relative, |partial| write_new(partial, content))?;
        self.state().records.insert(relative.to_owned(), record);
        Ok(())
    }

    /// Writes a file that is not part of the result.
    pub(crate) fn write_unlisted(&self, relative: &str, text: &str) -> io::Result<()> {
        self.place(relative, |partial| write_new(partial, |out| out.write_all(text.as_bytes())))?;
        Ok(())
    }

    /// Links a file of another folder, which is on the same file system.
    pub(crate) fn link(&self, relative: &str, from: &Path) -> io::Result<()> {
        self.place(relative, |partial| fs::hard_link(from, partial))
    }

    /// Creates a file under another name and renames it.
    fn place<T>(
        &self,
        relative: &str,
        create: impl FnOnce(&Path) -> io::Result<T>,
    ) -> io::Result<T> {
        self.note(relative)?;
        let path = self.root.join(relative);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        let partial = self.root.join(format!("{relative}{PARTIAL}"));
        let created = create(&partial);
        let placed = created.and_then(|created| fs::rename(&partial, &path).map(|()| created));
        placed.inspect_err(|_| drop(fs::remove_file(&partial)))
    }

    /// Writes the name of a file into the lock file before it is created.
    pub(crate) fn note(&self, relative: &str) -> io::Result<()> {
        let mut state = self.state();
        if !state.noted.contains(relative) {
            state.lock.note(relative)?;
            state.noted.insert(relative.to_owned());
        }
        Ok(())
    }

    /// Marks the work as complete: after this it is finished even if the process dies.
    pub(crate) fn mark_committed(&mut self) -> io::Result<()> {
        let mut state = self.state();
        state.lock.note(COMMITTED)?;
        state.lock.synchronise()?;
        drop(state);
        self.is_done = true;
        Ok(())
    }

    /// Marks the work as worth keeping: it is saved beside if the process dies or gives up.
    pub(crate) fn keep(&self) {
        let mut state = self.state();
        // A full disk has no room for the mark, and none for more of the work.
        state.is_kept = state.is_kept || state.lock.note(KEPT).is_ok();
    }

    /// Removes the folder with what is left in it.
    pub(crate) fn remove(&mut self) {
        let names: Vec<String> = self.state().noted.iter().cloned().collect();
        remove_staged(&self.root, &names);
        self.is_done = true;
    }

    /// Leaves the lock file, by which the next command tells what to do with the folder.
    pub(crate) fn leave_lock(&self) {
        self.state().lock.leave();
    }

    /// Files that are complete.
    pub(crate) fn records(&self) -> BTreeMap<String, FileRecord> {
        self.state().records.clone()
    }

    pub(crate) fn contains(&self, relative: &str) -> bool {
        self.state().records.contains_key(relative)
    }

    /// Removes files that were linked.
    pub(crate) fn unlink(&self, names: &[&str]) {
        names.iter().for_each(|name| drop(fs::remove_file(self.root.join(name))));
    }

    /// Takes note that the folder is at another path now.
    pub(crate) fn moved_to(&mut self, folder: &Path) {
        self.is_done = true;
        self.state().lock.moved_to(folder);
        self.root = folder.to_owned();
    }

    fn state(&self) -> MutexGuard<'_, State> {
        // A panic in a writer leaves the lists of files valid.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        let is_kept = self.state().is_kept;
        match (self.is_done, is_kept) {
            (true, _) => {}
            // The next command saves it.
            (false, true) => self.leave_lock(),
            (false, false) => self.remove(),
        }
    }
}

/// Removes the files of a staging folder, its lock file, and the folder.
pub(crate) fn remove_staged(root: &Path, names: &[String]) {
    for name in names {
        fs::remove_file(root.join(name)).ok();
        fs::remove_file(root.join(format!("{name}{PARTIAL}"))).ok();
    }
    remove_empty_folders(root, names.iter().map(String::as_str));
    // A folder that holds anything else keeps its lock file too, by which it can be told.
    let others = fs::read_dir(root).into_iter().flatten().flatten();
    if others.into_iter().all(|entry| entry.file_name() == LOCK) {
        fs::remove_file(root.join(LOCK)).ok();
        fs::remove_dir(root).ok();
    }
}

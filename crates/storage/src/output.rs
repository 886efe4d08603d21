//! An output folder: what a command writes appears there as a whole.

use crate::carry::carry_over;
use crate::claim::{Claim, check_contents, foreign, is_unlisted, refuse_file};
use crate::error::StorageError;
use crate::file::random;
use crate::lock::FolderLock;
use crate::manifest::{FileState, MANIFEST, Manifest};
use crate::staging::Staging;
use crate::swap::{
    apply, create_parents, exchange, free_name, recover, retire, staging_prefix, synchronise,
};
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::thread::sleep;
use std::time::Duration;

/// A folder that a command writes to, locked against other processes.
///
/// Files are prepared in a hidden folder beside it. [`OutputFolder::commit`] lets them take the
/// place of the earlier ones at one instant, and then moves files of the user over; dropping
/// removes what was prepared. Where a folder cannot be exchanged (a mount point, the current
/// folder, a parent without permission), files are moved one by one, and a later command finishes
/// what a dead process began.
///
/// No link is followed out of the folder, and nothing is replaced or removed that the manifest does
/// not list with its size and checksum.
#[derive(Debug)]
pub struct OutputFolder {
    staging: Staging,
    lock: FolderLock,
    /// Dropped after the lock, whose file lies in it.
    _created: CreatedFolders,
    /// The folder as the user named it, for messages.
    path: PathBuf,
    /// The folder without links.
    target: PathBuf,
    /// Files of the earlier result; of those that stay, if files are added.
    earlier: Option<Manifest>,
    /// The next manifest, without the files that are being written.
    next: Manifest,
    is_beside: bool,
    place: Place,
    saved: Vec<PathBuf>,
}

/// Place of the prepared files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// Beside the folder where that is possible, else inside.
    Beside,
    /// Beside the folder, as on a file system that cannot exchange folders.
    #[cfg_attr(not(test), expect(dead_code, reason = "tests choose it"))]
    BesideAlone,
    /// Inside the folder.
    #[cfg_attr(not(test), expect(dead_code, reason = "tests choose it"))]
    Inside,
}

/// Result of a commit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Committed {
    /// The folder.
    pub path: PathBuf,
    /// Folder of the user's files that were in the way of the result.
    pub displaced: Option<PathBuf>,
}

impl OutputFolder {
    /// Checks that a command may write a new result; writes nothing but what a dead command left to
    /// be finished.
    ///
    /// # Errors
    /// `Refused` if the folder holds an earlier result and it must stay, or one that was changed,
    /// or anything that the command did not write.
    pub fn check(path: &Path, claim: Claim<'_>) -> Result<(), StorageError> {
        if path.is_dir() {
            let target = path.canonicalize().map_err(|e| StorageError::write(path, e))?;
            recover(&target);
        }
        check_contents(path, claim)
    }

    /// Opens a folder for a new result; it is created if it does not exist.
    ///
    /// # Errors
    /// As [`OutputFolder::check`]; `Busy` if another process writes there.
    pub fn replace(path: &Path, claim: Claim<'_>) -> Result<Self, StorageError> {
        Self::replace_at(path, claim, Place::Beside)
    }

    pub(crate) fn replace_at(
        path: &Path,
        claim: Claim<'_>,
        place: Place,
    ) -> Result<Self, StorageError> {
        refuse_file(path)?;
        let (created, target) = create(path)?;
        let lock = FolderLock::acquire(&target, claim.command).map_err(|e| named(e, path))?;
        let saved = recover(&target);
        check_contents(path, claim)?;
        let (earlier, next) = (Manifest::of(&target), Manifest::new(claim.command));
        Self::open(path, target, (created, lock), (earlier, next), (claim.command, place, saved))
    }

    /// Opens a folder to add files, or to replace some that an earlier command wrote; it is created
    /// if it does not exist. Waits for a few seconds if another process writes there. `names` are the
    /// first parts of the paths that will be written.
    ///
    /// # Errors
    /// `Busy` if it still does; `Refused` if one of the names is the user's.
    pub fn extend(path: &Path, command: &str, names: &[&str]) -> Result<Self, StorageError> {
        Self::extend_at(path, command, names, Place::Beside)
    }

    pub(crate) fn extend_at(
        path: &Path,
        command: &str,
        names: &[&str],
        place: Place,
    ) -> Result<Self, StorageError> {
        refuse_file(path)?;
        let (created, target) = create(path)?;
        let mut lock = FolderLock::acquire(&target, command);
        for _ in 0..50 {
            let Err(StorageError::Busy { .. }) = lock else { break };
            sleep(Duration::from_millis(100));
            lock = FolderLock::acquire(&target, command);
        }
        let lock = lock.map_err(|e| named(e, path))?;
        let saved = recover(&target);
        let earlier = Manifest::of(&target);
        if earlier.is_none() && target.join(MANIFEST).symlink_metadata().is_ok() {
            return Err(foreign(path, MANIFEST));
        }
        let next = earlier.clone().unwrap_or_else(|| Manifest::new(command));
        if let Some(name) = names.iter().find(|name| is_unlisted(&target, name, &next)) {
            return Err(foreign(path, name));
        }
        Self::open(path, target, (created, lock), (earlier, next), (command, place, saved))
    }

    fn open(
        path: &Path,
        target: PathBuf,
        (_created, lock): (CreatedFolders, FolderLock),
        (earlier, next): (Option<Manifest>, Manifest),
        (command, place, saved): (&str, Place, Vec<PathBuf>),
    ) -> Result<Self, StorageError> {
        let beside = match place {
            Place::Inside => None,
            _ => staging_beside(&target, command),
        };
        let is_beside = beside.is_some();
        let staging = match beside {
            Some(staging) => staging,
            None => Staging::create(&target, &staging_prefix(&target, false), command)
                .map_err(|e| named(e, path))?,
        };
        let path = path.to_owned();
        Ok(Self { staging, lock, _created, path, target, earlier, next, is_beside, place, saved })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// A folder on the same disk for files that are needed until the result is committed; it is removed
    /// with what was prepared.
    pub fn scratch_folder(&self) -> &Path {
        &self.staging.root
    }

    /// Whether a command wrote the folder before.
    pub fn has_earlier_result(&self) -> bool {
        self.earlier.is_some()
    }

    /// Prepares a file; `relative` has `/` between folders. A second one of the same name replaces
    /// the first when it is complete.
    ///
    /// # Errors
    /// Those of the system.
    pub fn write(
        &self,
        relative: &str,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), StorageError> {
        let path = self.path.join(relative);
        self.staging.write(relative, content).map_err(|source| StorageError::write(&path, source))
    }

    /// Prepares a text file.
    ///
    /// # Errors
    /// As [`OutputFolder::write`].
    pub fn write_text(&self, relative: &str, text: &str) -> Result<(), StorageError> {
        self.write(relative, |out| out.write_all(text.as_bytes()))
    }

    /// Whether a file was prepared, or a folder that holds one.
    pub fn has(&self, relative: &str) -> bool {
        let is_below = |name: &String| {
            name.strip_prefix(relative).is_some_and(|rest| rest.is_empty() || rest.starts_with('/'))
        };
        self.staging.records().keys().any(is_below)
    }

    /// Leaves out files of the earlier result, where files are added to it.
    pub fn remove(&mut self, is_removed: impl Fn(&str) -> bool) {
        self.next.files.retain(|name, _| !is_removed(name));
    }

    /// Parts of dead processes that were saved when the folder was opened.
    pub fn saved_parts(&self) -> &[PathBuf] {
        &self.saved
    }

    /// Keeps what is prepared from now on even if the process dies or the folder is dropped: then it
    /// goes to `NAME-partial`. To be called when what is there is worth more than its room.
    pub fn keep(&self) {
        self.staging.keep();
    }

    /// Puts the prepared files in place. Files of the user that are in the way are refused.
    ///
    /// # Errors
    /// After an error nothing has changed in the folder, and [`OutputFolder::commit_beside`] can
    /// still save the files, unless they are moved one by one: then the next command goes on.
    pub fn commit(&mut self) -> Result<Committed, StorageError> {
        if self.staging.is_done {
            let done = io::Error::other("it is committed already");
            return Err(StorageError::write(&self.path, done));
        }
        for name in self.staging.records().keys() {
            self.refuse_foreign(name)?;
        }
        let manifest = self.write_manifest(self.next.clone())?;
        let displaced = match self.is_beside && self.carries_over() {
            true => self.exchange(&manifest)?,
            false => self.apply(&manifest)?,
        };
        self.earlier = Some(manifest);
        Ok(Committed { path: self.path.clone(), displaced })
    }

    /// Puts the prepared files in place; where that fails they are saved beside, which the error
    /// tells.
    ///
    /// # Errors
    /// As [`OutputFolder::commit`].
    pub fn commit_or_save(&mut self) -> Result<Committed, StorageError> {
        self.commit().map_err(|error| match self.commit_beside("partial") {
            Ok(path) => StorageError::Saved { reason: Box::new(error), path },
            Err(_) => error,
        })
    }

    /// Puts the prepared files into a new folder `NAME-SUFFIX`, numbered if that exists, beside the
    /// folder; inside, where nothing can be written beside.
    ///
    /// # Errors
    /// Those of the system.
    pub fn commit_beside(&mut self, suffix: &str) -> Result<PathBuf, StorageError> {
        if self.staging.is_done {
            let begun = io::Error::other("its files are partly in place: run the command again");
            return Err(StorageError::write(&self.path, begun));
        }
        // Files without a list are better than none.
        drop(self.write_manifest(Manifest::new(&self.next.command)));
        let outside = free_name(&self.target, suffix);
        let inside = free_name(&self.target.join("result"), suffix);
        let placed = fs::rename(&self.staging.root, &outside).map(|()| outside);
        let placed = placed.or_else(|_| fs::rename(&self.staging.root, &inside).map(|()| inside));
        let placed = placed.map_err(|e| StorageError::write(&self.path, e))?;
        self.staging.moved_to(&placed);
        Ok(placed)
    }

    /// Checks that all files arrived, and writes their list.
    fn write_manifest(&self, mut manifest: Manifest) -> Result<Manifest, StorageError> {
        for (name, record) in self.staging.records() {
            let size = self.staging.root.join(&name).metadata().map(|found| found.len());
            if size.as_ref().ok() != Some(&record.bytes) {
                let short = size.err().unwrap_or_else(|| io::Error::other("it did not arrive"));
                return Err(StorageError::write(&self.path.join(&name), short));
            }
            manifest.files.insert(name, record);
        }
        let failed = |source| StorageError::write(&self.path.join(MANIFEST), source);
        let text = manifest.to_json().map_err(failed)?;
        self.staging.write_unlisted(MANIFEST, &text).map_err(failed)?;
        synchronise(&self.staging.root, &manifest).map_err(failed)?;
        Ok(manifest)
    }

    /// Takes over the files that stay; returns whether the folders can be exchanged.
    fn carries_over(&self) -> bool {
        carry_over(&self.staging, &self.target, &self.next, self.earlier.as_ref())
    }

    /// Exchanges the folder with the prepared one; where the file system cannot, files are moved.
    /// Returns the folder of files that were in the way.
    fn exchange(&mut self, manifest: &Manifest) -> Result<Option<PathBuf>, StorageError> {
        let (staged, target) = (self.staging.root.clone(), self.target.clone());
        if self.place != Place::Beside || exchange(&staged, &target).is_err() {
            return self.apply(manifest);
        }
        self.staging.moved_to(&target);
        self.lock.moved_to(&staged);
        Ok(retire(&staged, &target))
    }

    /// Moves the prepared files one by one.
    fn apply(&mut self, manifest: &Manifest) -> Result<Option<PathBuf>, StorageError> {
        create_parents(&self.target, manifest)?;
        self.staging.mark_committed().map_err(|e| StorageError::write(&self.path, e))?;
        let displaced = apply(&self.staging.root, &self.target, manifest)?;
        self.staging.remove();
        Ok(displaced)
    }

    /// Ends as a process that dies after its work is marked as committed.
    #[cfg(test)]
    pub(crate) fn die_after_mark(mut self) {
        let manifest = self.write_manifest(self.next.clone()).expect("room");
        create_parents(&self.target, &manifest).expect("room");
        self.staging.mark_committed().expect("room");
        self.staging.leave_lock();
    }

    /// Refuses to replace a file that the earlier command did not write, or that was changed since.
    fn refuse_foreign(&self, relative: &str) -> Result<(), StorageError> {
        let earlier = self.earlier.as_ref().unwrap_or(&self.next);
        match earlier.state(&self.target, relative) {
            FileState::Foreign => Err(foreign(&self.path, relative)),
            FileState::Missing | FileState::Unchanged => Ok(()),
        }
    }
}

/// Errors name the folder as the user did.
fn named(error: StorageError, path: &Path) -> StorageError {
    match error {
        StorageError::Busy { holder, .. } => StorageError::Busy { path: path.to_owned(), holder },
        StorageError::Refused { reason, .. } => StorageError::refused(path, reason),
        StorageError::Write { source, .. } => StorageError::write(path, source),
        saved @ StorageError::Saved { .. } => saved,
    }
}

/// Creates the folder; returns its path without links.
fn create(path: &Path) -> Result<(CreatedFolders, PathBuf), StorageError> {
    let failed = |source| StorageError::write(path, source);
    let created = CreatedFolders::for_path(path);
    fs::create_dir_all(path).map_err(failed)?;
    let target = path.canonicalize().map_err(failed)?;
    Ok((created, target))
}

/// Creates a staging folder beside the target; none where it could not take the target's place.
fn staging_beside(target: &Path, command: &str) -> Option<Staging> {
    let current = std::env::current_dir().and_then(|folder| folder.canonicalize()).ok();
    // A shell that stands in the folder would be left in the old one.
    if !cfg!(unix) || current.is_none_or(|folder| folder.starts_with(target)) {
        return None;
    }
    let staging = Staging::create(target.parent()?, &staging_prefix(target, true), command).ok()?;
    (is_same_mount(&staging, target) && has_same_owner(&staging.root, target)).then_some(staging)
}

/// Gives the staging folder the permissions of the target; returns whether both have one owner and
/// group, as the target's must not change.
#[cfg(unix)]
fn has_same_owner(staging: &Path, target: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(ours), Ok(theirs)) = (staging.metadata(), target.metadata()) else { return false };
    let is_same = (ours.uid(), ours.gid()) == (theirs.uid(), theirs.gid());
    is_same && fs::set_permissions(staging, theirs.permissions()).is_ok()
}

#[cfg(not(unix))]
fn has_same_owner(_: &Path, _: &Path) -> bool {
    true
}

/// Whether files can be moved from the staging folder to the target.
fn is_same_mount(staging: &Staging, target: &Path) -> bool {
    let name = format!(".i2slam-{:016x}", random());
    let (from, to) = (staging.root.join(&name), target.join(&name));
    let created = staging.note(&name).and_then(|()| fs::File::create_new(&from).map(drop));
    let moved = created.and_then(|()| fs::rename(&from, &to));
    // Another process may have taken it for a rest and removed it.
    moved.is_ok()
        && matches!(
            fs::remove_file(&to).map_err(|e| e.kind()),
            Ok(()) | Err(io::ErrorKind::NotFound)
        )
}

/// Folders created for a path, deepest first; removed when dropped if they are empty.
#[derive(Debug)]
struct CreatedFolders(Vec<PathBuf>);

impl CreatedFolders {
    /// Folders missing for a path, before they are created.
    fn for_path(path: &Path) -> Self {
        let missing = path.ancestors().take_while(|above| !above.as_os_str().is_empty());
        Self(missing.take_while(|above| !above.exists()).map(Path::to_owned).collect())
    }
}

impl Drop for CreatedFolders {
    fn drop(&mut self) {
        self.0.iter().for_each(|made| drop(fs::remove_dir(made)));
    }
}

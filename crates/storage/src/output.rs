//! An output folder: what a command writes appears there as a whole.

use crate::error::StorageError;
use crate::file::random;
use crate::lock::FolderLock;
use crate::manifest::{FileState, MANIFEST, Manifest};
use crate::staging::Staging;
use crate::swap::{apply, exchange, free_name, recover, retire, staging_prefix, synchronise};
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
    kept: Manifest,
    is_beside: bool,
}

/// Place of the prepared files.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Place {
    /// Beside the folder where that is possible, else inside.
    Beside,
    /// Inside the folder.
    #[cfg_attr(not(test), expect(dead_code, reason = "tests choose it"))]
    Inside,
}

/// A command's claim on a folder.
#[derive(Clone, Copy, Debug)]
pub struct Claim<'a> {
    /// The command, as in `i2slam run`: it replaces results of its own only.
    pub command: &'a str,
    /// First parts of the paths that it will write.
    pub names: &'a [&'a str],
    /// Whether an earlier result may be replaced.
    pub overwrite: bool,
}

/// Result of a commit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Committed {
    /// The folder.
    pub path: PathBuf,
    /// Folder of the user's files that appeared meanwhile under names of the result.
    pub kept: Option<PathBuf>,
}

impl OutputFolder {
    /// Checks that a command may write a new result, without writing anything.
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
        Self::check(path, claim)?;
        let (created, target) = create(path)?;
        let lock = FolderLock::acquire(&target, claim.command).map_err(|e| named(e, path))?;
        check_contents(path, claim)?;
        let (earlier, kept) = (Manifest::of(&target), Manifest::new(claim.command));
        Self::open(path, target, (created, lock), (earlier, kept), (claim.command, place))
    }

    /// Opens a folder to add files, or to replace some that an earlier command wrote; it is created
    /// if it does not exist. Waits for a few seconds if another process writes there.
    ///
    /// # Errors
    /// `Busy` if it still does.
    pub fn extend(path: &Path, command: &str) -> Result<Self, StorageError> {
        Self::extend_at(path, command, Place::Beside)
    }

    pub(crate) fn extend_at(
        path: &Path,
        command: &str,
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
        recover(&target);
        let earlier = Manifest::of(&target);
        if earlier.is_none() && target.join(MANIFEST).symlink_metadata().is_ok() {
            return Err(foreign(path, MANIFEST));
        }
        let kept = earlier.clone().unwrap_or_else(|| Manifest::new(command));
        Self::open(path, target, (created, lock), (earlier, kept), (command, place))
    }

    fn open(
        path: &Path,
        target: PathBuf,
        (_created, lock): (CreatedFolders, FolderLock),
        (earlier, kept): (Option<Manifest>, Manifest),
        (command, place): (&str, Place),
    ) -> Result<Self, StorageError> {
        let beside = match place {
            Place::Beside => staging_beside(&target, command),
            Place::Inside => None,
        };
        let is_beside = beside.is_some();
        let staging = match beside {
            Some(staging) => staging,
            None => Staging::create(&target, &staging_prefix(&target, false), command)
                .map_err(|e| named(e, path))?,
        };
        let path = path.to_owned();
        Ok(Self { staging, lock, _created, path, target, earlier, kept, is_beside })
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Whether a command wrote the folder before.
    pub fn has_earlier_result(&self) -> bool {
        self.earlier.is_some()
    }

    /// Prepares a file; `relative` has `/` between folders. A second one of the same name replaces
    /// the first when it is complete.
    ///
    /// # Errors
    /// Those of the system; `Refused` if a file of the user's has that name.
    pub fn write(
        &self,
        relative: &str,
        content: impl FnOnce(&mut dyn Write) -> io::Result<()>,
    ) -> Result<(), StorageError> {
        let earlier = self.earlier.as_ref().unwrap_or(&self.kept);
        if !earlier.is_free_or_listed(&self.target, relative) {
            return Err(foreign(&self.path, relative));
        }
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
        self.kept.files.retain(|name, _| !is_removed(name));
    }

    /// Puts the prepared files in place.
    ///
    /// # Errors
    /// After an error nothing has changed in the folder, and [`OutputFolder::commit_beside`] can
    /// still save the files.
    pub fn commit(&mut self) -> Result<Committed, StorageError> {
        for name in self.staging.records().keys() {
            self.refuse_foreign(name)?;
        }
        let manifest = self.write_manifest()?;
        let kept = match self.is_beside && self.link_kept_files() {
            true => self.exchange()?,
            false => self.apply().map(|()| None)?,
        };
        self.earlier = Some(manifest);
        Ok(Committed { path: self.path.clone(), kept })
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
        drop(self.write_manifest());
        let outside = free_name(&self.target, suffix);
        let inside = free_name(&self.target.join("result"), suffix);
        let placed = fs::rename(&self.staging.root, &outside).map(|()| outside);
        let placed = placed.or_else(|_| fs::rename(&self.staging.root, &inside).map(|()| inside));
        let placed = placed.map_err(|e| StorageError::write(&self.path, e))?;
        self.staging.moved_to(&placed);
        Ok(placed)
    }

    /// Checks that all files arrived, and writes their list.
    fn write_manifest(&self) -> Result<Manifest, StorageError> {
        let mut manifest = self.kept.clone();
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

    /// Links the files that stay into the prepared folder; returns whether that was possible.
    fn link_kept_files(&self) -> bool {
        let mut linked = Vec::new();
        for name in self.kept.present(&self.target).filter(|name| !self.staging.contains(name)) {
            linked.push(name);
            if self.staging.link(name, &self.target.join(name)).is_err() {
                self.staging.unlink(&linked);
                return false;
            }
        }
        true
    }

    /// Exchanges the folder with the prepared one; where the file system cannot, files are moved.
    fn exchange(&mut self) -> Result<Option<PathBuf>, StorageError> {
        let old = self.staging.root.clone();
        if let Ok(found) = self.target.metadata() {
            fs::set_permissions(&old, found.permissions()).ok();
        }
        if exchange(&old, &self.target).is_err() {
            return self.apply().map(|()| None);
        }
        let target = self.target.clone();
        self.staging.moved_to(&target);
        self.lock.moved_to(&old);
        Ok(retire(&old, &target))
    }

    /// Moves the prepared files one by one.
    fn apply(&mut self) -> Result<(), StorageError> {
        self.staging.mark_committed().map_err(|e| StorageError::write(&self.path, e))?;
        apply(&self.staging.root, &self.target)?;
        self.staging.remove();
        Ok(())
    }

    /// Refuses to replace a file that the earlier command did not write, or that was changed since.
    fn refuse_foreign(&self, relative: &str) -> Result<(), StorageError> {
        let earlier = self.earlier.as_ref().unwrap_or(&self.kept);
        match earlier.state(&self.target, relative) {
            FileState::Foreign => Err(foreign(&self.path, relative)),
            FileState::Missing | FileState::Unchanged => Ok(()),
        }
    }
}

fn foreign(folder: &Path, name: &str) -> StorageError {
    let reason = format!(
        "holds {name}, which would be replaced and which i2slam did not write, or which was changed \
         since: choose another folder"
    );
    StorageError::refused(folder, reason)
}

/// Errors name the folder as the user did.
fn named(error: StorageError, path: &Path) -> StorageError {
    match error {
        StorageError::Busy { holder, .. } => StorageError::Busy { path: path.to_owned(), holder },
        StorageError::Refused { reason, .. } => StorageError::refused(path, reason),
        StorageError::Write { source, .. } => StorageError::write(path, source),
    }
}

/// Refuses a path that is there and no folder.
fn refuse_file(path: &Path) -> Result<(), StorageError> {
    match path.is_dir() || path.symlink_metadata().is_err() {
        true => Ok(()),
        false => {
            Err(StorageError::refused(path, "is a file: a folder is written, name another one"))
        }
    }
}

fn check_contents(path: &Path, claim: Claim<'_>) -> Result<(), StorageError> {
    refuse_file(path)?;
    let command = claim.command;
    let refuse = |reason: String| Err(StorageError::refused(path, reason));
    let Some(earlier) = Manifest::of(path) else {
        let mut names = claim.names.iter().copied().chain([MANIFEST]);
        let own = names.find(|name| path.join(name).symlink_metadata().is_ok());
        return match (first_entry(path), own) {
            (_, Some(name)) => Err(foreign(path, name)),
            (Some(name), None) if !claim.overwrite => refuse(format!(
                "is not empty, it holds {name}: choose another folder, or write beside it with \
                 --overwrite"
            )),
            _ => Ok(()),
        };
    };
    if earlier.command != command {
        return refuse(format!(
            "is not empty, it holds what `{}` wrote: choose another folder",
            earlier.command
        ));
    }
    if !claim.overwrite {
        return refuse(format!(
            "is not empty, it holds what `{command}` wrote before: choose another folder, or \
             replace that with --overwrite"
        ));
    }
    let unlisted = claim.names.iter().copied().find(|name| is_unlisted(path, name, &earlier));
    match earlier.first_changed(path).or(unlisted) {
        Some(name) => Err(foreign(path, name)),
        None => Ok(()),
    }
}

/// Whether a name of the next result is taken by anything but a folder or a file of this one.
fn is_unlisted(folder: &Path, name: &str, earlier: &Manifest) -> bool {
    let Ok(found) = folder.join(name).symlink_metadata() else { return false };
    !found.is_dir() && !earlier.files.contains_key(name)
}

/// The first entry of a folder that is not hidden.
pub fn first_entry(folder: &Path) -> Option<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.filter(|name| !name.starts_with('.')).min()
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
    is_same_mount(&staging, target).then_some(staging)
}

/// Whether files can be moved from the staging folder to the target.
fn is_same_mount(staging: &Staging, target: &Path) -> bool {
    let name = format!(".i2slam-{:016x}", random());
    let (from, to) = (staging.root.join(&name), target.join(&name));
    let created = staging.note(&name).and_then(|()| fs::File::create_new(&from).map(drop));
    let moved = created.and_then(|()| fs::rename(&from, &to));
    moved.and_then(|()| fs::remove_file(&to)).is_ok()
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

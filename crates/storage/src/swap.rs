//! A prepared folder takes the place of the one before.

use crate::error::StorageError;
use crate::lock::{FolderLock, LOCK, Role};
use crate::manifest::{FileState, MANIFEST, Manifest, is_below, remove_empty_folders, remove_file};
use crate::staging::{COMMITTED, KEPT, remove_staged};
use std::collections::BTreeSet;
use std::ffi::{OsStr, OsString};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// Exchanges two folders of one file system at one instant.
#[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
pub(crate) fn exchange(a: &Path, b: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    Ok(renameat_with(CWD, a, CWD, b, RenameFlags::EXCHANGE)?)
}

#[cfg(not(any(target_os = "linux", target_os = "android", target_vendor = "apple")))]
pub(crate) fn exchange(_: &Path, _: &Path) -> io::Result<()> {
    Err(io::ErrorKind::Unsupported.into())
}

/// Waits until the files of a folder are on the disk, so that a full one is noticed.
pub(crate) fn synchronise(folder: &Path, manifest: &Manifest) -> io::Result<()> {
    #[cfg(target_os = "linux")]
    {
        let _ = manifest;
        Ok(rustix::fs::syncfs(fs::File::open(folder)?)?)
    }
    #[cfg(not(target_os = "linux"))]
    {
        let files = manifest.files.keys().map(|name| folder.join(name));
        let open = |path| fs::File::options().write(true).open(path);
        files.filter(|path| path.is_file()).try_for_each(|path| open(path)?.sync_all())
    }
}

/// Removes the files of an earlier result from `old`, which `target` has replaced, and moves
/// everything else, which is the user's, to `target`. Returns the folder of what was in the way.
pub(crate) fn retire(old: &Path, target: &Path) -> Option<PathBuf> {
    let manifest = Manifest::of(old);
    let listed = manifest.iter().flat_map(|manifest| manifest.files.keys().map(String::as_str));
    let listed: Vec<&str> = listed.collect();
    for (manifest, name) in manifest.iter().flat_map(|m| listed.iter().map(move |name| (m, name))) {
        let is_kept = is_linked(&old.join(name), &target.join(name));
        if is_kept || manifest.state(old, name) == FileState::Unchanged {
            fs::remove_file(old.join(name)).ok();
        }
    }
    remove_empty_folders(old, listed.into_iter());
    if manifest.is_some() {
        fs::remove_file(old.join(MANIFEST)).ok();
    }
    move_entries(old, target, true);
    let is_empty =
        fs::read_dir(old).is_ok_and(|mut all| all.all(|e| e.is_ok_and(|e| e.file_name() == LOCK)));
    let (rest, displaced) = match is_empty {
        true => (old.to_owned(), None),
        false => {
            let kept = free_name(target, "kept");
            let kept = if fs::rename(old, &kept).is_ok() { kept } else { old.to_owned() };
            (kept.clone(), Some(kept))
        }
    };
    fs::remove_file(rest.join(LOCK)).ok();
    if is_empty {
        fs::remove_dir(rest).ok();
    }
    displaced
}

/// Whether both paths are one file.
#[cfg(unix)]
fn is_linked(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(a), Ok(b)) = (a.symlink_metadata(), b.symlink_metadata()) else { return false };
    !a.is_dir() && (a.dev(), a.ino()) == (b.dev(), b.ino())
}

#[cfg(not(unix))]
fn is_linked(_: &Path, _: &Path) -> bool {
    false
}

/// Moves what a folder holds into another, where nothing is in the way; files that are linked there
/// already go. The lock file of the folder itself stays.
fn move_entries(from: &Path, to: &Path, is_root: bool) {
    for entry in fs::read_dir(from).into_iter().flatten().flatten() {
        let (source, destination) = (entry.path(), to.join(entry.file_name()));
        if is_root && entry.file_name() == LOCK {
            continue;
        }
        match destination.symlink_metadata() {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                rename_new(&source, &destination).ok();
            }
            Err(_) => {}
            Ok(found) if found.is_dir() && entry.file_type().is_ok_and(|kind| kind.is_dir()) => {
                move_entries(&source, &destination, false);
                fs::remove_dir(&source).ok();
            }
            Ok(_) if is_linked(&source, &destination) => drop(fs::remove_file(&source)),
            Ok(_) => {}
        }
    }
}

/// Renames a file unless something is in the way.
#[cfg(any(target_os = "linux", target_os = "android", target_vendor = "apple"))]
fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    use rustix::fs::{CWD, RenameFlags, renameat_with};
    match renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // Not every file system has the flag.
        Err(rustix::io::Errno::INVAL | rustix::io::Errno::NOSYS) => fs::rename(from, to),
        other => Ok(other?),
    }
}

#[cfg(not(any(target_os = "linux", target_os = "android", target_vendor = "apple")))]
fn rename_new(from: &Path, to: &Path) -> io::Result<()> {
    fs::rename(from, to)
}

/// Creates the folders of a result, before anything is moved.
pub(crate) fn create_parents(target: &Path, manifest: &Manifest) -> Result<(), StorageError> {
    let paths = manifest.files.keys().map(|name| target.join(name));
    let parents: BTreeSet<PathBuf> =
        paths.filter_map(|path| Some(path.parent()?.to_owned())).collect();
    parents.iter().try_for_each(|parent| {
        fs::create_dir_all(parent).map_err(|source| StorageError::write(parent, source))
    })
}

/// Puts a prepared folder in place file by file, the manifest last. What a dead process began goes
/// on here. Files of the user that are in the way stay; what they displace goes into the folder
/// that is returned.
pub(crate) fn apply(
    staged: &Path,
    target: &Path,
    next: &Manifest,
) -> Result<Option<PathBuf>, StorageError> {
    let earlier = Manifest::of(target).unwrap_or_else(|| Manifest::new(""));
    let mut is_displaced = false;
    // A file that stays may be linked already, for an exchange that the file system refused.
    let is_new = |name: &str| {
        staged.join(name).is_file() && !is_linked(&staged.join(name), &target.join(name))
    };
    for name in next.files.keys().filter(|name| is_new(name)) {
        let is_ours = earlier.state(target, name) != FileState::Foreign
            || next.state(target, name) == FileState::Unchanged;
        match is_ours {
            true => move_file(staged, target, name)?,
            false => is_displaced = true,
        }
    }
    for name in earlier.files.keys().filter(|name| !next.files.contains_key(*name)) {
        if earlier.state(target, name) == FileState::Unchanged {
            remove_file(&target.join(name))?;
        }
    }
    remove_empty_folders(target, earlier.files.keys().map(String::as_str));
    let displaced = is_displaced.then(|| free_name(&target.join("result"), "kept"));
    for (folder, name) in
        displaced.iter().flat_map(|f| next.files.keys().map(move |name| (f, name)))
    {
        if is_new(name) {
            move_file(staged, folder, name)?;
        }
    }
    move_file(staged, target, MANIFEST)?;
    Ok(displaced)
}

fn move_file(from: &Path, to: &Path, name: &str) -> Result<(), StorageError> {
    let path = to.join(name);
    let parent = path.parent().map_or(Ok(()), fs::create_dir_all);
    let placed = parent.and_then(|()| fs::rename(from.join(name), &path));
    placed.map_err(|source| StorageError::write(&path, source))
}

/// Names of staging folders: beside their target, or inside where a sibling cannot take its place.
pub(crate) fn staging_prefix(target: &Path, beside: bool) -> OsString {
    let mut prefix = OsString::from(".");
    if beside {
        prefix.push(target.file_name().unwrap_or_default());
        prefix.push(".");
    }
    prefix.push("i2slam-");
    prefix
}

/// Finishes or removes what processes that died left of their work on a folder. Returns the folders
/// of parts that were saved.
pub(crate) fn recover(target: &Path) -> Vec<PathBuf> {
    let mut saved = Vec::new();
    let (beside, inside) = (staging_prefix(target, true), staging_prefix(target, false));
    let places = [target.parent().map(|parent| (parent, beside)), Some((target, inside))];
    for (parent, prefix) in places.into_iter().flatten() {
        for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
            if !is_staging_name(&entry.file_name(), &prefix) {
                continue;
            }
            match entry.metadata() {
                // In a folder that all may write to, others may have made it.
                Ok(found) if !is_own(&found) => {}
                Ok(found) if found.is_dir() => saved.extend(recover_staging(&entry.path(), target)),
                // The empty file by which it was found out whether files can be moved.
                Ok(found) if found.is_file() && found.len() == 0 => {
                    fs::remove_file(entry.path()).ok();
                }
                _ => {}
            }
        }
    }
    saved
}

/// The prefix with sixteen hexadecimal digits.
fn is_staging_name(name: &OsStr, prefix: &OsStr) -> bool {
    let number = name.as_encoded_bytes().strip_prefix(prefix.as_encoded_bytes());
    number.is_some_and(|digits| digits.len() == 16 && digits.iter().all(u8::is_ascii_hexdigit))
}

/// Returns the folder of a part that was saved.
fn recover_staging(folder: &Path, target: &Path) -> Option<PathBuf> {
    let Some((lock, role, lines)) = FolderLock::take_over(folder) else {
        // Without a lock file it is empty: its process died before or after its work.
        fs::remove_dir(folder).ok();
        return None;
    };
    let has_mark = |mark: &str| lines.iter().any(|line| line == mark);
    let (is_committed, is_kept) = (has_mark(COMMITTED), has_mark(KEPT));
    let names: Vec<String> = lines.into_iter().filter(|line| is_below(line)).collect();
    let mut saved = None;
    match role {
        // It was the target, and its successor has taken its place.
        Role::Output => drop(retire(folder, target)),
        Role::Staging if is_committed => finish(folder, target, &names),
        Role::Staging if is_kept && names.iter().any(|name| folder.join(name).is_file()) => {
            let part = free_name(target, "partial");
            if fs::rename(folder, &part).is_ok() {
                fs::remove_file(part.join(LOCK)).ok();
                saved = Some(part);
            }
        }
        Role::Staging => remove_staged(folder, &names),
    }
    drop(lock);
    saved
}

/// Finishes a commit that a dead process began.
fn finish(staged: &Path, target: &Path, names: &[String]) {
    let applied = match Manifest::of(staged) {
        Some(next) => apply(staged, target, &next).is_ok(),
        // It is moved last: all files are in place, unless it cannot be read.
        None => staged.join(MANIFEST).symlink_metadata().is_err(),
    };
    if applied {
        remove_staged(staged, names);
    }
}

#[cfg(unix)]
fn is_own(found: &fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt;
    found.uid() == rustix::process::geteuid().as_raw()
}

#[cfg(not(unix))]
fn is_own(_: &fs::Metadata) -> bool {
    true
}

/// `NAME-SUFFIX` beside a folder, numbered if that exists.
pub(crate) fn free_name(folder: &Path, suffix: &str) -> PathBuf {
    let numbered = |number: u32| {
        let mut name = folder.file_name().unwrap_or_default().to_owned();
        name.push(match number {
            1 => format!("-{suffix}"),
            number => format!("-{suffix}-{number}"),
        });
        folder.with_file_name(name)
    };
    let free = (1..).map(numbered).find(|path| path.symlink_metadata().is_err());
    free.unwrap_or_else(|| numbered(0))
}

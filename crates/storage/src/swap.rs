//! A prepared folder takes the place of the one before.

use crate::error::StorageError;
use crate::lock::{FolderLock, LOCK, Role};
use crate::manifest::{FileState, MANIFEST, Manifest, is_below, remove_empty_folders, remove_file};
use crate::staging::{COMMITTED, remove_staged};
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
        files.filter(|path| path.is_file()).try_for_each(|path| fs::File::open(path)?.sync_all())
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
    move_entries(old, target);
    fs::remove_file(old.join(LOCK)).ok();
    if fs::remove_dir(old).is_ok() {
        return None;
    }
    let kept = free_name(target, "kept");
    match fs::rename(old, &kept) {
        Ok(()) => Some(kept),
        Err(_) => Some(old.to_owned()),
    }
}

/// Whether both paths are one file.
#[cfg(unix)]
fn is_linked(a: &Path, b: &Path) -> bool {
    use std::os::unix::fs::MetadataExt;
    let (Ok(a), Ok(b)) = (a.symlink_metadata(), b.symlink_metadata()) else { return false };
    a.is_file() && (a.dev(), a.ino()) == (b.dev(), b.ino())
}

#[cfg(not(unix))]
fn is_linked(_: &Path, _: &Path) -> bool {
    false
}

/// Moves what a folder holds into another, where nothing is in the way.
fn move_entries(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).into_iter().flatten().flatten() {
        let (source, destination) = (entry.path(), to.join(entry.file_name()));
        if entry.file_name() == LOCK {
            continue;
        }
        match destination.symlink_metadata() {
            Err(_) => drop(fs::rename(&source, &destination)),
            Ok(found) if found.is_dir() && entry.file_type().is_ok_and(|kind| kind.is_dir()) => {
                move_entries(&source, &destination);
                fs::remove_dir(&source).ok();
            }
            Ok(_) => {}
        }
    }
}

/// Puts a prepared folder in place file by file, the manifest last, and removes it. What a dead
/// process began goes on here.
pub(crate) fn apply(staged: &Path, target: &Path) -> Result<(), StorageError> {
    // The manifest is moved last: without it all files are in place.
    let Some(new) = Manifest::of(staged) else { return Ok(()) };
    let old = Manifest::of(target);
    for (old, name) in old.iter().flat_map(|old| old.files.keys().map(move |name| (old, name))) {
        if !new.files.contains_key(name) && old.state(target, name) == FileState::Unchanged {
            remove_file(&target.join(name))?;
        }
    }
    let written = new.files.keys().map(String::as_str).chain([MANIFEST]);
    for name in written.filter(|name| staged.join(name).is_file()) {
        let path = target.join(name);
        let parent = path.parent().map_or(Ok(()), fs::create_dir_all);
        let placed = parent.and_then(|()| fs::rename(staged.join(name), &path));
        placed.map_err(|source| StorageError::write(&path, source))?;
    }
    let old = old.iter().flat_map(|old| old.files.keys().map(String::as_str));
    remove_empty_folders(target, old);
    Ok(())
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

/// Finishes or removes what processes that died left of their work on a folder.
pub(crate) fn recover(target: &Path) {
    let (beside, inside) = (staging_prefix(target, true), staging_prefix(target, false));
    let places = [target.parent().map(|parent| (parent, beside)), Some((target, inside))];
    for (parent, prefix) in places.into_iter().flatten() {
        for entry in fs::read_dir(parent).into_iter().flatten().flatten() {
            if !is_staging_name(&entry.file_name(), &prefix) {
                continue;
            }
            match entry.metadata() {
                Ok(found) if found.is_dir() => recover_staging(&entry.path(), target),
                // The empty file by which it was found out whether files can be moved.
                Ok(found) if found.is_file() && found.len() == 0 => {
                    fs::remove_file(entry.path()).ok();
                }
                _ => {}
            }
        }
    }
}

/// The prefix with sixteen hexadecimal digits.
fn is_staging_name(name: &OsStr, prefix: &OsStr) -> bool {
    let number = name.as_encoded_bytes().strip_prefix(prefix.as_encoded_bytes());
    number.is_some_and(|digits| digits.len() == 16 && digits.iter().all(u8::is_ascii_hexdigit))
}

fn recover_staging(folder: &Path, target: &Path) {
    let Some((lock, role, lines)) = FolderLock::take_over(folder) else {
        // Without a lock file it is empty: its process died before or after its work.
        fs::remove_dir(folder).ok();
        return;
    };
    let is_committed = lines.iter().any(|line| line == COMMITTED);
    let names: Vec<String> = lines.into_iter().filter(|line| is_below(line)).collect();
    match role {
        // It was the target, and its successor has taken its place.
        Role::Output => drop(retire(folder, target)),
        Role::Staging if is_committed => {
            if apply(folder, target).is_ok() {
                remove_staged(folder, &names);
            }
        }
        Role::Staging => remove_staged(folder, &names),
    }
    drop(lock);
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

//! The rule by which a command may write into a folder.

use crate::error::StorageError;
use crate::manifest::{MANIFEST, Manifest};
use std::fs;
use std::path::Path;

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

pub(crate) fn foreign(folder: &Path, name: &str) -> StorageError {
    let reason = format!(
        "holds {name}, which would be replaced and which i2slam did not write, or which was changed \
         since: choose another folder"
    );
    StorageError::refused(folder, reason)
}

/// Refuses a path that is there and no folder.
pub(crate) fn refuse_file(path: &Path) -> Result<(), StorageError> {
    match path.is_dir() || path.symlink_metadata().is_err() {
        true => Ok(()),
        false => {
            Err(StorageError::refused(path, "is a file: a folder is written, name another one"))
        }
    }
}

pub(crate) fn check_contents(path: &Path, claim: Claim<'_>) -> Result<(), StorageError> {
    refuse_file(path)?;
    let command = claim.command;
    let refuse = |reason: String| Err(StorageError::refused(path, reason));
    let Some(earlier) = Manifest::of(path) else {
        let mut names = claim.names.iter().copied().chain([MANIFEST]);
        let own = names.find(|name| path.join(name).symlink_metadata().is_ok());
        return match (first_entry(path), own) {
            (_, Some(name)) => Err(foreign(path, name)),
            (Some(name), None) if !claim.overwrite => refuse(format!(
                "is not empty, it holds {name}: choose another folder, or add to it with \
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
pub(crate) fn is_unlisted(folder: &Path, name: &str, earlier: &Manifest) -> bool {
    let Ok(found) = folder.join(name).symlink_metadata() else { return false };
    !found.is_dir() && !earlier.files.contains_key(name)
}

/// The first entry of a folder that is not hidden.
pub fn first_entry(folder: &Path) -> Option<String> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    names.filter(|name| !name.starts_with('.')).min()
}

//! `i2slam-manifest.json`: the files that a command wrote into a folder, with sizes and checksums.
//!
//! Only a file that is listed and unchanged is ever replaced or removed: everything else in the
//! folder is the user's.

use crate::error::StorageError;
use crate::read::{open, read_text};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::io::{self, Read};
use std::path::{Component, Path};

/// Name of the manifest in its folder.
pub const MANIFEST: &str = "i2slam-manifest.json";

/// Version of the manifest's format.
const FORMAT: u32 = 1;

/// Size and checksum of a file.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileRecord {
    /// Size [bytes].
    pub bytes: u64,
    /// CRC-32 (ISO-HDLC) in hexadecimal.
    pub crc32: String,
}

/// The files of a folder that a command wrote.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Manifest {
    format: u32,
    /// The command, as in `i2slam run`.
    pub command: String,
    /// Version of the program.
    version: String,
    /// Records by path, with `/` between folders.
    pub files: BTreeMap<String, FileRecord>,
}

/// A path of a folder, compared with the manifest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FileState {
    /// Nothing is there.
    Missing,
    /// As it was written.
    Unchanged,
    /// Changed since, or never written by the command: the user's.
    Foreign,
}

impl Manifest {
    pub(crate) fn new(command: &str) -> Self {
        let version = env!("CARGO_PKG_VERSION").to_owned();
        Self { format: FORMAT, command: command.to_owned(), version, files: BTreeMap::new() }
    }

    /// The manifest of a folder; `None` if there is none that this version reads.
    pub fn of(folder: &Path) -> Option<Self> {
        let path = folder.join(MANIFEST);
        let is_file = path.symlink_metadata().is_ok_and(|found| found.is_file());
        let manifest: Self =
            serde_json::from_str(&read_text(&path).ok().filter(|_| is_file)?).ok()?;
        let sound = manifest.format == FORMAT && manifest.files.keys().all(|path| is_below(path));
        sound.then_some(manifest)
    }

    pub(crate) fn to_json(&self) -> io::Result<String> {
        Ok(serde_json::to_string_pretty(self).map_err(io::Error::other)? + "\n")
    }

    /// Compares a path of the folder with its record.
    pub(crate) fn state(&self, folder: &Path, relative: &str) -> FileState {
        if let Some(state) = parents_state(folder, relative) {
            return state;
        }
        let path = folder.join(relative);
        let Ok(found) = path.symlink_metadata() else { return FileState::Missing };
        let record = self.files.get(relative).filter(|_| found.is_file());
        match record {
            Some(record) if record.is_of(&path, found.len()) => FileState::Unchanged,
            _ => FileState::Foreign,
        }
    }

    /// Names of the listed files that exist.
    pub(crate) fn present<'a>(&'a self, folder: &'a Path) -> impl Iterator<Item = &'a str> {
        let is_there = |name: &&str| {
            parents_state(folder, name).is_none()
                && folder.join(name).symlink_metadata().is_ok_and(|found| found.is_file())
        };
        self.files.keys().map(String::as_str).filter(is_there)
    }

    /// The first listed file that was changed since it was written.
    pub(crate) fn first_changed(&self, folder: &Path) -> Option<&str> {
        let mut names = self.files.keys().map(String::as_str);
        names.find(|name| self.state(folder, name) == FileState::Foreign)
    }
}

impl FileRecord {
    pub(crate) fn new(bytes: u64, crc32: u32) -> Self {
        Self { bytes, crc32: format!("{crc32:08x}") }
    }

    /// Whether a file has this size and checksum.
    fn is_of(&self, path: &Path, size: u64) -> bool {
        size == self.bytes && checksum(path).is_ok_and(|sum| format!("{sum:08x}") == self.crc32)
    }
}

/// CRC-32 of a file.
fn checksum(path: &Path) -> io::Result<u32> {
    let (mut file, mut sum) = (open(path)?, crc32fast::Hasher::new());
    let mut buffer = vec![0; 1 << 16];
    loop {
        match file.read(&mut buffer)? {
            0 => return Ok(sum.finalize()),
            count => sum.update(&buffer[..count]),
        }
    }
}

/// The state of a path whose folders decide it: a link on the way leads out of the folder, so that
/// what lies behind it is the user's.
fn parents_state(folder: &Path, relative: &str) -> Option<FileState> {
    let parents: Vec<&Path> = Path::new(relative).ancestors().skip(1).collect();
    let parents = parents.into_iter().rev().filter(|path| !path.as_os_str().is_empty());
    for parent in parents {
        match folder.join(parent).symlink_metadata() {
            Ok(found) if found.is_dir() => {}
            Ok(_) => return Some(FileState::Foreign),
            Err(_) => return Some(FileState::Missing),
        }
    }
    None
}

/// Whether a path stays below its folder.
pub(crate) fn is_below(relative: &str) -> bool {
    let path = Path::new(relative);
    !relative.is_empty() && path.components().all(|part| matches!(part, Component::Normal(_)))
}

/// Removes a folder's empty folders that held `files`, deepest first; others stay.
pub(crate) fn remove_empty_folders<'a>(folder: &Path, files: impl Iterator<Item = &'a str>) {
    let mut holders: Vec<&Path> =
        files.flat_map(|file| Path::new(file).ancestors().skip(1)).collect();
    holders.retain(|path| !path.as_os_str().is_empty());
    holders.sort_by_key(|path| (std::cmp::Reverse(path.components().count()), *path));
    holders.dedup();
    holders.iter().for_each(|path| drop(fs::remove_dir(folder.join(path))));
}

/// Removes a file; one that is not there is no error.
pub(crate) fn remove_file(path: &Path) -> Result<(), StorageError> {
    match fs::remove_file(path) {
        Err(source) if source.kind() != io::ErrorKind::NotFound => {
            Err(StorageError::write(path, source))
        }
        _ => Ok(()),
    }
}

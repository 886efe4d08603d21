//! Files that a flag names: where they may be, and what becomes of earlier ones.

use std::path::{Path, PathBuf};

/// Checks that the folder of a new file is there, and that it is none of `folders`, which hold dataset
/// and results; else says why not.
pub(crate) fn check_folder(file: &Path, folders: [&Path; 2]) -> Result<(), &'static str> {
    let parent = file.parent().filter(|parent| !parent.as_os_str().is_empty());
    let Ok(place) = parent.unwrap_or(Path::new(".")).canonicalize() else {
        return Err("there is no such folder");
    };
    let is_within =
        |folder: &&Path| folder.canonicalize().is_ok_and(|folder| place.starts_with(folder));
    match folders.iter().any(is_within) {
        true => Err("it would be in the dataset or among the results, choose another folder"),
        false => Ok(()),
    }
}

/// Name that an earlier file gets where a new one takes its place.
pub(crate) fn previous(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".previous");
    name.into()
}

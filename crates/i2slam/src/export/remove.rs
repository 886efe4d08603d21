//! What a program may take away again: its own files, by name.

use super::renders::pictures;
use super::{ExportError, remove_renders};
use std::fs;
use std::path::{Path, PathBuf};

/// Files of a result folder, as `docs/result-folder.md` lists them.
const FILES: [&str; 14] = [
    "trajectory.txt",
    "trajectory_shutter.txt",
    "trajectory_optimised.txt",
    "frames.csv",
    "config.toml",
    "input.json",
    "camera.json",
    "camera_response.csv",
    "state.json",
    "map.i2slam",
    "map.ply",
    "metrics.json",
    "evaluation.json",
    "report.html",
];

/// Files by which a result is known; a dataset has none of them.
const MARKS: [&str; 5] =
    ["trajectory_shutter.txt", "frames.csv", "state.json", "map.i2slam", "report.html"];

/// What a folder holds of the names that a run writes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FolderContents {
    /// None of them: writing there replaces nothing.
    Free,
    /// The result of a run.
    Result,
    /// This file, and nothing by which it is known as a run's: it may be the user's own.
    Foreign(PathBuf),
}

impl FolderContents {
    /// Looks into a folder, which need not exist.
    pub fn of(folder: &Path) -> Self {
        if MARKS.iter().any(|name| folder.join(name).is_file()) {
            return Self::Result;
        }
        let taken = |path: &PathBuf| path.symlink_metadata().is_ok();
        let file = FILES.iter().map(|name| folder.join(name)).find(taken);
        match file.or_else(|| pictures(folder).into_iter().next()) {
            Some(file) => Self::Foreign(file),
            None => Self::Free,
        }
    }
}

/// Delete the files and pictures that a run, its evaluation and `i2slam render` wrote into a
/// result folder, and nothing else.
pub fn remove_result(folder: &Path) -> Result<(), ExportError> {
    for path in FILES.iter().map(|name| folder.join(name)).filter(|path| path.is_file()) {
        fs::remove_file(&path).map_err(|source| ExportError::Write { path, source })?;
    }
    remove_renders(folder)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::ResultFolder;
    use crate::export::storage::tests::Scratch;

    #[test]
    fn only_files_of_a_result_are_removed() {
        let scratch = Scratch::new("remove");
        let folder = ResultFolder::create(&scratch.0).expect("a folder");
        assert_eq!(FolderContents::of(&scratch.0), FolderContents::Free);
        for name in FILES.into_iter().chain(["notes.txt", "rgb.txt"]) {
            folder.write_text(name, "x").expect("room");
        }
        assert_eq!(FolderContents::of(&scratch.0), FolderContents::Result);
        remove_result(&scratch.0).expect("removal");
        assert_eq!(FolderContents::of(&scratch.0), FolderContents::Free);
        assert_eq!(fs::read_dir(&scratch.0).map(Iterator::count).ok(), Some(2));
        assert!(scratch.0.join("notes.txt").exists());
    }

    #[test]
    fn a_result_is_known_by_its_marks() {
        let others = FILES.into_iter().chain(["renders/sharp/000012.png"]);
        for (case, name) in others.enumerate() {
            let scratch = Scratch::new(&format!("marks-{case}"));
            let folder = ResultFolder::create(&scratch.0).expect("a folder");
            folder.write_text(name, "x").expect("room");
            let expected = match MARKS.contains(&name) {
                true => FolderContents::Result,
                false => FolderContents::Foreign(scratch.0.join(name)),
            };
            assert_eq!(FolderContents::of(&scratch.0), expected);
        }
    }
}

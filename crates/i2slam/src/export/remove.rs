//! What a program may take away again: its own files, by name.

use super::{ExportError, remove_renders};
use std::fs;
use std::path::Path;

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

/// Whether a run wrote into this folder before.
pub fn holds_result(folder: &Path) -> bool {
    MARKS.iter().any(|name| folder.join(name).is_file())
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
        assert!(!holds_result(&scratch.0));
        for name in FILES.into_iter().chain(["notes.txt", "rgb.txt"]) {
            folder.write_text(name, "x").expect("room");
        }
        assert!(holds_result(&scratch.0));
        remove_result(&scratch.0).expect("removal");
        assert!(!holds_result(&scratch.0));
        assert_eq!(fs::read_dir(&scratch.0).map(Iterator::count).ok(), Some(2));
        assert!(scratch.0.join("notes.txt").exists());
    }
}

//! An earlier result in the folder of a run that ended early.

use i2slam_result::{FolderContents, Layout, Metrics};
use std::fs;
use std::path::{Path, PathBuf};

/// Whether a folder holds a result that is complete, or has more than `tracked` frames; of one
/// whose figures cannot be read that is assumed.
pub(super) fn is_better(folder: &Path, tracked: usize) -> bool {
    Layout::of_result().contents(folder) == FolderContents::Own
        && figures(folder).is_none_or(|earlier| earlier.complete || earlier.tracked > tracked)
}

/// The folder beside it for what there is of a run that ended early: `NAME-partial`, or with a
/// number where that holds anything but such a part.
pub(super) fn beside(folder: &Path) -> PathBuf {
    let whole = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let name = whole.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let numbered = |number: usize| match number {
        1 => whole.with_file_name(format!("{name}-partial")),
        number => whole.with_file_name(format!("{name}-partial-{number}")),
    };
    let is_free = |path: &PathBuf| match Layout::of_result().contents(path) {
        FolderContents::Empty => !path.is_file(),
        FolderContents::Own => figures(path).is_some_and(|earlier| !earlier.complete),
        FolderContents::Other(_) | FolderContents::Foreign(_) => false,
    };
    (1..).map(numbered).find(is_free).unwrap_or(whole)
}

fn figures(folder: &Path) -> Option<Metrics> {
    serde_json::from_str(&fs::read_to_string(folder.join("metrics.json")).ok()?).ok()
}

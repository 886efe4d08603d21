//! What a file or folder of keyframes is.

use crate::DatasetError;
use crate::layouts::contents;
use crate::lists::data_lines;
use std::path::{Path, PathBuf};

/// How imported keyframes lie on disk. See docs/import.md for each.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum Kind {
    /// A trajectory in the TUM format, and pictures.
    Trajectory,
}

impl Kind {
    /// All kinds, in the order in which they are looked for.
    pub const ALL: [Self; 1] = [Self::Trajectory];

    /// Its name for people.
    pub fn name(self) -> &'static str {
        match self {
            Self::Trajectory => "TUM trajectory",
        }
    }

    /// The files by which it is recognised.
    pub fn recognised_by(self) -> &'static str {
        match self {
            Self::Trajectory => {
                "a text file with lines timestamp tx ty tz qx qy qz qw, or a folder with it as \
                 trajectory.txt"
            }
        }
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name())
    }
}

/// A kind with its files.
pub(super) enum Recognised {
    Trajectory(PathBuf),
}

impl Recognised {
    /// Finds out what `path` is.
    pub(super) fn in_path(path: &Path) -> Result<Self, DatasetError> {
        let unknown =
            |found: String| Err(DatasetError::UnknownImport { path: path.to_path_buf(), found });
        let found = if path.is_file() { Self::file(path) } else { Self::folder(path) };
        match found {
            Some(found) => Ok(found),
            None if !path.exists() => unknown("nothing".into()),
            None if path.is_file() => unknown("a file of another kind".into()),
            None => unknown(contents(path)),
        }
    }

    fn file(path: &Path) -> Option<Self> {
        is_trajectory(path).then(|| Self::Trajectory(path.to_path_buf()))
    }

    fn folder(path: &Path) -> Option<Self> {
        let trajectory = path.join("trajectory.txt");
        trajectory.is_file().then_some(Self::Trajectory(trajectory))
    }
}

/// Whether a file is text whose first line with data starts with a number and has several.
fn is_trajectory(path: &Path) -> bool {
    let Ok(text) = std::fs::read_to_string(path) else { return false };
    data_lines(&text).next().is_none_or(|(_, line)| {
        let mut words = line.split_whitespace();
        words.next().is_some_and(|word| word.parse::<f64>().is_ok()) && words.count() >= 6
    })
}

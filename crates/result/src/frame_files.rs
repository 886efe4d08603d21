//! Files of the pictures taken: the column `file` of `frames.csv`.

use crate::ResultError;
use crate::error::read_text;
use i2slam::FrameEstimate;
use i2slam::dataset::{Layout, Sequence};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Name of the column, the last of a table.
pub(crate) const FILE_COLUMN: &str = "file";

/// Files of the pictures by the positions of their frames in the associated stream, as paths from the folder
/// of the dataset; none of frames within a video or another file of many pictures.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameFiles(BTreeMap<usize, String>);

impl FrameFiles {
    /// The files of a sequence in the folder `dataset`.
    pub fn of(sequence: &Sequence, dataset: &Path) -> Self {
        if sequence.layout == Layout::Video {
            return Self::default();
        }
        let files = sequence.entries.iter().filter(|entry| entry.parts.is_none());
        let named = files.map(|entry| {
            let path = entry.colour.strip_prefix(dataset).unwrap_or(&entry.colour);
            let parts = path.iter().map(|part| part.to_string_lossy().into_owned());
            (entry.index, parts.collect::<Vec<_>>().join("/"))
        });
        Self(named.collect())
    }

    /// The files that the `frames.csv` of a result names; none of results of earlier versions.
    ///
    /// # Errors
    /// A table that cannot be read.
    pub fn load(folder: &Path) -> Result<Self, ResultError> {
        let text = read_text(&folder.join("frames.csv"))?;
        let mut lines = text.lines();
        let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
        if names.last() != Some(&FILE_COLUMN) {
            return Ok(Self::default());
        }
        let named = lines.filter_map(|line| {
            let mut cells = line.splitn(names.len(), ',');
            let index = cells.next()?.parse().ok()?;
            let file = unquoted(cells.nth(names.len() - 2)?);
            (!file.is_empty()).then_some((index, file))
        });
        Ok(Self(named.collect()))
    }

    /// The file of a frame.
    pub fn get(&self, index: usize) -> Option<&str> {
        self.0.get(&index).map(String::as_str)
    }

    /// Name of a frame for people: its number, and its file where it has one.
    pub fn name(&self, index: usize) -> String {
        match self.get(index) {
            Some(file) => format!("{index}, {file}"),
            None => index.to_string(),
        }
    }

    /// The files of frames that have no pose or are missing among `frames`.
    pub fn without_pose(&self, frames: &[FrameEstimate]) -> Vec<String> {
        let tracked: BTreeSet<usize> =
            frames.iter().filter(|f| f.tracked).map(|f| f.index).collect();
        let without = self.0.iter().filter(|(index, _)| !tracked.contains(index));
        without.map(|(_, file)| file.clone()).collect()
    }

    /// Cell of the table for a frame; empty without a file.
    pub(crate) fn cell(&self, index: usize) -> String {
        self.get(index).map(quoted).unwrap_or_default()
    }

    /// Names of files without folder and ending, where those of all frames differ and are fit for names on any
    /// system and in COLMAP's lists, whose columns end with a space.
    pub(crate) fn stems(&self, frames: &[FrameEstimate]) -> Option<BTreeMap<usize, String>> {
        let stem = |frame: &FrameEstimate| {
            let stem = Path::new(self.get(frame.index)?).file_stem()?.to_str()?.to_owned();
            let is_plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '_' | '.');
            let is_safe = stem.starts_with(|c: char| c.is_ascii_alphanumeric() || c == '_')
                && stem.chars().all(is_plain);
            is_safe.then_some((frame.index, stem))
        };
        let stems: BTreeMap<usize, String> = frames.iter().map(stem).collect::<Option<_>>()?;
        // Some systems do not tell small letters from capitals.
        let different: BTreeSet<String> = stems.values().map(|s| s.to_lowercase()).collect();
        (different.len() == stems.len()).then_some(stems)
    }
}

impl FromIterator<(usize, String)> for FrameFiles {
    fn from_iter<I: IntoIterator<Item = (usize, String)>>(files: I) -> Self {
        Self(files.into_iter().collect())
    }
}

/// A name as a cell (RFC 4180) in one line.
fn quoted(name: &str) -> String {
    let line = name.replace(char::is_control, "\u{fffd}");
    match line.contains([',', '"']) {
        true => format!("\"{}\"", line.replace('"', "\"\"")),
        false => line,
    }
}

/// The name in a cell.
fn unquoted(cell: &str) -> String {
    let inner = cell.strip_prefix('"').and_then(|rest| rest.strip_suffix('"'));
    inner.map_or_else(|| cell.to_owned(), |inner| inner.replace("\"\"", "\""))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::{Scene, Selection};
    use crate::tables::frames;
    use crate::tests::example;
    use crate::{NAMES, load, save};
    use i2slam::Reconstruction;
    use i2slam_check::TemporaryFolder;
    use i2slam_storage::{Claim, OutputFolder};
    use std::fs;

    fn files(names: &[&str]) -> FrameFiles {
        names.iter().enumerate().map(|(i, name)| (2 * i, name.to_string())).collect()
    }

    #[test]
    fn names_survive_a_table() {
        for name in ["a.png", "day 1/b, c.jpg", "\"d\".png", "\"e\", f.png"] {
            assert_eq!(unquoted(&quoted(name)), name);
        }
        assert_eq!(quoted("a\nb"), "a\u{fffd}b");
    }

    #[test]
    fn files_are_found_again_beside_frames() {
        let scratch = TemporaryFolder::new("files");
        let claim = Claim { command: "i2slam run", names: NAMES, overwrite: true };
        let mut folder = OutputFolder::replace(&scratch.0, claim).expect("a folder");
        let written = |of: &Reconstruction| frames(&of.frames, &FrameFiles::default());
        let (before, files) = (example(3), files(&["a, \"b\".png", "", "c.png"]));
        assert!(save(&folder, &before, &files).is_empty());
        folder.commit().expect("room");
        assert_eq!(written(&load(&scratch.0).expect("a result")), written(&before));
        let found = FrameFiles::load(&scratch.0).expect("a table");
        assert_eq!(
            [0, 2, 4].map(|index| found.get(index)),
            [Some("a, \"b\".png"), None, Some("c.png")]
        );
        // As earlier versions wrote it.
        let table = scratch.join("frames.csv");
        let text = fs::read_to_string(&table).expect("a table");
        let columns = |line: &str| line.splitn(29, ',').take(28).collect::<Vec<_>>().join(",");
        let lines: Vec<String> = text.lines().map(columns).collect();
        fs::write(&table, lines.join("\n")).expect("room");
        assert_eq!(written(&load(&scratch.0).expect("a result")), written(&before));
        assert_eq!(FrameFiles::load(&scratch.0).expect("a table"), FrameFiles::default());
    }

    #[test]
    fn exports_of_photographs_are_named_after_them() {
        let name = |is_unordered| {
            let scene = Scene::new(example(2), &Selection::default()).expect("a scene");
            let scene = scene.with_files(files(&["x/IMG_2.jpg", "IMG_1.jpg"]), is_unordered);
            scene.picture_name(&scene.frames[0])
        };
        assert_eq!((name(true).as_str(), name(false).as_str()), ("IMG_2.png", "000000.png"));
    }

    #[test]
    fn pictures_are_named_after_files_where_that_is_safe() {
        let frames = example(2).frames;
        let named = |a, b| files(&[a, b]).stems(&frames).map(|s| s.into_values().collect());
        assert_eq!(
            named("x/IMG_2.jpg", "IMG_1.v2.png"),
            Some(vec!["IMG_2".into(), "IMG_1.v2".into()])
        );
        for second in ["y/img_2.png", "IMG 1.png", "-1.png", "Größe.png", "a,b.png"] {
            assert_eq!(named("x/IMG_2.jpg", second), None::<Vec<String>>, "{second}");
        }
        assert_eq!(files(&["a.png"]).stems(&frames), None);
    }

    #[test]
    fn frames_are_called_by_number_and_file() {
        let files = files(&["x/IMG_2.jpg"]);
        assert_eq!((files.name(0).as_str(), files.name(1).as_str()), ("0, x/IMG_2.jpg", "1"));
    }

    #[test]
    fn frames_without_a_pose_are_named() {
        let mut frames = example(3).frames;
        frames[1].tracked = false;
        assert_eq!(
            files(&["a.png", "b.png", "c.png"]).without_pose(&frames[..2]),
            ["b.png", "c.png"]
        );
    }
}

//! What a program may take away again: its own files, by name, where a mark says that it wrote
//! them.

use crate::{ExportError, RenderKind};
use std::fs;
use std::path::{Path, PathBuf};

/// The names that a command writes into a folder, and how the folder is known as its work.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Files, with `/` between folders.
    pub files: Vec<&'static str>,
    /// Folders of pictures `NNNNNN.extension`, and that extension.
    pub pictures: Vec<(String, &'static str)>,
    /// A file, and a text that it holds: one of these tells that the command wrote here.
    pub marks: Vec<(&'static str, &'static str)>,
}

/// Files of a result folder, as `docs/result-folder.md` lists them.
const FILES: [&str; 15] = [
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
    "views/poses.txt",
];

/// Files by which a result is known; a dataset has none of them.
const MARKS: [&str; 5] =
    ["trajectory_shutter.txt", "frames.csv", "state.json", "map.i2slam", "report.html"];

/// Folders of a result that hold pictures by kind: of the run, at optimised poses, at poses of
/// the user's.
const PICTURES: [&str; 3] = ["renders/optimised", "renders", "views"];

/// Those folders with the extension of their pictures.
fn result_pictures() -> Vec<(String, &'static str)> {
    PICTURES.into_iter().flat_map(Layout::renders).collect()
}

/// What a folder holds of the names that a command writes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FolderContents {
    /// Nothing but hidden files, or there is no such folder.
    Empty,
    /// Files, this one first, and none of these names.
    Other(PathBuf),
    /// Work of the command.
    Own,
    /// This file has one of the names, and nothing says that the command wrote it: it may be the
    /// user's own.
    Foreign(PathBuf),
}

impl Layout {
    /// The result of a run, with what its evaluation and `i2slam render` add.
    pub fn of_result() -> Self {
        Self {
            files: FILES.to_vec(),
            pictures: result_pictures(),
            marks: MARKS.map(|name| (name, "")).to_vec(),
        }
    }

    /// Folders of pictures by kind, below `below`, which may be empty.
    pub fn renders(below: &str) -> Vec<(String, &'static str)> {
        let folder = |kind: RenderKind| match below {
            "" => kind.name().to_owned(),
            below => format!("{below}/{}", kind.name()),
        };
        RenderKind::ALL.map(|kind| (folder(kind), kind.extension())).to_vec()
    }

    /// Looks into a folder, which need not exist.
    pub fn contents(&self, folder: &Path) -> FolderContents {
        let says = |(name, text): &(&str, &str)| {
            let file = folder.join(name);
            file.is_file()
                && (text.is_empty() || fs::read_to_string(file).is_ok_and(|t| t.contains(text)))
        };
        if self.marks.iter().any(says) {
            return FolderContents::Own;
        }
        if let Some(file) = self.there(folder).into_iter().next() {
            return FolderContents::Foreign(file);
        }
        first_entry(folder).map_or(FolderContents::Empty, FolderContents::Other)
    }

    /// Delete the files and pictures of these names, folders that this leaves empty, and nothing
    /// else. The marks go last, so that what was not finished can be repeated.
    pub fn remove(&self, folder: &Path) -> Result<(), ExportError> {
        let is_mark =
            |path: &PathBuf| self.marks.iter().any(|(mark, _)| *path == folder.join(mark));
        let (marks, others): (Vec<_>, Vec<_>) = self.there(folder).into_iter().partition(is_mark);
        for path in others.into_iter().chain(marks) {
            fs::remove_file(&path).map_err(|source| ExportError::Write { path, source })?;
        }
        let holders = self.files.iter().filter_map(|file| Path::new(file).parent());
        let mut below: Vec<&Path> = holders.collect();
        for (pictures, _) in &self.pictures {
            below.extend(Path::new(pictures).ancestors());
        }
        below.retain(|path| !path.as_os_str().is_empty());
        below.sort_by_key(|path| std::cmp::Reverse(path.components().count()));
        // A folder that holds something else stays.
        below.iter().for_each(|path| drop(fs::remove_dir(folder.join(path))));
        Ok(())
    }

    /// A number after those of all its pictures in a folder.
    pub fn next_number(&self, folder: &Path) -> usize {
        let number = |path: PathBuf| path.file_stem()?.to_str()?.parse::<usize>().ok();
        let pictures = self.pictures.iter();
        let pictures = pictures.flat_map(|(name, kind)| numbered(&folder.join(name), kind));
        pictures.filter_map(number).max().map_or(0, |last| last + 1)
    }

    /// What lies there under these names.
    fn there(&self, folder: &Path) -> Vec<PathBuf> {
        let files = self.files.iter().map(|name| folder.join(name));
        let files = files.filter(|path| path.symlink_metadata().is_ok_and(|data| !data.is_dir()));
        let pictures = self.pictures.iter();
        files.chain(pictures.flat_map(|(name, kind)| numbered(&folder.join(name), kind))).collect()
    }
}

/// The files `NNNNNN.extension` of a folder, by name.
fn numbered(folder: &Path, extension: &str) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let ours = |path: &PathBuf| {
        let stem = path.file_stem().and_then(|s| s.to_str()).and_then(|s| s.parse::<usize>().ok());
        stem.is_some_and(|index| path.ends_with(format!("{index:06}.{extension}")))
    };
    let mut files: Vec<PathBuf> =
        entries.flatten().map(|entry| entry.path()).filter(ours).collect();
    files.sort();
    files
}

/// The first entry of a folder by name, hidden ones left out.
fn first_entry(folder: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(folder).ok()?.flatten();
    let seen = entries.filter(|entry| !entry.file_name().to_string_lossy().starts_with('.'));
    seen.map(|entry| entry.path()).min()
}

/// Delete the pictures that an earlier run left under `renders/` and `views/` of a result folder,
/// and nothing else, so that pictures of two runs do not mix.
pub fn remove_renders(result: &Path) -> Result<(), ExportError> {
    let files = vec!["views/poses.txt"];
    let layout = Layout { files, pictures: result_pictures(), marks: Vec::new() };
    layout.remove(result)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ResultFolder, save_render};
    use i2slam::geometry::Image;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn only_files_of_a_result_are_removed() {
        let scratch = TemporaryFolder::new("remove");
        let (folder, layout) =
            (ResultFolder::create(&scratch.0).expect("a folder"), Layout::of_result());
        assert_eq!(layout.contents(&scratch.0), FolderContents::Empty);
        for name in FILES.into_iter().chain(["notes.txt", "rgb.txt"]) {
            folder.write_text(name, "x").expect("room");
        }
        assert_eq!(layout.contents(&scratch.0), FolderContents::Own);
        layout.remove(&scratch.0).expect("removal");
        let left = FolderContents::Other(scratch.0.join("notes.txt"));
        assert_eq!(layout.contents(&scratch.0), left);
        assert_eq!(fs::read_dir(&scratch.0).map(Iterator::count).ok(), Some(2));
    }

    #[test]
    fn a_result_is_known_by_its_marks() {
        let others = FILES.into_iter().chain(["renders/sharp/000012.png"]);
        for (case, name) in others.enumerate() {
            let scratch = TemporaryFolder::new(&format!("marks-{case}"));
            let folder = ResultFolder::create(&scratch.0).expect("a folder");
            folder.write_text(name, "x").expect("room");
            let expected = match MARKS.contains(&name) {
                true => FolderContents::Own,
                false => FolderContents::Foreign(scratch.0.join(name)),
            };
            assert_eq!(Layout::of_result().contents(&scratch.0), expected);
        }
    }

    #[test]
    fn a_mark_may_be_a_text() {
        let scratch = TemporaryFolder::new("mark-text");
        let folder = ResultFolder::create(&scratch.0).expect("a folder");
        let marks = vec![("README.md", "Made by me")];
        let layout = Layout { files: vec!["README.md"], pictures: Vec::new(), marks };
        folder.write_text("README.md", "# Mine").expect("room");
        let foreign = FolderContents::Foreign(scratch.0.join("README.md"));
        assert_eq!(layout.contents(&scratch.0), foreign);
        folder.write_text("README.md", "Made by me.").expect("room");
        assert_eq!(layout.contents(&scratch.0), FolderContents::Own);
    }

    #[test]
    fn only_pictures_of_a_run_are_removed() {
        let scratch = TemporaryFolder::new("renders");
        let folder = ResultFolder::create(&scratch.0).expect("a folder");
        let image = Image::new(8, 6, 3);
        for kind in RenderKind::ALL {
            save_render(&folder, "renders", kind, 12, &image).expect("room");
        }
        for below in ["renders/optimised", "views"] {
            save_render(&folder, below, RenderKind::Sharp, 3, &image).expect("room");
        }
        folder.write_text("renders/sharp/notes.txt", "mine").expect("room");
        folder.write_text("renders/sharp/7.png", "mine").expect("room");
        assert!(scratch.0.join("renders/hdr/000012.exr").exists());
        remove_renders(&scratch.0).expect("removal");
        assert!(!scratch.0.join("renders/hdr/000012.exr").exists());
        assert!(!scratch.0.join("renders/sharp/000012.png").exists());
        assert!(!scratch.0.join("renders/optimised").exists() && !scratch.0.join("views").exists());
        assert!(scratch.0.join("renders/sharp/notes.txt").exists());
        assert!(scratch.0.join("renders/sharp/7.png").exists());
    }
}

//! The files that each command writes: recognised by name and removed, so that a command replaces
//! its own work and never files of the user.

use crate::{RenderKind, ResultError};
use std::fs;
use std::path::{Path, PathBuf};

/// The files of a command in its output folder.
#[derive(Clone, Debug)]
pub struct FolderLayout {
    /// Files, with `/` between folders.
    pub files: Vec<&'static str>,
    /// Folders of pictures `NNNNNN.extension`, and that extension.
    pub pictures: Vec<(String, &'static str)>,
    /// Files and a text that they contain; any of them proves that the command wrote the folder.
    pub signatures: Vec<(&'static str, &'static str)>,
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

/// Files that no dataset has: any of them makes a folder a result.
const SIGNATURES: [&str; 5] =
    ["trajectory_shutter.txt", "frames.csv", "state.json", "map.i2slam", "report.html"];

/// Folders of a result with pictures by kind: at optimised poses, of the run, at given poses.
const PICTURES: [&str; 3] = ["renders/optimised", "renders", "views"];

/// All folders of pictures of a result, with the extension of their files.
fn result_pictures() -> Vec<(String, &'static str)> {
    PICTURES.into_iter().flat_map(FolderLayout::render_folders).collect()
}

/// Contents of a folder, seen by a command that is to write there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum FolderContents {
    /// No folder, or nothing but hidden files.
    Empty,
    /// Files of other names; this is the first.
    Other(PathBuf),
    /// Files of the command.
    Own,
    /// A file of one of the names without a signature: it may be the user's.
    Foreign(PathBuf),
}

impl FolderLayout {
    /// The files of `i2slam run`, with those that `i2slam eval` and `i2slam render` add.
    pub fn of_result() -> Self {
        Self {
            files: FILES.to_vec(),
            pictures: result_pictures(),
            signatures: SIGNATURES.map(|name| (name, "")).to_vec(),
        }
    }

    /// Folders of renders by kind, with the extension of their files; `parent` may be empty.
    pub fn render_folders(parent: &str) -> Vec<(String, &'static str)> {
        let folder = |kind: RenderKind| match parent {
            "" => kind.name().to_owned(),
            parent => format!("{parent}/{}", kind.name()),
        };
        RenderKind::ALL.map(|kind| (folder(kind), kind.extension())).to_vec()
    }

    /// Inspects a folder, which need not exist.
    pub fn contents(&self, folder: &Path) -> FolderContents {
        let has_signature = |(name, text): &(&str, &str)| {
            let file = folder.join(name);
            file.is_file()
                && (text.is_empty() || fs::read_to_string(file).is_ok_and(|t| t.contains(text)))
        };
        if self.signatures.iter().any(has_signature) {
            return FolderContents::Own;
        }
        if let Some(file) = self.existing_files(folder).into_iter().next() {
            return FolderContents::Foreign(file);
        }
        first_entry(folder).map_or(FolderContents::Empty, FolderContents::Other)
    }

    /// Deletes these files, and folders that become empty. Signatures go last, so that an
    /// interrupted removal can be repeated.
    pub fn remove(&self, folder: &Path) -> Result<(), ResultError> {
        let is_signature =
            |path: &PathBuf| self.signatures.iter().any(|(name, _)| *path == folder.join(name));
        let (signatures, others): (Vec<_>, Vec<_>) =
            self.existing_files(folder).into_iter().partition(is_signature);
        for path in others.into_iter().chain(signatures) {
            fs::remove_file(&path).map_err(|source| ResultError::Write { path, source })?;
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

    /// The number after the highest of the pictures in a folder.
    pub fn next_number(&self, folder: &Path) -> usize {
        let number = |path: PathBuf| path.file_stem()?.to_str()?.parse::<usize>().ok();
        let pictures = self.pictures.iter();
        let pictures = pictures.flat_map(|(name, kind)| numbered_files(&folder.join(name), kind));
        pictures.filter_map(number).max().map_or(0, |last| last + 1)
    }

    /// The files of these names that exist.
    fn existing_files(&self, folder: &Path) -> Vec<PathBuf> {
        let files = self.files.iter().map(|name| folder.join(name));
        let files = files.filter(|path| path.symlink_metadata().is_ok_and(|data| !data.is_dir()));
        let pictures = self.pictures.iter();
        files
            .chain(pictures.flat_map(|(name, kind)| numbered_files(&folder.join(name), kind)))
            .collect()
    }
}

/// The files `NNNNNN.extension` of a folder, sorted.
fn numbered_files(folder: &Path, extension: &str) -> Vec<PathBuf> {
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

/// The first entry of a folder by name, without hidden ones.
fn first_entry(folder: &Path) -> Option<PathBuf> {
    let entries = fs::read_dir(folder).ok()?.flatten();
    let seen = entries.filter(|entry| !entry.file_name().to_string_lossy().starts_with('.'));
    seen.map(|entry| entry.path()).min()
}

/// Deletes the pictures under `renders/` and `views/` of a result, so that those of two runs do not
/// mix.
pub fn remove_renders(result: &Path) -> Result<(), ResultError> {
    let files = vec!["views/poses.txt"];
    let layout = FolderLayout { files, pictures: result_pictures(), signatures: Vec::new() };
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
            (ResultFolder::create(&scratch.0).expect("a folder"), FolderLayout::of_result());
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
    fn a_result_is_known_by_its_signatures() {
        let others = FILES.into_iter().chain(["renders/sharp/000012.png"]);
        for (case, name) in others.enumerate() {
            let scratch = TemporaryFolder::new(&format!("signatures-{case}"));
            let folder = ResultFolder::create(&scratch.0).expect("a folder");
            folder.write_text(name, "x").expect("room");
            let expected = match SIGNATURES.contains(&name) {
                true => FolderContents::Own,
                false => FolderContents::Foreign(scratch.0.join(name)),
            };
            assert_eq!(FolderLayout::of_result().contents(&scratch.0), expected);
        }
    }

    #[test]
    fn a_signature_may_be_a_text() {
        let scratch = TemporaryFolder::new("signature-text");
        let folder = ResultFolder::create(&scratch.0).expect("a folder");
        let signatures = vec![("README.md", "Made by me")];
        let layout = FolderLayout { files: vec!["README.md"], pictures: Vec::new(), signatures };
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

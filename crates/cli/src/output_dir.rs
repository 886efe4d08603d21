//! Output folders: one rule for all commands.
//!
//! A folder that is not empty is refused. `--overwrite` removes what the same command wrote before,
//! and nothing else.

use crate::failure::Failure;
use i2slam_result::{FolderContents, FolderLayout};
use std::fs;
use std::path::{Path, PathBuf};

/// Output folder of a command.
pub(crate) struct OutputDir<'a> {
    pub(crate) path: &'a Path,
    /// Files that the command writes.
    pub(crate) layout: FolderLayout,
    /// Name of the command, for messages.
    pub(crate) command: &'static str,
    /// Whether an earlier result may be replaced.
    pub(crate) overwrite: bool,
}

impl OutputDir<'_> {
    /// Checks that the command may write there, without changing anything.
    pub(crate) fn check(&self) -> Result<(), Failure> {
        refuse_file(self.path)?;
        let (out, command) = (self.path.display(), self.command);
        let contents = self.layout.contents(self.path);
        match (contents, self.overwrite) {
            (FolderContents::Foreign(file), _) => Err(Failure::Usage(format!(
                "{} would be overwritten, and nothing in --out {out} says that `{command}` wrote \
                 it: choose another folder",
                file.display()
            ))),
            (FolderContents::Own, false) => Err(Failure::Usage(format!(
                "--out {out} is not empty, it holds what `{command}` wrote before: choose another \
                 folder, or replace that with --overwrite"
            ))),
            (FolderContents::Other(file), false) => Err(Failure::Usage(format!(
                "--out {out} is not empty, it holds {}: choose another folder, or write beside it \
                 with --overwrite",
                file.file_name().unwrap_or_default().display()
            ))),
            _ => Ok(()),
        }
    }

    /// Checks that the command may write there, and removes an earlier result if that is allowed.
    pub(crate) fn clear(&self) -> Result<(), Failure> {
        self.check()?;
        if self.overwrite && self.layout.contents(self.path) == FolderContents::Own {
            self.layout.remove(self.path)?;
        }
        Ok(())
    }
}

/// Folders created for a path, deepest first.
pub(crate) struct CreatedDirs(Vec<PathBuf>);

impl CreatedDirs {
    /// Folders missing for a path, before they are created.
    pub(crate) fn for_path(path: &Path) -> Self {
        let missing = path.ancestors().take_while(|above| !above.as_os_str().is_empty());
        Self(missing.take_while(|above| !above.exists()).map(Path::to_owned).collect())
    }

    /// Removes the empty ones.
    pub(crate) fn remove_empty(&self) {
        self.0.iter().for_each(|made| drop(fs::remove_dir(made)));
    }
}

/// Refuses a path that is a file.
pub(crate) fn refuse_file(out: &Path) -> Result<(), Failure> {
    let out_is = out.display();
    match out.is_dir() || out.symlink_metadata().is_err() {
        true => Ok(()),
        false => {
            let message =
                format!("--out {out_is} is a file: a folder is written, name another one");
            Err(Failure::Usage(message))
        }
    }
}

/// Files of `i2slam synth`.
pub(crate) fn synthetic_layout() -> FolderLayout {
    sequence_layout("spec.toml", ("spec.toml", "# Specification of a synthetic sequence"))
}

/// Files of `i2slam degrade`.
pub(crate) fn degraded_layout() -> FolderLayout {
    sequence_layout("source.csv", ("README.md", "Made by `i2slam degrade`"))
}

/// A sequence with ground truth and one more file; `signature` is the file whose first line names the
/// command.
fn sequence_layout(further: &'static str, signature: (&'static str, &'static str)) -> FolderLayout {
    let files = vec![
        "rgb.txt",
        "depth.txt",
        "groundtruth.txt",
        "groundtruth_shutter.txt",
        "exposure.csv",
        "camera.json",
        "README.md",
        further,
    ];
    let pictures = [("rgb", "png"), ("depth", "png"), ("sharp", "png"), ("hdr", "exr")]
        .map(|(folder, extension)| (folder.to_owned(), extension));
    FolderLayout { files, pictures: pictures.to_vec(), signatures: vec![signature] }
}

/// File with the poses of rendered pictures.
pub(crate) const POSES: &str = "poses.txt";

/// First line of that file.
pub(crate) const POSES_HEADER: &str =
    "# i2slam render: number of the picture, tx ty tz qx qy qz qw, world from camera";

/// Files of `i2slam render --out`.
pub(crate) fn render_layout() -> FolderLayout {
    let signatures = vec![(POSES, POSES_HEADER)];
    FolderLayout { files: vec![POSES], pictures: FolderLayout::render_folders(""), signatures }
}

//! Folders that commands write into: one rule for all of them.
//!
//! A folder that holds something is refused. `--overwrite` takes away what the same command wrote
//! there before, and leaves everything else; a file of the user's own is never replaced.

use crate::failure::Failure;
use i2slam_result::{FolderContents, Layout};
use std::fs;
use std::path::{Path, PathBuf};

/// Where a command writes.
pub(crate) struct OutputDir<'a> {
    pub(crate) path: &'a Path,
    /// What the command writes there.
    pub(crate) layout: Layout,
    /// As it is typed, for messages.
    pub(crate) command: &'static str,
    /// Whether its earlier work may be replaced.
    pub(crate) overwrite: bool,
}

impl OutputDir<'_> {
    /// Whether the command may write there; nothing is changed.
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

    /// Takes away what the command wrote there before, if that was allowed. Only after
    /// [`check`](Self::check).
    pub(crate) fn clear(&self) -> Result<(), Failure> {
        if self.overwrite && self.layout.contents(self.path) == FolderContents::Own {
            self.layout.remove(self.path)?;
        }
        Ok(())
    }
}

/// The folders that have to be made for a path, deepest first.
pub(crate) struct CreatedDirs(Vec<PathBuf>);

impl CreatedDirs {
    /// Before they are made.
    pub(crate) fn for_path(path: &Path) -> Self {
        let missing = path.ancestors().take_while(|above| !above.as_os_str().is_empty());
        Self(missing.take_while(|above| !above.exists()).map(Path::to_owned).collect())
    }

    /// Takes away those that nothing came into.
    pub(crate) fn remove_empty(&self) {
        self.0.iter().for_each(|made| drop(fs::remove_dir(made)));
    }
}

/// A folder cannot be made where a file is.
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

/// What `i2slam synth` writes.
pub(crate) fn synthetic_layout() -> Layout {
    sequence_layout("spec.toml", ("spec.toml", "# Specification of a synthetic sequence"))
}

/// What `i2slam degrade` writes.
pub(crate) fn degraded_layout() -> Layout {
    sequence_layout("source.csv", ("README.md", "Made by `i2slam degrade`"))
}

/// A sequence with truth, a `further` file, and the file whose beginning tells who wrote it.
fn sequence_layout(further: &'static str, mark: (&'static str, &'static str)) -> Layout {
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
    Layout { files, pictures: sequence_pictures(), marks: vec![mark] }
}

fn sequence_pictures() -> Vec<(String, &'static str)> {
    [("rgb", "png"), ("depth", "png"), ("sharp", "png"), ("hdr", "exr")]
        .map(|(folder, extension)| (folder.to_owned(), extension))
        .to_vec()
}

/// The poses that pictures were drawn from, beside them.
pub(crate) const POSES: &str = "poses.txt";

/// First line of that file.
pub(crate) const POSES_HEADER: &str =
    "# i2slam render: number of the picture, tx ty tz qx qy qz qw, world from camera";

/// What `i2slam render --out` writes.
pub(crate) fn render_layout() -> Layout {
    let marks = vec![(POSES, POSES_HEADER)];
    Layout { files: vec![POSES], pictures: Layout::renders(""), marks }
}

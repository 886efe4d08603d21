//! The folder of a sequence, in the TUM layout.

use crate::error::SyntheticError;
use i2slam_geometry::Pose;
use std::io;
use std::path::{Path, PathBuf};

/// A folder that files are written to.
pub(crate) struct Folder {
    root: PathBuf,
}

impl Folder {
    /// Creates the folder if need be.
    pub(crate) fn create(root: &Path) -> Result<Self, SyntheticError> {
        std::fs::create_dir_all(root).map_err(|e| SyntheticError::write(root, e))?;
        Ok(Self { root: root.to_owned() })
    }

    /// Writes a file, creating the folder it lies in.
    pub(crate) fn write(
        &self,
        relative: &str,
        bytes: io::Result<Vec<u8>>,
    ) -> Result<(), SyntheticError> {
        let path = self.root.join(relative);
        let failed = |e| SyntheticError::write(&path, e);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(failed)?;
        }
        std::fs::write(&path, bytes.map_err(failed)?).map_err(failed)
    }

    /// Writes a text file.
    pub(crate) fn write_text(&self, relative: &str, text: String) -> Result<(), SyntheticError> {
        self.write(relative, Ok(text.into_bytes()))
    }

    /// Writes `rgb.txt` or `depth.txt`, a line for every stamp [s]; frames are numbered.
    pub(crate) fn write_list(
        &self,
        kind: &str,
        about: &str,
        stamps: &[f64],
    ) -> Result<(), SyntheticError> {
        let mut text = format!("# {about}\n# timestamp filename\n");
        for (i, stamp) in stamps.iter().enumerate() {
            text.push_str(&format!("{stamp:.6} {kind}/{i:06}.png\n"));
        }
        self.write_text(&format!("{kind}.txt"), text)
    }
}

/// `tx ty tz qx qy qz qw`.
pub(crate) fn pose_numbers(pose: &Pose<f64>) -> String {
    let (t, q) = (pose.translation, pose.rotation);
    format!("{:.7} {:.7} {:.7} {:.9} {:.9} {:.9} {:.9}", t.x, t.y, t.z, q.v.x, q.v.y, q.v.z, q.w)
}

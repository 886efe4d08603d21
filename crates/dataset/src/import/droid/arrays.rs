//! Arrays by their names, in a folder or in an archive.

use crate::DatasetError;
use crate::import::archive::Archive;
use crate::import::npy::Array;
use std::path::{Path, PathBuf};

/// Arrays by their names.
pub(super) enum Arrays {
    Folder(PathBuf),
    Archive(PathBuf, Archive),
}

impl Arrays {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        if path.is_dir() {
            return Ok(Self::Folder(path.to_path_buf()));
        }
        Ok(Self::Archive(path.to_path_buf(), Archive::open(path)?))
    }

    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Folder(path) | Self::Archive(path, _) => path,
        }
    }

    /// The first array of some names that is there.
    pub(super) fn find(&self, names: &[&str]) -> Result<Option<Array>, DatasetError> {
        let array = |name: &&str| match self {
            Self::Folder(folder) => {
                let file = folder.join(format!("{name}.npy"));
                file.is_file().then(|| Array::open(&file))
            }
            Self::Archive(_, archive) => archive.array(name),
        };
        names.iter().find_map(array).transpose()
    }

    /// The same, if it has `frames` places of the given size each.
    pub(super) fn find_shaped(
        &self,
        names: &[&str],
        frames: usize,
        expected: &str,
        fits: impl Fn(&[usize]) -> bool,
    ) -> Result<Option<Array>, DatasetError> {
        let Some(array) = self.find(names)? else { return Ok(None) };
        if array.shape.first() == Some(&frames) && fits(&array.shape[1..]) {
            return Ok(Some(array));
        }
        let reason = format!("shape {:?}, expected [{frames}, {expected}]", array.shape);
        Err(DatasetError::metadata(&array.path, reason))
    }

    pub(super) fn missing(&self, names: &[&str]) -> DatasetError {
        let found = match self {
            Self::Folder(folder) => crate::layouts::contents(folder),
            Self::Archive(_, archive) => archive.names().join(", "),
        };
        let reason = format!("no array {}; found {found}", names.join(" or "));
        DatasetError::metadata(self.path(), reason)
    }
}

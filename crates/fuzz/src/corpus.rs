//! Seeds: files from which cases are made.

use i2slam_check::TemporaryFolder;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// Beginning of the names of seeds that once failed: a reader may refuse them.
pub(crate) const REGRESSION: &str = "regression";

/// Contents by path relative to the folder of the case, with `/` between folders.
pub(crate) type Files = BTreeMap<String, Vec<u8>>;

/// A folder of the corpus.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Seed {
    pub(crate) name: String,
    pub(crate) files: Files,
}

impl Seed {
    /// Whether its reader must accept it.
    pub(crate) fn is_valid(&self) -> bool {
        !self.name.starts_with(REGRESSION)
    }
}

/// Reads the seeds of a reader, in order of their names.
pub(crate) fn read(corpus: &Path, reader: &str) -> Result<Vec<Seed>, String> {
    let folder = corpus.join(reader);
    let mut seeds = Vec::new();
    for name in names(&folder)? {
        let mut files = Files::new();
        read_tree(&folder.join(&name), "", &mut files)?;
        seeds.push(Seed { name, files });
    }
    if seeds.is_empty() {
        return Err(format!("{}: no seed", folder.display()));
    }
    Ok(seeds)
}

/// Names in a folder, sorted.
pub(crate) fn names(folder: &Path) -> Result<Vec<String>, String> {
    let failed = |e: std::io::Error| format!("cannot read {}: {e}", folder.display());
    let entries: Result<Vec<_>, _> = fs::read_dir(folder).map_err(failed)?.collect();
    let entries = entries.map_err(failed)?;
    let mut names: Vec<String> =
        entries.iter().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    Ok(names)
}

fn read_tree(folder: &Path, prefix: &str, files: &mut Files) -> Result<(), String> {
    for name in names(folder)? {
        let (path, relative) = (folder.join(&name), format!("{prefix}{name}"));
        if path.is_dir() {
            read_tree(&path, &format!("{relative}/"), files)?;
        } else {
            let bytes = fs::read(&path);
            let bytes = bytes.map_err(|e| format!("cannot read {}: {e}", path.display()))?;
            files.insert(relative, bytes);
        }
    }
    Ok(())
}

/// Writes files below a folder.
pub(crate) fn write(folder: &Path, files: &Files) -> std::io::Result<()> {
    for (name, bytes) in files {
        let path = folder.join(name);
        if let Some(parent) = path.parent() {
            fs::create_dir_all(parent)?;
        }
        fs::write(path, bytes)?;
    }
    Ok(())
}

/// The files that `make` writes into an empty folder.
pub(crate) fn made_by(
    name: &str,
    make: impl FnOnce(&Path) -> Result<(), String>,
) -> Result<Files, String> {
    let scratch = TemporaryFolder::new(name);
    make(&scratch.0)?;
    let mut files = Files::new();
    read_tree(&scratch.0, "", &mut files)?;
    Ok(files)
}

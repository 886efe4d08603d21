//! The seeds of the corpus, made anew: small files of every format, of our own making. Regressions
//! are not made here: they are files that once failed, kept as they were.

mod arrays;
mod colmap;
mod imports;
pub(crate) mod picture;
mod record3d;
mod results;
mod scene;
mod sens;
mod sequences;
mod texts;

use crate::corpus::{self, Files};
use std::fs;
use std::path::Path;

/// Reader, name and files.
type NamedSeed = (&'static str, &'static str, Files);

/// Writes all seeds below a folder; seeds of these names that are there are replaced.
pub(crate) fn write(folder: &Path) -> Result<(), String> {
    let mut seeds = sequences::seeds();
    seeds.extend(imports::seeds());
    seeds.extend(texts::seeds());
    seeds.extend(results::seeds()?);
    for (reader, name, files) in &seeds {
        let place = folder.join(reader).join(name);
        let failed = |e| format!("cannot write {}: {e}", place.display());
        if place.exists() {
            fs::remove_dir_all(&place).map_err(failed)?;
        }
        corpus::write(&place, files).map_err(failed)?;
    }
    Ok(())
}

/// Files from names and contents.
fn files<const N: usize>(all: [(&str, &[u8]); N]) -> Files {
    all.into_iter().map(|(name, bytes)| (name.to_owned(), bytes.to_vec())).collect()
}

/// Files whose names begin with another folder.
fn below(folder: &str, all: &Files) -> Files {
    all.iter().map(|(name, bytes)| (format!("{folder}/{name}"), bytes.clone())).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::readers::READERS;

    /// Total size of the corpus at most [bytes].
    const MAX_CORPUS: u64 = 600_000;

    #[test]
    fn the_corpus_has_seeds_for_every_reader_and_is_small() {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/corpus"));
        let known = READERS.map(|reader| reader.name);
        let mut size = 0;
        for name in corpus::names(folder).expect("a corpus") {
            assert!(known.contains(&name.as_str()), "{name} is no reader");
        }
        for reader in known {
            let seeds = corpus::read(folder, reader).expect(reader);
            assert!(seeds.iter().any(corpus::Seed::is_valid), "{reader}");
            let files = seeds.iter().flat_map(|seed| seed.files.values());
            size += files.map(|bytes| bytes.len() as u64).sum::<u64>();
        }
        assert!(size < MAX_CORPUS, "{size} bytes");
    }
}

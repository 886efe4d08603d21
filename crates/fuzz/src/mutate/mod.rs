//! Random changes of seeds.

mod bytes;
mod text;
mod tree;

use crate::case::{Case, CaseId};
use crate::container::Container;
use crate::corpus::{Files, Seed};
use i2slam_compute::Random;

/// Share of cases in which a file is missing, a folder, a link, or another file's content.
const TREE_SHARE: f64 = 0.12;
/// Share of changes of files with checksums that leave the checksums wrong.
const RAW_SHARE: f64 = 0.25;
/// Share of changes of texts that treat them as bytes.
const TEXT_AS_BYTES_SHARE: f64 = 0.15;

/// The case of an identity.
pub(crate) fn case(seeds: &[Seed], reader: &str, seed: u64, id: CaseId) -> Case {
    match id {
        CaseId::Seed(index) => Case::from(&seeds[index].files),
        CaseId::Number(number) => {
            let name = u64::from(crc32fast::hash(reader.as_bytes()));
            // Drawn twice: neighbouring seeds and numbers have nothing in common.
            let mut random = Random::new(Random::new(seed ^ (name << 32)).bits() ^ number);
            mutated(seeds, &mut Random::new(random.bits()))
        }
    }
}

/// One of the seeds with one or a few changes.
fn mutated(seeds: &[Seed], random: &mut Random) -> Case {
    let seed = &seeds[random.below(seeds.len())];
    let mut case = Case { files: seed.files.clone(), oddities: Vec::new() };
    if random.uniform() < TREE_SHARE {
        tree::change(&mut case, random);
    }
    // Most cases hold one change: a second would often only be refused earlier.
    while random.uniform() < if case == Case::from(&seed.files) { 1.0 } else { 0.3 } {
        let Some(name) = chosen_file(&case.files, random) else { break };
        let other = &seeds[random.below(seeds.len())];
        let donor = donor(&other.files, &name);
        let bytes = case.files.entry(name).or_default();
        *bytes = changed(bytes, donor, random);
    }
    case
}

impl From<&Files> for Case {
    fn from(files: &Files) -> Self {
        Self { files: files.clone(), oddities: Vec::new() }
    }
}

/// A file; those of one extension together are as likely as those of another, because a folder
/// holds many pictures and few lists.
fn chosen_file(files: &Files, random: &mut Random) -> Option<String> {
    let mut extensions: Vec<&str> = files.keys().map(|name| extension(name)).collect();
    extensions.sort_unstable();
    extensions.dedup();
    let kind = *extensions.get(random.below(extensions.len().max(1)))?;
    let names: Vec<&String> = files.keys().filter(|name| extension(name) == kind).collect();
    names.get(random.below(names.len().max(1))).map(|name| (*name).clone())
}

fn extension(name: &str) -> &str {
    name.rsplit_once('.').map_or("", |(_, extension)| extension)
}

/// A file of another seed to take pieces from: of the same name, else of the same extension.
fn donor<'a>(files: &'a Files, name: &str) -> &'a [u8] {
    let alike = || files.iter().find(|(other, _)| extension(other) == extension(name));
    files.get(name).or_else(|| alike().map(|(_, bytes)| bytes)).map_or(&[], |bytes| bytes)
}

/// A content with one change, behind its checksums if it has any.
fn changed(content: &[u8], donor: &[u8], random: &mut Random) -> Vec<u8> {
    if random.uniform() >= RAW_SHARE {
        let inflate = random.uniform() < 0.5;
        if let Some(mut container) = Container::split(content, inflate) {
            let parts = &mut container.parts;
            let part = random.below(parts.len());
            parts[part] = changed_part(&parts[part], donor, random);
            return container.join();
        }
    }
    changed_part(content, donor, random)
}

fn changed_part(content: &[u8], donor: &[u8], random: &mut Random) -> Vec<u8> {
    match std::str::from_utf8(content) {
        Ok(words) if !words.is_empty() && random.uniform() >= TEXT_AS_BYTES_SHARE => {
            text::change(words, &String::from_utf8_lossy(donor), random)
        }
        _ => bytes::change(content, donor, random),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seeds() -> Vec<Seed> {
        let seed = |name: &str, content: &str| {
            let files = [
                ("list.txt".to_owned(), content.as_bytes().to_vec()),
                ("rgb/1.png".to_owned(), crate::seeds::picture::colour((16, 12), 9)),
            ];
            Seed { name: name.to_owned(), files: files.into_iter().collect() }
        };
        vec![seed("a", "1 2 3\n4 5 6\n"), seed("b", "# nothing\n7 8 9\n")]
    }

    #[test]
    fn a_case_depends_on_seed_reader_and_number_alone() {
        use crate::case::CaseId::Number;
        let made = |reader, seed, number| case(&seeds(), reader, seed, Number(number));
        for number in 0..200 {
            assert_eq!(made("a", 7, number), made("a", 7, number));
        }
        let differ =
            |f: &dyn Fn(u64) -> (Case, Case)| (0..50).map(f).filter(|(a, b)| a != b).count() > 40;
        assert!(differ(&|n| (made("a", 7, n), made("a", 8, n))), "seeds");
        assert!(differ(&|n| (made("a", 7, n), made("b", 7, n))), "readers");
        assert!(differ(&|n| (made("a", 7, n), made("a", 7, n + 1))), "numbers");
    }

    #[test]
    fn every_case_is_changed_and_every_file_is_reached() {
        let mut random = Random::new(3);
        let originals = seeds();
        let mut reached = [0; 3];
        for _ in 0..600 {
            let case = mutated(&originals, &mut random);
            let same = originals.iter().any(|seed| case == Case::from(&seed.files));
            assert!(!same, "unchanged");
            let origin =
                |name: &str| originals.iter().any(|s| s.files.get(name) == case.files.get(name));
            reached[0] += usize::from(!origin("list.txt"));
            reached[1] += usize::from(!origin("rgb/1.png"));
            reached[2] += usize::from(!case.oddities.is_empty());
        }
        assert!(reached[0] > 150 && reached[1] > 150 && reached[2] > 20, "{reached:?}");
    }
}

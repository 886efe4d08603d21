//! Where a suite's sequences are.

use super::input::{input_flags, list, run_arguments};
use super::plan::{Sequence, Source, slug};
use super::suite::{Origin, SequenceEntry};
use crate::failure::Failure;
use i2slam_synthetic::Spec;
use std::path::{Path, PathBuf};

/// The columns of the tables; what is left out is said in `notes`.
pub(super) fn sequences(
    origin: &Origin,
    data: Option<&Path>,
    notes: &mut Vec<String>,
) -> Result<Vec<Sequence>, Failure> {
    let place = |path: &Path| place(origin, data, path);
    let mut all = Vec::new();
    for entry in &origin.suite.sequences {
        let wrong = |reason: String| Failure::Usage(format!("{}: {reason}", origin.name));
        for (name, source) in sources(origin, data, entry, notes).map_err(wrong)? {
            all.push(sequence(name, source, entry, &place).map_err(wrong)?);
        }
    }
    Ok(all)
}

/// A path of the suite: inside the data folder, else beside the suite.
fn place(origin: &Origin, data: Option<&Path>, path: &Path) -> PathBuf {
    let beside = origin.folder.join(path);
    match data.map(|data| data.join(path)) {
        Some(inside) if inside.exists() || origin.is_shipped() || !beside.exists() => inside,
        _ => beside,
    }
}

/// Name and source of everything that an entry stands for.
fn sources(
    origin: &Origin,
    data: Option<&Path>,
    entry: &SequenceEntry,
    notes: &mut Vec<String>,
) -> Result<Vec<(String, Source)>, String> {
    if let Some(path) = &entry.path {
        let folder = place(origin, data, path);
        if entry.optional && !folder.is_dir() {
            notes.push(format!("{} is left out: it does not exist", folder.display()));
            return Ok(Vec::new());
        }
        let name = entry.name.clone().unwrap_or_else(|| last_name(path));
        return Ok(vec![(name, Source::Folder(folder))]);
    }
    if let Some(pattern) = &entry.find {
        let within = data.unwrap_or(&origin.folder);
        let named = origin.suite.sequences.iter().filter_map(|entry| entry.path.as_ref());
        let named: Vec<PathBuf> = named.map(|path| place(origin, data, path)).collect();
        let mut found = found(within, pattern);
        found.retain(|folder| !named.contains(folder));
        if found.is_empty() {
            notes.push(format!("no further `{pattern}` is in {}", shown(within)));
        }
        return Ok(found.into_iter().map(|f| (last_name(&f), Source::Folder(f))).collect());
    }
    let (Some(table), Some(name)) = (&entry.synth, &entry.name) else { return Ok(Vec::new()) };
    let text = toml::to_string(table).map_err(|e| e.to_string())?;
    Spec::from_toml(&text, &format!("sequence `{name}`")).map_err(|e| e.to_string())?;
    Ok(vec![(name.clone(), Source::Synth(text))])
}

fn sequence(
    name: String,
    source: Source,
    entry: &SequenceEntry,
    place: &impl Fn(&Path) -> PathBuf,
) -> Result<Sequence, String> {
    let list =
        entry.list.as_deref().map(|name| list(name, entry.list_offset, place)).transpose()?;
    let flags = input_flags(entry, place);
    run_arguments(&flags).map_err(|reason| format!("sequence `{name}`: {reason}"))?;
    Ok(Sequence { slug: slug(&name), name, group: entry.group.clone(), source, flags, list })
}

/// Folders directly in `within` whose names match, by name.
fn found(within: &Path, pattern: &str) -> Vec<PathBuf> {
    let listed = if within.as_os_str().is_empty() { Path::new(".") } else { within };
    let entries = std::fs::read_dir(listed).into_iter().flatten().flatten();
    let mut found: Vec<PathBuf> = entries
        .filter(|entry| matches(&entry.file_name().to_string_lossy(), pattern))
        .map(|entry| within.join(entry.file_name()))
        .filter(|path| path.is_dir())
        .collect();
    found.sort();
    found
}

/// Whether a name has a pattern's parts between its `*` in their order.
fn matches(name: &str, pattern: &str) -> bool {
    let Some((first, rest)) = pattern.split_once('*') else { return name == pattern };
    let Some(mut name) = name.strip_prefix(first) else { return false };
    let parts: Vec<&str> = rest.split('*').collect();
    let Some((last, middle)) = parts.split_last() else { return true };
    for part in middle {
        let Some(at) = name.find(part) else { return false };
        name = &name[at + part.len()..];
    }
    name.ends_with(last)
}

fn shown(path: &Path) -> String {
    if path.as_os_str().is_empty() {
        "the current folder".into()
    } else {
        path.display().to_string()
    }
}

fn last_name(path: &Path) -> String {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned());
    name.unwrap_or_else(|| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn patterns_match_as_in_a_shell() {
        assert!(matches("rgbd_dataset_freiburg1_desk", "rgbd_dataset_*"));
        assert!(matches("rgbd_dataset_freiburg1_desk", "*freiburg*desk"));
        assert!(matches("room", "room") && matches("room", "*") && matches("aba", "a*a"));
        assert!(!matches("room2", "room") && !matches("a", "a*a") && !matches("x", "y*"));
    }

    #[test]
    fn what_another_entry_names_is_not_found_again() {
        let data = std::env::temp_dir().join(format!("i2slam-find-{}", std::process::id()));
        for name in ["hand_b", "hand_a", "foot_a", "hand_c"] {
            std::fs::create_dir_all(data.join(name)).expect("a folder");
        }
        std::fs::write(data.join("hand_file"), b"").expect("room");
        let text = "title = \"t\"\n[[sequence]]\nname = \"first\"\npath = \"hand_b\"\n\
                    [[sequence]]\nfind = \"hand_*\"\n[[configuration]]\nname = \"c\"\n";
        let suite = super::super::suite::parse(text, "t").expect("a suite");
        let (name, text) = ("t".to_owned(), text.to_owned());
        let origin = Origin { suite, text, name, folder: PathBuf::new() };
        let mut notes = Vec::new();
        let all = sequences(&origin, Some(&data), &mut notes).expect("sequences");
        let names: Vec<&str> = all.iter().map(|sequence| sequence.name.as_str()).collect();
        assert_eq!(names, ["first", "hand_a", "hand_c"]);
        std::fs::remove_dir_all(&data).ok();
    }
}

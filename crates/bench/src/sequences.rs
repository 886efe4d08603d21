//! The sequences of a suite: where they are, and which frames are judged.

use crate::console::Failure;
use crate::suite::{SequenceEntry, SuiteFile, slug};
use i2slam_eval::frame_list;
use i2slam_synthetic::Spec;
use std::path::{Path, PathBuf};

/// A column of the tables.
pub(crate) struct Sequence {
    pub(crate) name: String,
    /// The name as part of a path.
    pub(crate) slug: String,
    pub(crate) group: String,
    pub(crate) source: Source,
    /// Options of `i2slam run` that read it.
    pub(crate) arguments: Vec<String>,
    pub(crate) list: Option<FrameList>,
}

/// Origin of the frames.
pub(crate) enum Source {
    Folder(PathBuf),
    /// The specification, as a file for `i2slam synth`.
    Synth(String),
}

/// Frames whose pictures are judged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum FrameList {
    /// Those that are sharp by their Laplacian.
    Auto,
    /// Positions in the associated stream.
    Frames(Vec<usize>),
}

/// Resolves the sequences of a suite; `notes` tells which were left out.
pub(crate) fn resolve(
    file: &SuiteFile,
    data: Option<&Path>,
    notes: &mut Vec<String>,
) -> Result<Vec<Sequence>, Failure> {
    let mut all = Vec::new();
    for entry in &file.suite.sequences {
        let wrong = |reason: String| Failure::Usage(format!("{}: {reason}", file.name));
        for (name, source) in sources(file, data, entry, notes).map_err(wrong)? {
            all.push(sequence(file, data, entry, (name, source)).map_err(wrong)?);
        }
    }
    Ok(all)
}

/// A path of the suite: inside the data folder, else beside the suite.
fn locate(file: &SuiteFile, data: Option<&Path>, path: &Path) -> PathBuf {
    let beside = file.folder.as_deref().map(|folder| folder.join(path));
    match (data.map(|data| data.join(path)), beside) {
        (Some(inside), Some(beside)) if !inside.exists() && beside.exists() => beside,
        (Some(inside), _) => inside,
        (None, beside) => beside.unwrap_or_else(|| path.to_owned()),
    }
}

/// Name and source of every sequence that an entry stands for.
fn sources(
    file: &SuiteFile,
    data: Option<&Path>,
    entry: &SequenceEntry,
    notes: &mut Vec<String>,
) -> Result<Vec<(String, Source)>, String> {
    if let Some(path) = &entry.path {
        let folder = locate(file, data, path);
        if entry.optional && !folder.is_dir() {
            notes.push(format!("{} is left out: it does not exist", folder.display()));
            return Ok(Vec::new());
        }
        let name = entry.name.clone().unwrap_or_else(|| last_name(path));
        return Ok(vec![(name, Source::Folder(folder))]);
    }
    if let Some(pattern) = &entry.find {
        let within = data.or(file.folder.as_deref()).unwrap_or(Path::new(""));
        let named = file.suite.sequences.iter().filter_map(|entry| entry.path.as_ref());
        let named: Vec<PathBuf> = named.map(|path| locate(file, data, path)).collect();
        let mut found = matching_folders(within, pattern);
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
    file: &SuiteFile,
    data: Option<&Path>,
    entry: &SequenceEntry,
    (name, source): (String, Source),
) -> Result<Sequence, String> {
    let locate = |path: &Path| locate(file, data, path);
    let list = entry.list.as_deref().map(|list| frame_list(list, entry.list_offset, &locate));
    Ok(Sequence {
        slug: slug(&name),
        name,
        group: entry.group.clone(),
        source,
        arguments: entry.arguments(&locate),
        list: list.transpose()?,
    })
}

/// A list by name or file, its numbers moved by `offset`.
fn frame_list(
    name: &str,
    offset: usize,
    locate: &impl Fn(&Path) -> PathBuf,
) -> Result<FrameList, String> {
    if name == "auto" {
        return Ok(FrameList::Auto);
    }
    let file = locate(Path::new(name));
    let text = match frame_list::published(name) {
        Some(text) if !file.is_file() => text.to_owned(),
        _ => std::fs::read_to_string(&file).map_err(|e| {
            format!("the list `{name}` is not published, and {}: {e}", file.display())
        })?,
    };
    let frames = frame_list::parse(&text);
    let frames = frames.map_err(|n| format!("list `{name}`, line {n} is no frame number"))?;
    Ok(FrameList::Frames(frames.into_iter().map(|frame| frame.saturating_add(offset)).collect()))
}

/// Folders directly in `within` whose names match, by name.
fn matching_folders(within: &Path, pattern: &str) -> Vec<PathBuf> {
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

/// Whether a name matches a pattern, in which `*` stands for any text.
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
    fn folders_of_other_entries_are_not_found_again() {
        let data = i2slam_check::TemporaryFolder::new("find");
        for name in ["hand_b", "hand_a", "foot_a", "hand_c"] {
            std::fs::create_dir_all(data.0.join(name)).expect("a folder");
        }
        std::fs::write(data.0.join("hand_file"), b"").expect("room");
        let text = "title = \"t\"\n[[sequence]]\nname = \"first\"\npath = \"hand_b\"\n\
                    [[sequence]]\nfind = \"hand_*\"\n[[configuration]]\nname = \"c\"\n";
        let file = SuiteFile {
            suite: crate::suite::parse(text, "t").expect("a suite"),
            text: text.to_owned(),
            name: "t".to_owned(),
            folder: None,
        };
        let all = resolve(&file, Some(&data.0), &mut Vec::new()).expect("sequences");
        let names: Vec<&str> = all.iter().map(|sequence| sequence.name.as_str()).collect();
        assert_eq!(names, ["first", "hand_a", "hand_c"]);
    }

    #[test]
    fn lists_are_moved_to_the_frames_of_the_stream() {
        let locate = |path: &Path| Path::new("/nowhere").join(path);
        let list = frame_list("scannet-0736-00", 1000, &locate);
        let Ok(FrameList::Frames(frames)) = list else { panic!("{list:?}") };
        assert_eq!(frames[..2], [1070, 1115]);
        assert_eq!(frame_list("auto", 0, &locate), Ok(FrameList::Auto));
        assert!(frame_list("tum-fr9", 0, &locate).unwrap_err().contains("tum-fr9"));
    }
}

//! The structure of the workspace: arrows between crates, and circles between files.
//!
//! Source files are read as text. `use` declarations and paths are resolved through re-exports to
//! the file that defines the name; tests are left out. A circle of files is allowed within one
//! folder only.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Every arrow between crates, dev-dependencies left out. A crate may depend on crates above it
/// only, so that no circle can arise. A new arrow is a decision: it is added here and explained in
/// ARCHITECTURE.md.
const ARROWS: &[(&str, &[&str])] = &[
    ("check", &[]),
    ("storage", &[]),
    ("geometry", &[]),
    ("compute", &["geometry"]),
    ("formation", &["geometry", "compute"]),
    ("radiance", &["geometry", "compute"]),
    ("dataset", &["storage", "geometry", "compute", "formation"]),
    ("odometry", &["storage", "geometry", "compute", "formation"]),
    ("eval", &["geometry"]),
    ("synthetic", &["storage", "geometry", "compute", "dataset"]),
    ("i2slam", &["storage", "geometry", "compute", "formation", "radiance", "dataset", "odometry"]),
    ("result", &["storage", "compute", "i2slam"]),
    ("cli", &["storage", "i2slam", "result", "eval", "synthetic"]),
    ("bench", &["storage", "i2slam", "result", "eval", "synthetic"]),
    ("rerun", &["i2slam", "result", "cli"]),
    ("fuzz", &["check", "storage", "compute", "i2slam", "result", "eval", "synthetic"]),
];

fn crates() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

#[test]
fn crates_depend_as_documented() {
    let mut errors = Vec::new();
    for (place, (name, allowed)) in ARROWS.iter().enumerate() {
        let manifest = fs::read_to_string(crates().join(name).join("Cargo.toml"));
        let found = dependencies(&manifest.expect("every crate has a manifest"));
        for dependency in found.iter().filter(|d| !allowed.contains(&d.as_str())) {
            errors.push(format!("{name} -> {dependency} is a new arrow"));
        }
        for dependency in allowed.iter().filter(|d| !found.contains(**d)) {
            errors.push(format!("{name} -> {dependency} is documented, but not there"));
        }
        let above = |d: &&&str| ARROWS[..place].iter().any(|(other, _)| *other == **d);
        errors.extend(allowed.iter().filter(|d| !above(d)).map(|d| format!("{name} is above {d}")));
    }
    let there = fs::read_dir(crates()).expect("the folder of crates").flatten();
    let there = there.filter(|entry| entry.path().join("Cargo.toml").is_file());
    for name in there.map(|entry| entry.file_name().to_string_lossy().into_owned()) {
        if !ARROWS.iter().any(|(known, _)| *known == name) {
            errors.push(format!("crate {name} is not in the table"));
        }
    }
    assert!(errors.is_empty(), "{}", errors.join("\n"));
}

/// Crates of the workspace in the section `[dependencies]`.
fn dependencies(manifest: &str) -> BTreeSet<String> {
    let section = manifest.split("[dependencies]").nth(1).unwrap_or("");
    let section = section.split("\n[").next().unwrap_or("");
    let names = section.lines().filter_map(|line| line.split(['.', ' ', '=']).next());
    let short = |name: &str| match name {
        "i2slam" => Some("i2slam".to_owned()),
        _ => name.strip_prefix("i2slam-").map(str::to_owned),
    };
    names.filter_map(short).collect()
}

#[test]
fn no_circle_of_files_crosses_a_folder() {
    let mut errors = Vec::new();
    for (name, _) in ARROWS {
        let sources = Sources::read(&crates().join(name).join("src"));
        for circle in sources.circles() {
            let folders: BTreeSet<&Path> =
                circle.iter().map(|&file| sources.folder(file)).collect();
            if folders.len() > 1 {
                errors.push(format!("{name}: {}", sources.describe(&circle)));
            }
        }
    }
    assert!(errors.is_empty(), "circles between files of several folders:\n{}", errors.join("\n"));
}

#[test]
fn a_circle_across_folders_is_found() {
    let files = [
        ("lib.rs", "mod a;\npub mod b;\npub use a::inner::One;\n"),
        ("a/mod.rs", "pub(crate) mod inner;\n"),
        ("a/inner.rs", "use crate::b::Two;\npub struct One;\n"),
        ("b.rs", "use crate::{One as Renamed};\npub struct Two;\n"),
    ];
    let sources = Sources::new(files.map(|(path, text)| (path.into(), text.to_owned())).into());
    let circles = sources.circles();
    assert_eq!(circles.len(), 1);
    assert_eq!(circles[0].len(), 2, "{}", sources.describe(&circles[0]));
    let without = ("b.rs".into(), "#[cfg(test)]\nmod tests {\nuse crate::One;\n}\n".to_owned());
    let mut files: Vec<_> =
        sources.files.iter().map(|f| (f.path.clone(), f.text.clone())).collect();
    files[3] = without;
    assert!(Sources::new(files).circles().is_empty(), "tests do not count");
}

/// Calls that wait for ever on a named pipe, or read an endless device, with the crates that may
/// make them: `storage` checks first, `compute` reads files of the system, `bench`, `check` and
/// `fuzz` what they wrote themselves.
const UNBOUNDED_READS: [&str; 3] = ["fs::read(", "fs::read_to_string(", "File::open("];
const READS_ITSELF: [&str; 5] = ["storage", "compute", "bench", "check", "fuzz"];

#[test]
fn files_of_users_are_read_through_the_crate_storage() {
    let mut errors = Vec::new();
    for (name, _) in ARROWS.iter().filter(|(name, _)| !READS_ITSELF.contains(name)) {
        for file in Sources::read(&crates().join(name).join("src")).files {
            for line in file.text.lines().filter(|line| reads_unbounded(line)) {
                errors.push(format!("{name}/src/{}: {}", file.path.display(), line.trim()));
            }
        }
    }
    let instead = "i2slam_storage::{open, read, read_range, read_text} refuse pipes and devices";
    assert!(errors.is_empty(), "{instead}:\n{}", errors.join("\n"));
}

/// Whether a line reads a file that is none of the system's own.
fn reads_unbounded(line: &str) -> bool {
    let begins = |at: usize| !line[..at].ends_with(is_identifier);
    let calls = |call: &str| line.match_indices(call).any(|(at, _)| begins(at));
    UNBOUNDED_READS.iter().any(|call| calls(call)) && !line.contains("\"/proc/")
}

#[test]
fn unbounded_reads_are_found() {
    assert!(reads_unbounded("    let text = std::fs::read_to_string(path)?;"));
    assert!(reads_unbounded("File::open(path).and_then(read)"));
    assert!(!reads_unbounded("i2slam_storage::read(path, limit)"));
    assert!(!reads_unbounded("std::fs::read_to_string(\"/proc/self/status\")"));
    assert!(!reads_unbounded("SensFile::open(path)"));
}

/// One source file without its tests.
struct File {
    path: PathBuf,
    text: String,
    /// Module path within the crate.
    module: Vec<String>,
}

/// The files of a crate, and what each module declares.
struct Sources {
    files: Vec<File>,
    by_module: BTreeMap<Vec<String>, usize>,
    defined: Vec<BTreeSet<String>>,
    /// Per file: name in scope, and the path that it stands for.
    imported: Vec<BTreeMap<String, Vec<String>>>,
}

impl Sources {
    fn read(root: &Path) -> Self {
        let mut files = Vec::new();
        let mut folders = vec![root.to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).expect("a folder of sources").flatten() {
                let path = entry.path();
                let name = entry.file_name();
                if path.is_dir() && name != "tests" {
                    folders.push(path);
                } else if path.extension().is_some_and(|e| e == "rs") && name != "tests.rs" {
                    let text = fs::read_to_string(&path).expect("a source file");
                    let relative = path.strip_prefix(root).expect("below the root").to_owned();
                    files.push((relative, text));
                }
            }
        }
        files.sort();
        Self::new(files)
    }

    fn new(files: Vec<(PathBuf, String)>) -> Self {
        let files: Vec<File> =
            files.into_iter().map(|(path, text)| File::new(path, &text)).collect();
        let by_module = files.iter().enumerate().map(|(i, f)| (f.module.clone(), i)).collect();
        let defined = files.iter().map(|file| definitions(&file.text)).collect();
        let imported = files.iter().map(|file| imports(&file.text)).collect();
        Self { files, by_module, defined, imported }
    }

    /// The folder that a file belongs to: `x.rs` beside a folder `x` belongs to that folder.
    fn folder(&self, file: usize) -> &Path {
        let path = &self.files[file].path;
        let own = path.with_extension("");
        let has_children =
            self.files.iter().find(|other| other.path.parent() == Some(own.as_path()));
        has_children.or(Some(&self.files[file])).and_then(|f| f.path.parent()).expect("a parent")
    }

    /// The file that defines what a path stands for, seen from a module.
    fn resolve(&self, from: &[String], path: &[String], depth: usize) -> Option<usize> {
        let mut module = from.to_vec();
        let mut rest = path;
        while let Some(first) = rest.first() {
            match first.as_str() {
                "crate" => module.clear(),
                "self" => {}
                "super" => drop(module.pop()),
                _ => break,
            }
            rest = &rest[1..];
        }
        let file = *self.by_module.get(&module)?;
        let Some(name) = rest.first() else { return Some(file) };
        let mut child = module.clone();
        child.push(name.clone());
        if self.by_module.contains_key(&child) {
            return self.resolve(&child, &[&["self".to_owned()], &rest[1..]].concat(), depth);
        }
        if self.defined[file].contains(name) {
            return Some(file);
        }
        let target = self.imported[file].get(name).filter(|_| depth < 8)?;
        self.resolve(&module, &[target.as_slice(), &rest[1..]].concat(), depth + 1)
    }

    /// Files that each file uses.
    fn arrows(&self) -> Vec<BTreeSet<usize>> {
        let arrows_of = |i: usize| {
            let file = &self.files[i];
            let reexported = reexports(&file.text);
            let used = self.imported[i].iter().filter(|(name, _)| !reexported.contains(*name));
            let paths = used.map(|(_, path)| path.clone()).chain(paths_in(&file.text));
            let targets = paths.filter_map(|path| self.resolve(&file.module, &path, 0));
            targets.filter(|&target| target != i).collect()
        };
        (0..self.files.len()).map(arrows_of).collect()
    }

    /// Groups of more than one file each of which reaches all others.
    fn circles(&self) -> Vec<Vec<usize>> {
        let arrows = self.arrows();
        let reached: Vec<BTreeSet<usize>> = (0..arrows.len()).map(|i| reach(&arrows, i)).collect();
        let mut circles = BTreeSet::new();
        for (i, from_here) in reached.iter().enumerate() {
            let circle: Vec<usize> =
                from_here.iter().copied().filter(|&j| reached[j].contains(&i)).collect();
            if circle.len() > 1 {
                circles.insert(circle);
            }
        }
        circles.into_iter().collect()
    }

    /// The arrows of a circle that cross folders.
    fn describe(&self, circle: &[usize]) -> String {
        let arrows = self.arrows();
        let mut lines = Vec::new();
        for &from in circle {
            let crossing = arrows[from].iter().filter(|to| circle.contains(to));
            for &to in crossing.filter(|&&to| self.folder(to) != self.folder(from)) {
                let (from, to) = (&self.files[from].path, &self.files[to].path);
                lines.push(format!("{} -> {}", from.display(), to.display()));
            }
        }
        lines.join("\n    ")
    }
}

impl File {
    fn new(path: PathBuf, text: &str) -> Self {
        let mut module: Vec<String> = path
            .with_extension("")
            .iter()
            .map(|part| part.to_string_lossy().into_owned())
            .collect();
        if matches!(module.last().map(String::as_str), Some("mod" | "lib" | "main")) {
            module.pop();
        }
        Self { path, text: without_tests_and_comments(text), module }
    }
}

/// Tests stand at the end of a file.
fn without_tests_and_comments(text: &str) -> String {
    let tests = text.find("#[cfg(test)]\nmod ").unwrap_or(text.len());
    let lines = text[..tests].lines().map(|line| line.split("//").next().unwrap_or(""));
    lines.collect::<Vec<_>>().join("\n")
}

fn reach(arrows: &[BTreeSet<usize>], from: usize) -> BTreeSet<usize> {
    let (mut reached, mut next) = (BTreeSet::new(), vec![from]);
    while let Some(i) = next.pop() {
        next.extend(arrows[i].iter().copied().filter(|&j| reached.insert(j)));
    }
    reached
}

/// Names that a file defines at its top level.
fn definitions(text: &str) -> BTreeSet<String> {
    const KEYWORDS: [&str; 9] =
        ["fn", "struct", "enum", "trait", "const", "static", "type", "macro_rules!", "union"];
    let mut names = BTreeSet::new();
    for line in text.lines().filter(|line| !line.starts_with([' ', '#', '}'])) {
        let mut words = line.split_whitespace();
        while let Some(word) = words.next() {
            if KEYWORDS.contains(&word) {
                let rest = words.next().unwrap_or("");
                let rest = if rest == "fn" { words.next().unwrap_or("") } else { rest };
                names.insert(rest.chars().take_while(|c| is_identifier(*c)).collect());
                break;
            }
            if word == "impl" || word == "use" {
                break;
            }
        }
    }
    names
}

fn is_identifier(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The `use` declarations of a file: whether each is public, and its tree.
fn declarations(text: &str) -> Vec<(bool, String)> {
    let folded = |tree: &str| tree.split_whitespace().collect::<Vec<_>>().join(" ");
    raw_declarations(text).into_iter().map(|(public, tree)| (public, folded(tree))).collect()
}

fn raw_declarations(text: &str) -> Vec<(bool, &str)> {
    let mut found = Vec::new();
    let mut rest = text;
    while let Some(at) = rest.find("use ") {
        let line = rest[..at].rfind('\n').map_or(0, |n| n + 1);
        let before = rest[line..at].trim();
        let is_declaration = before.is_empty() || before.starts_with("pub");
        let after = &rest[at + 4..];
        let end = after.find(';').unwrap_or(after.len());
        if is_declaration {
            found.push((!before.is_empty(), &after[..end]));
            rest = &after[end..];
        } else {
            rest = after;
        }
    }
    found
}

/// Names in scope by `use`, with their paths.
fn imports(text: &str) -> BTreeMap<String, Vec<String>> {
    let mut names = BTreeMap::new();
    for (_, tree) in declarations(text) {
        expand(&tree, &[], &mut names);
    }
    names
}

/// Names that a file passes on without using them.
fn reexports(text: &str) -> BTreeSet<String> {
    let mut names = BTreeMap::new();
    for (_, tree) in declarations(text).iter().filter(|(public, _)| *public) {
        expand(tree, &[], &mut names);
    }
    names.into_keys().collect()
}

/// Expands a tree such as `a::{b, c::{self, d as e}}`.
fn expand(tree: &str, prefix: &[String], names: &mut BTreeMap<String, Vec<String>>) {
    let tree = tree.trim();
    if let Some(open) = tree.find('{') {
        let head = tree[..open].trim_end_matches(':').split("::").map(|s| s.trim().to_owned());
        let prefix: Vec<String> =
            prefix.iter().cloned().chain(head.filter(|s| !s.is_empty())).collect();
        let (mut level, mut start) = (0, 0);
        for (at, c) in tree[open + 1..].char_indices() {
            match c {
                '{' => level += 1,
                '}' if level > 0 => level -= 1,
                ',' | '}' if level == 0 => {
                    expand(&tree[open + 1..][start..at], &prefix, names);
                    start = at + 1;
                }
                _ => {}
            }
        }
        return;
    }
    if tree.is_empty() {
        return;
    }
    let (path, alias) = tree.split_once(" as ").map_or((tree, None), |(p, a)| (p, Some(a.trim())));
    let own = path.split("::").map(|part| part.trim().to_owned());
    let mut path: Vec<String> = prefix.iter().cloned().chain(own).collect();
    if path.last().is_some_and(|last| last == "self" || last == "*") {
        path.pop();
    }
    let name = alias.map(str::to_owned).or_else(|| path.last().cloned());
    names.extend(name.map(|name| (name, path)));
}

/// Paths of at least two parts in the code of a file, `use` declarations left out.
fn paths_in(text: &str) -> Vec<Vec<String>> {
    let mut paths = Vec::new();
    let mut code = text.to_owned();
    for (_, tree) in raw_declarations(text) {
        code = code.replacen(&format!("use {tree};"), "", 1);
    }
    for word in code.split(|c: char| !is_identifier(c) && c != ':') {
        let parts: Vec<String> = word
            .split("::")
            .filter(|p| !p.is_empty() && !p.contains(':'))
            .map(str::to_owned)
            .collect();
        if parts.len() > 1 && word.contains("::") {
            paths.push(parts);
        }
    }
    paths
}

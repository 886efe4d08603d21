//! Links of the documents: every file that they name is there, and every heading.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

#[test]
fn links_of_documents_lead_somewhere() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let root = root.canonicalize().expect("the repository");
    let documents = documents(&root);
    assert!(documents.iter().any(|d| d.ends_with("docs/results.md")), "{documents:?}");
    let mut broken = Vec::new();
    for document in &documents {
        let text = fs::read_to_string(document).expect("a document in UTF-8");
        for (line, target) in links(&text) {
            if !exists(document, &target) {
                let name = document.strip_prefix(&root).unwrap_or(document).display();
                broken.push(format!("{name}:{line}: {target}"));
            }
        }
    }
    assert!(broken.is_empty(), "links that lead nowhere:\n{}", broken.join("\n"));
}

#[test]
fn headings_become_anchors_as_on_github() {
    let text = "# Poses, and `trajectory.txt`\n```sh\n# no heading\n[no](link)\n```\n\
        ## Twice\n## Twice\nsee [a](b.md#c), ![d](e.png) and [f](https://g.h) [i](#twice)\n";
    let anchors = ["poses-and-trajectorytxt", "twice", "twice-1"].map(String::from);
    assert_eq!(headings(text), BTreeSet::from(anchors));
    let found = [(8, "b.md#c"), (8, "e.png"), (8, "#twice")].map(|(n, to)| (n, to.to_string()));
    assert_eq!(links(text), found);
}

/// Markdown files at the root, in `docs` and in the crates.
fn documents(root: &Path) -> Vec<PathBuf> {
    let mut folders = vec![root.to_path_buf(), root.join("docs"), root.join("crates")];
    let mut documents = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("a folder").flatten() {
            let path = entry.path();
            if path.is_dir() && folder != *root && !path.ends_with("target") {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                documents.push(path);
            }
        }
    }
    documents
}

/// Lines with their numbers, without those of code blocks.
fn prose(text: &str) -> impl Iterator<Item = (usize, &str)> {
    let mut is_code = false;
    text.lines().enumerate().filter_map(move |(number, line)| {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        (!is_code && !is_fence).then_some((number + 1, line))
    })
}

/// Targets of links within the repository, and their lines.
fn links(text: &str) -> Vec<(usize, String)> {
    let of_line = |(number, line): (usize, &str)| -> Vec<(usize, String)> {
        let targets = line.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        let is_inside = |target: &&str| !target.contains("://") && !target.starts_with("mailto:");
        targets.filter(is_inside).map(|target| (number, target.to_string())).collect()
    };
    prose(text).flat_map(of_line).collect()
}

fn exists(document: &Path, target: &str) -> bool {
    let (file, heading) = match target.split_once('#') {
        Some((file, heading)) => (file, Some(heading)),
        None => (target, None),
    };
    let folder = document.parent().unwrap_or(document);
    let path = if file.is_empty() { document.to_path_buf() } else { folder.join(file) };
    match heading {
        None => path.exists(),
        Some(heading) => {
            fs::read_to_string(path).is_ok_and(|text| headings(&text).contains(heading))
        }
    }
}

/// Anchors of the headings of a document.
fn headings(text: &str) -> BTreeSet<String> {
    let mut anchors = BTreeSet::new();
    let titles = prose(text).filter(|(_, line)| line.starts_with('#'));
    for (_, title) in titles {
        let kept = |c: &char| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_');
        let plain: String = title.trim_start_matches('#').trim().chars().filter(kept).collect();
        let anchor = plain.to_lowercase().replace(' ', "-");
        let repeated = (1..).map(|n| format!("{anchor}-{n}"));
        let free = std::iter::once(anchor.clone()).chain(repeated).find(|a| !anchors.contains(a));
        anchors.extend(free);
    }
    anchors
}

//! Whose folder a benchmark writes into: a suite goes on in its own, and in no other.

use crate::failure::Failure;
use crate::output_dir::refuse_file;
use i2slam_result::{FolderContents, Layout, ResultFolder};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;

/// The file that says whose folder it is.
const MARK: &str = "bench.json";

#[derive(Serialize, Deserialize)]
struct Mark {
    /// Title of the suite.
    suite: String,
}

/// Makes the folder that of a suite, or refuses one that holds anything else.
pub(super) fn claim(out: &Path, title: &str) -> Result<(), Failure> {
    refuse_file(out)?;
    let shown = out.display();
    match suite_of(out) {
        Some(known) if known == title => {}
        Some(known) => {
            return Err(Failure::Usage(format!(
                "--out {shown} holds the benchmark \"{known}\", not \"{title}\": choose another \
                 folder"
            )));
        }
        None => refuse_contents(out)?,
    }
    let folder = ResultFolder::create(out)?;
    let mark = serde_json::to_string_pretty(&Mark { suite: title.to_owned() });
    let mark = mark.map_err(|e| Failure::Failed(e.to_string()))?;
    Ok(folder.write_text(MARK, &(mark + "\n"))?)
}

/// Title of the suite that wrote here: its mark, or the heading of its tables.
fn suite_of(out: &Path) -> Option<String> {
    let mark = fs::read_to_string(out.join(MARK)).ok();
    let mark = mark.and_then(|text| serde_json::from_str::<Mark>(&text).ok());
    let heading = || {
        let text = fs::read_to_string(out.join("results.md")).ok()?;
        let cells = out.join("cells").is_dir();
        text.lines().next()?.strip_prefix("# ").map(str::to_owned).filter(|_| cells)
    };
    mark.map(|mark| mark.suite).or_else(heading)
}

fn refuse_contents(out: &Path) -> Result<(), Failure> {
    let none = Layout { files: Vec::new(), pictures: Vec::new(), marks: Vec::new() };
    match none.contents(out) {
        FolderContents::Other(file) => Err(Failure::Usage(format!(
            "--out {} is not empty, it holds {}, and is no benchmark's: choose another folder",
            out.display(),
            file.file_name().unwrap_or_default().display()
        ))),
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_suite_goes_on_in_its_own_folder_and_in_no_other() {
        let out = std::env::temp_dir().join(format!("i2slam-claim-{}", std::process::id()));
        fs::remove_dir_all(&out).ok();
        claim(&out, "mine").expect("a new folder");
        claim(&out, "mine").expect("the same suite");
        let refused = claim(&out, "other").expect_err("another suite");
        assert!(refused.message().is_some_and(|m| m.contains("\"mine\", not \"other\"")));
        fs::remove_file(out.join(MARK)).expect("a mark");
        fs::write(out.join("results.md"), "# mine\n").expect("room");
        let refused = claim(&out, "mine").expect_err("notes of somebody");
        assert!(refused.message().is_some_and(|m| m.contains("results.md")));
        fs::create_dir(out.join("cells")).expect("room");
        claim(&out, "mine").expect("tables of an older program");
        fs::remove_dir_all(&out).ok();
    }
}

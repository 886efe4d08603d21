//! The evaluations of a result folder: `evaluation.json`, and their part of its `report.html`.

use super::failed;
use crate::failure::Failure;
use i2slam_result::ResultFolder;
use i2slam_result::report::{EvaluationSection, put_evaluations};
use std::fs;
use std::path::Path;

const FILE: &str = "evaluation.json";
const PAGE: &str = "report.html";

/// Adds a section to the result of a run, or replaces the one with its title. A folder without a
/// page is of another program, and left as it is.
pub(super) fn add(result: &Path, section: EvaluationSection) -> Result<(), Failure> {
    let page = result.join(PAGE);
    if !page.is_file() {
        return Ok(());
    }
    let text = fs::read_to_string(&page).map_err(|e| failed(&page, e))?;
    let mut sections = known(&result.join(FILE))?;
    match sections.iter_mut().find(|known| known.title == section.title) {
        Some(known) => *known = section,
        None => sections.push(section),
    }
    let Some(text) = put_evaluations(&text, &sections) else {
        return Err(failed(&page, "has no place for evaluations: an older program wrote it"));
    };
    let json = serde_json::to_string_pretty(&sections);
    let json = json.map_err(|e| Failure::Failed(e.to_string()))?;
    let folder = ResultFolder::create(result)?;
    folder.write_text(FILE, &(json + "\n"))?;
    Ok(folder.write_text(PAGE, &text)?)
}

fn known(file: &Path) -> Result<Vec<EvaluationSection>, Failure> {
    if !file.is_file() {
        return Ok(Vec::new());
    }
    let text = fs::read_to_string(file).map_err(|e| failed(file, e))?;
    serde_json::from_str(&text).map_err(|e| failed(file, e))
}

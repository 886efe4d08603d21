//! Result folders as arguments.

use crate::failure::Failure;
use std::path::Path;

/// Refuses a folder that is no result of a run.
pub(crate) fn refuse_non_results(result: &Path) -> Result<(), Failure> {
    let shown = result.display();
    if result.is_file() {
        return Err(Failure::Usage(format!(
            "{shown}: a file, where the result's folder is expected"
        )));
    }
    if !result.is_dir() {
        return Err(Failure::Usage(format!("{shown}: no such folder")));
    }
    match is_result(result) {
        true => Ok(()),
        false => Err(Failure::Usage(format!(
            "{shown}: no result of a run, which has config.toml and map.i2slam"
        ))),
    }
}

/// Refuses a result of a run where a sequence is expected.
pub(crate) fn refuse_results(dataset: &Path) -> Result<(), Failure> {
    match is_result(dataset) {
        true => Err(Failure::Usage(format!(
            "{} is a result of `i2slam run`, where a sequence is expected: its report.html describes it, and \
             its input.json names the sequence it was made of",
            dataset.display()
        ))),
        false => Ok(()),
    }
}

/// Tells if a folder holds a result of a run.
pub(crate) fn is_result(folder: &Path) -> bool {
    folder.join("config.toml").is_file() && folder.join("map.i2slam").is_file()
}

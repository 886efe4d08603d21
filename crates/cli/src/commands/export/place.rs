//! The place of an export: new, or an earlier export in the same format.

use super::arguments::{Export, FolderFormat, Format};
use crate::failure::Failure;
use crate::output_file::previous;
use i2slam_result::export::{CSV_COLUMNS, MARK};
use i2slam_storage::{Claim, OutputFolder, write_file};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Beginning of a file in which its mark stands [bytes].
const HEAD: u64 = 1 << 20;

/// Checks that the export may be written, before any work.
pub(super) fn check(arguments: &Export) -> Result<(), Failure> {
    let (format, out) = (arguments.format, arguments.out.as_path());
    if let Some(folder) = format.folder() {
        return Ok(OutputFolder::check(out, claim(arguments, folder))?);
    }
    if out == Path::new("-") {
        return Err(Failure::Usage("--out -: name a file, standard output is not one".to_owned()));
    }
    check_extension(format, out)?;
    check_file(format, out, arguments.overwrite)
}

/// The claim on a folder of a format.
pub(super) fn claim(arguments: &Export, format: FolderFormat) -> Claim<'static> {
    let FolderFormat { command, names } = format;
    Claim { command, names, overwrite: arguments.overwrite }
}

fn check_extension(format: Format, out: &Path) -> Result<(), Failure> {
    let due = format.extensions();
    let name = out.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    let fits = |extension: &str| name.ends_with(&format!(".{extension}"));
    if due.is_empty() || due.iter().any(|extension| fits(extension)) {
        return Ok(());
    }
    let (out, format, due) = (out.display(), format.name(), due.join(" or ."));
    Err(Failure::Usage(format!("--out {out}: names of {format} files end with .{due}")))
}

/// Refuses a file that is there, unless it is an earlier export and may be replaced.
fn check_file(format: Format, out: &Path, overwrite: bool) -> Result<(), Failure> {
    if out.symlink_metadata().is_err() {
        return Ok(());
    }
    let message = match (is_earlier_export(format, out), overwrite) {
        (true, true) => return Ok(()),
        (true, false) => {
            "is an earlier export: choose another name, or replace it with --overwrite".to_owned()
        }
        (false, _) if out.is_dir() => "is a folder: name a file in it".to_owned(),
        (false, _) => {
            let name = format.name();
            format!("is there already, and no export of the format {name}: choose another name")
        }
    };
    Err(Failure::Usage(format!("--out {} {message}", out.display())))
}

/// Copies an earlier export that can be edited by hand to `FILE.previous`, before it is replaced; returns the
/// path of the copy, if one was made.
pub(super) fn keep_previous(arguments: &Export) -> Result<Option<PathBuf>, Failure> {
    let (format, out) = (arguments.format, arguments.out.as_path());
    if !matches!(format, Format::Tum | Format::Csv) || !out.is_file() {
        return Ok(None);
    }
    let previous = previous(out);
    if previous.exists() && !is_earlier_export(format, &previous) {
        let message = format!("{} is no export: move it away", previous.display());
        return Err(Failure::Usage(message));
    }
    write_file(&previous, |copy| io::copy(&mut i2slam_storage::open(out)?, copy).map(drop))?;
    Ok(Some(previous))
}

/// Tells if a file begins as one that this command wrote in that format.
fn is_earlier_export(format: Format, file: &Path) -> bool {
    let mut head = Vec::new();
    let read = i2slam_storage::open(file).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    if read.is_err() {
        return false;
    }
    let mark = match format {
        Format::Csv => CSV_COLUMNS.to_owned(),
        _ => format!("{MARK} --format {}", format.name()),
    };
    head.windows(mark.len()).any(|window| window == mark.as_bytes())
}

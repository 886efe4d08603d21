//! Lines on standard output and standard error. A closed pipe ends no run.

use crate::failure::Failure;
use serde::Serialize;
use std::io::{self, Write};

/// Prints one line of result on standard output.
pub(crate) fn print(line: &str) {
    let mut out = io::stdout().lock();
    writeln!(out, "{line}").and_then(|()| out.flush()).ok();
}

/// Count and noun: `1 frame`, `3 frames`.
pub(crate) fn counted(count: usize, word: &str) -> String {
    format!("{count} {word}{}", if count == 1 { "" } else { "s" })
}

/// Prints one line on standard error: a warning, an error, progress.
pub(crate) fn print_status(line: &str) {
    writeln!(io::stderr().lock(), "{line}").ok();
}

/// Prints a value as JSON on standard output.
pub(crate) fn print_json(value: &impl Serialize) -> Result<(), Failure> {
    let text = serde_json::to_string_pretty(value);
    print(&text.map_err(|e| Failure::Failed(format!("cannot write JSON: {e}")))?);
    Ok(())
}

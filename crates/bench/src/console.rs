//! Messages, exit codes and Ctrl-C of the program.

use i2slam_result::ResultError;
use std::fmt;
use std::io::{self, Write};
use std::sync::atomic::{AtomicBool, Ordering};

/// Why the program ended early.
#[derive(Debug)]
pub(crate) enum Failure {
    /// Invalid arguments or an invalid suite: exit code 2.
    Usage(String),
    /// Something did not work: exit code 1.
    Failed(String),
    /// Ended by the user; finished jobs are kept: exit code 130, as shells do.
    Interrupted,
}

impl Failure {
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) => 2,
            Self::Failed(_) => 1,
            Self::Interrupted => 130,
        }
    }
}

/// The message; empty after an interruption.
impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Usage(message) | Self::Failed(message) => f.write_str(message),
            Self::Interrupted => Ok(()),
        }
    }
}

impl From<ResultError> for Failure {
    fn from(error: ResultError) -> Self {
        Self::Failed(error.to_string())
    }
}

/// Writes a line to standard output; a closed pipe is no error.
pub(crate) fn print(line: &str) {
    let mut out = io::stdout().lock();
    writeln!(out, "{line}").and_then(|()| out.flush()).ok();
}

/// Writes a line to standard error: progress, notes, errors.
pub(crate) fn print_status(line: &str) {
    writeln!(io::stderr().lock(), "{line}").ok();
}

/// `1 job`, `3 jobs`: for words that take an s.
pub(crate) fn counted(count: usize, word: &str) -> String {
    format!("{count} {word}{}", if count == 1 { "" } else { "s" })
}

static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Handles Ctrl-C, SIGTERM and SIGHUP: the first ends the jobs and writes the report, the second
/// ends the program at once.
pub(crate) fn listen() {
    let handler = || {
        if INTERRUPTED.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        print_status("\nending the jobs and writing what there is; once more ends at once");
    };
    if ctrlc::set_handler(handler).is_err() {
        print_status("warning: Ctrl-C will end this benchmark without writing tables");
    }
}

/// Whether the user asked to end.
pub(crate) fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::SeqCst)
}

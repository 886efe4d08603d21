//! Failures with their exit codes and lines on the terminal, for `i2slam` and `i2slam-bench`. A closed
//! pipe ends no run.

use i2slam_result::ResultError;
use i2slam_storage::StorageError;
use std::io::{self, Write};

/// Reason why a program ended without success.
#[derive(Debug)]
pub(crate) enum Failure {
    /// Wrong arguments or a wrong file of settings: exit code 2.
    Usage(String),
    /// Failure at work: exit code 1.
    Failed(String),
    /// Failure at work whose reasons were printed before the summary: exit code 1.
    Reported,
    /// Interrupted by the user, after results were written: exit code 130, as in shells.
    Interrupted,
}

impl Failure {
    pub(crate) fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) => 2,
            Self::Failed(_) | Self::Reported => 1,
            Self::Interrupted => 130,
        }
    }

    pub(crate) fn message(&self) -> Option<&str> {
        match self {
            Self::Usage(message) | Self::Failed(message) => Some(message),
            Self::Reported | Self::Interrupted => None,
        }
    }

    /// Prints the message; returns the exit code of the program.
    pub(crate) fn report(&self) -> u8 {
        if let Some(message) = self.message() {
            print_status(&format!("error: {message}"));
        }
        self.exit_code()
    }
}

impl From<ResultError> for Failure {
    fn from(error: ResultError) -> Self {
        match error {
            ResultError::Storage(error) => error.into(),
            error => Self::Failed(error.to_string()),
        }
    }
}

impl From<StorageError> for Failure {
    fn from(error: StorageError) -> Self {
        match error {
            StorageError::Refused { .. } => Self::Usage(error.to_string()),
            StorageError::Write { .. } | StorageError::Busy { .. } => {
                Self::Failed(error.to_string())
            }
        }
    }
}

/// Prints one line of result on standard output.
pub(crate) fn print(line: &str) {
    let mut out = io::stdout().lock();
    writeln!(out, "{line}").and_then(|()| out.flush()).ok();
}

/// Prints one line on standard error: a warning, an error, progress.
pub(crate) fn print_status(line: &str) {
    writeln!(io::stderr().lock(), "{line}").ok();
}

/// Count and noun: `1 frame`, `3 frames`.
pub(crate) fn counted(count: usize, word: &str) -> String {
    format!("{count} {word}{}", if count == 1 { "" } else { "s" })
}

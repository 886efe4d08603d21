//! Failures with their exit codes and lines on the terminal, for `i2slam` and `i2slam-bench`. A closed
//! pipe ends no run. Names of files and texts of other programs come here as they are: control
//! characters in them are escaped, so that they neither steer the terminal nor begin a line.

use clap::Parser;
use i2slam_result::ResultError;
use i2slam_storage::StorageError;
use std::borrow::Cow;
use std::ffi::OsString;
use std::io::{self, Write};
use std::process;
use std::sync::atomic::{AtomicBool, Ordering};

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
            StorageError::Write { .. } | StorageError::Busy { .. } | StorageError::Saved { .. } => {
                Self::Failed(error.to_string())
            }
        }
    }
}

/// Prints one line of result on standard output.
pub(crate) fn print(line: &str) {
    print_text(&one_message(line));
}

/// Prints a text of several lines on standard output: TOML or JSON, in which line breaks of names
/// are escaped already.
pub(crate) fn print_text(text: &str) {
    let mut out = io::stdout().lock();
    let written = writeln!(out, "{}", without_controls(text)).and_then(|()| out.flush());
    // A reader that has seen enough, such as `head`, closes the pipe.
    if written.is_err_and(|error| error.kind() != io::ErrorKind::BrokenPipe) {
        IS_OUTPUT_LOST.store(true, Ordering::Relaxed);
    }
}

/// True once something could not be written to standard output.
static IS_OUTPUT_LOST: AtomicBool = AtomicBool::new(false);

/// Fails if something that was printed could not be written.
///
/// # Errors
/// [`Failure::Failed`], where the disk that standard output goes to is full.
pub(crate) fn check_output_is_whole() -> Result<(), Failure> {
    match IS_OUTPUT_LOST.load(Ordering::Relaxed) {
        true => Err(Failure::Failed("cannot write to standard output: is its disk full?".into())),
        false => Ok(()),
    }
}

/// Prints one line on standard error: a warning, an error, progress.
pub(crate) fn print_status(line: &str) {
    writeln!(io::stderr().lock(), "{}", without_controls(&one_message(line))).ok();
}

/// Escapes line breaks, but for those that a message of several lines is made of: at its beginning,
/// and before lines that are indented, which cannot be taken for messages of their own.
fn one_message(text: &str) -> Cow<'_, str> {
    let (start, rest) = text.split_at(usize::from(text.starts_with('\n')));
    if !rest.contains('\n') {
        return text.into();
    }
    let mut lines = rest.split('\n');
    let mut message = format!("{start}{}", lines.next().unwrap_or_default());
    for line in lines {
        message += if line.starts_with("  ") { "\n" } else { "\\n" };
        message += line;
    }
    message.into()
}

/// Escapes as in JSON and TOML what steers a terminal: control characters other than line breaks and
/// tabs, and marks that change the direction or the lines of text.
fn without_controls(text: &str) -> Cow<'_, str> {
    let steers = |c: char| {
        (c.is_control() && c != '\n' && c != '\t')
            || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}')
            || matches!(c, '\u{2066}'..='\u{2069}' | '\u{feff}')
    };
    if !text.contains(steers) {
        return text.into();
    }
    let escaped = |c: char| match steers(c) {
        true => format!("\\u{:04x}", u32::from(c)),
        false => c.to_string(),
    };
    text.chars().map(escaped).collect::<String>().into()
}

/// Parses the arguments of the program; wrong ones end it with a message in which they are escaped.
pub(crate) fn parse_arguments<T: Parser>() -> T {
    let arguments = || with_attached_files(std::env::args_os());
    T::try_parse_from(arguments()).unwrap_or_else(|error| {
        let escaped = |argument: OsString| {
            let text = argument.to_string_lossy().replace('\n', "\\n");
            OsString::from(without_controls(&text).into_owned())
        };
        // The message quotes arguments, so that it is made of those that can be printed.
        match T::try_parse_from(arguments().into_iter().map(escaped)) {
            Err(printable) => printable.exit(),
            Ok(_) => {
                let text = error.to_string();
                writeln!(io::stderr().lock(), "{}", without_controls(&text)).ok();
                process::exit(error.exit_code())
            }
        }
    })
}

/// Flag whose value is a file or several numbers.
const FILE_OR_NUMBERS: &str = "--intrinsics";

/// The arguments with a file attached to its flag by `=`: of several values that a flag may have, the parser
/// would take the sequence after the file as the second.
fn with_attached_files(arguments: impl Iterator<Item = OsString>) -> Vec<OsString> {
    let mut all: Vec<OsString> = Vec::new();
    for argument in arguments {
        let is_number = argument.to_str().is_some_and(|text| text.parse::<f64>().is_ok());
        match all.last_mut() {
            Some(flag) if *flag == FILE_OR_NUMBERS && !is_number => {
                flag.push("=");
                flag.push(argument);
            }
            _ => all.push(argument),
        }
    }
    all
}

/// Count and noun: `1 frame`, `3 frames`.
pub(crate) fn counted(count: usize, word: &str) -> String {
    format!("{count} {word}{}", if count == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn printed(line: &str) -> String {
        without_controls(&one_message(line)).into_owned()
    }

    #[test]
    fn a_file_of_intrinsics_does_not_take_the_sequence_as_well() {
        let attached = |line: &str| {
            let all = with_attached_files(line.split(' ').map(OsString::from));
            all.join(std::ffi::OsStr::new(" ")).to_string_lossy().into_owned()
        };
        let file = "run --intrinsics camera.json video.mp4";
        assert_eq!(attached(file), "run --intrinsics=camera.json video.mp4");
        for unchanged in
            ["run --intrinsics 500 500 -3.5 240 video.mp4", "run video.mp4 --intrinsics"]
        {
            assert_eq!(attached(unchanged), unchanged);
        }
    }

    #[test]
    fn control_characters_are_escaped() {
        assert_eq!(printed("a \x1b[31mred\x1b[0m"), "a \\u001b[31mred\\u001b[0m");
        assert_eq!(
            printed("a\u{9b}31m \u{202e}gpj.\r\u{7f}"),
            "a\\u009b31m \\u202egpj.\\u000d\\u007f"
        );
        for plain in ["", "Grüße 世界 \u{1f600}", "column\tcolumn", "a\\b"] {
            assert_eq!(printed(plain), plain);
        }
    }

    #[test]
    fn only_indented_lines_go_on_with_a_message() {
        assert_eq!(printed("a\nerror: b"), "a\\nerror: b");
        assert_eq!(printed("one of\n  this\n  that"), "one of\n  this\n  that");
        assert_eq!(printed("\nending the run"), "\nending the run");
        assert_eq!(printed("a\n\n  b\n"), "a\\n\n  b\\n");
    }
}

//! Outcomes of cases, and what counts as a failure.

use crate::case::Case;
use std::fmt;
use std::path::Path;

/// Longest message [bytes]: longer ones push everything else off a terminal.
const MAX_MESSAGE: usize = 4000;

/// Pieces of texts that `Debug` writes and people do not.
const DEBUG_DUMPS: [&str; 7] = ["Error {", "Error(", "Some(", "Ok(", "Err(", "Os {", "ErrorKind"];

/// Fault of a message that passes on that memory ran out: without the bound on this process the
/// reader would have gone on.
const OUT_OF_MEMORY: &str = "memory ran out";

/// Faults of messages.
const FAULTS: [&str; 5] = ["empty", "too long", INSIDES, "names no file", OUT_OF_MEMORY];
const INSIDES: &str = "shows the insides of an error";

/// The fault with a name.
pub(crate) fn find_fault(name: &str) -> Option<&'static str> {
    FAULTS.into_iter().find(|fault| *fault == name)
}

/// Outcome of a case.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Outcome {
    Accepted,
    /// The reader's message.
    Refused(String),
    Failed(Failure),
}

/// A failure of a reader.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Failure {
    /// Message and place of a panic, on any thread.
    Panic(String),
    /// The worker ended: its status, and the end of its standard error.
    Death(String),
    /// No answer within the time [s].
    Hang(f64),
    /// More memory than allowed [bytes].
    Memory(u64),
    /// An error message, and what is wrong with it.
    Message(&'static str, String),
    /// A library wrote to standard output.
    Printed(String),
    /// A seed was refused with this message.
    SeedRefused(String),
}

impl Failure {
    /// Name of its kind.
    pub(crate) fn kind(&self) -> &'static str {
        match self {
            Self::Panic(_) => "panic",
            Self::Death(_) => "death",
            Self::Hang(_) => "hang",
            Self::Memory(_) => "memory",
            Self::Message(..) => "message",
            Self::Printed(_) => "printed",
            Self::SeedRefused(_) => "seed refused",
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Panic(message) => write!(f, "panic: {message}"),
            Self::Death(how) => write!(f, "death of the process: {how}"),
            Self::Hang(seconds) => write!(f, "hang: no answer within {seconds} s"),
            Self::Memory(bytes) => write!(f, "memory: {} MB", bytes / 1_000_000),
            Self::Message(fault, message) => write!(f, "message: {fault}: {message}"),
            Self::Printed(line) => write!(f, "printed: {line}"),
            Self::SeedRefused(message) => write!(f, "seed refused: {message}"),
        }
    }
}

/// The fault of a message that a reader refused a case with; `folder` is that of the case.
pub(crate) fn fault_of(message: &str, case: &Case, folder: &Path) -> Option<&'static str> {
    let folder = folder.to_string_lossy();
    let names_file = || {
        // The folder's own name is that of any other; a path in it, or a name, is needed.
        let is_inside = message.contains(folder.as_ref());
        // A list may name a file elsewhere.
        let is_elsewhere = ["/dev/", "/etc/"].iter().any(|place| message.contains(place));
        is_inside || is_elsewhere || case.file_names().any(|name| message.contains(name))
    };
    let shown = message.replace(folder.as_ref(), "");
    if message.trim().is_empty() {
        return Some("empty");
    }
    let words = ["out of memory", "annot allocate memory"];
    if words.iter().any(|word| message.contains(word)) {
        return Some(OUT_OF_MEMORY);
    }
    if shown.len() > MAX_MESSAGE {
        return Some("too long");
    }
    if DEBUG_DUMPS.iter().any(|dump| shown.contains(dump)) {
        return Some(INSIDES);
    }
    (!names_file()).then_some("names no file")
}

//! A stand-in for ffmpeg: answers with the files `VIDEO.log` and `VIDEO.raw` beside the video, so
//! that what i2slam reads from ffmpeg can be damaged.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;
use std::process::ExitCode;

/// First argument with which i2slam starts ffmpeg.
pub(crate) const FIRST_ARGUMENT: &str = "-hide_banner";

/// Largest answer [bytes]: ffmpeg writes about as much as it reads.
const MAX_ANSWER: u64 = 1 << 26;

/// Writes the log to standard error and, if pictures are asked for, these to standard output.
pub(crate) fn answer() -> ExitCode {
    let arguments: Vec<String> = std::env::args().collect();
    let after = |name: &str| arguments.iter().position(|a| a == name).map(|at| at + 1);
    let Some(video) = after("-i").and_then(|at| arguments.get(at)) else {
        return ExitCode::FAILURE;
    };
    let copied = match arguments.iter().any(|argument| argument == "rawvideo") {
        true => copy(&format!("{video}.raw"), &mut io::stdout()),
        false => copy(&format!("{video}.log"), &mut io::stderr()),
    };
    // The reader may have seen enough.
    if copied.is_ok() { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn copy(path: &str, out: &mut dyn io::Write) -> io::Result<u64> {
    if !Path::new(path).is_file() {
        return Err(io::ErrorKind::NotFound.into());
    }
    io::copy(&mut File::open(path)?.take(MAX_ANSWER), out)
}

//! The program `i2slam` with `--rerun`: recordings of finished runs for the viewer Rerun.

mod log;
mod recorder;

use std::process::ExitCode;

fn main() -> ExitCode {
    i2slam_cli::run_program(Some(recorder::write))
}

//! The program `i2slam` as it is built by default: without a recorder.

use std::process::ExitCode;

fn main() -> ExitCode {
    i2slam_cli::run_program(None)
}

//! The program `i2slam`: RGB-D SLAM that inverts image formation.

mod arguments;
mod commands;
mod destination;
mod failure;
mod interrupt;
mod output;
mod picture;
mod pipeline;
mod progress;
mod truth;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments = arguments::Arguments::parse();
    match failure::without_panics(|| commands::dispatch(arguments.command)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            if let Some(message) = failure.message() {
                output::complain(&format!("error: {message}"));
            }
            ExitCode::from(failure.exit_code())
        }
    }
}

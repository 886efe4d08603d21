//! Feeds damaged files to every reader of i2slam and reports panics, aborts, hangs, excessive
//! memory and error messages that do not help. CONTRIBUTING.md says how to use it.
//!
//! A case is a seed of the corpus changed by random numbers that depend on the run's seed, the
//! reader and the number of the case alone. It runs in a worker, a process of its own with bounded
//! memory and time, so that whatever happens is attributed to the case.

mod arguments;
mod case;
mod container;
mod corpus;
mod failure;
mod ffmpeg;
mod memory;
mod mutate;
mod protocol;
mod readers;
mod report;
mod run;
mod seeds;
mod worker;
mod worker_process;

use arguments::Arguments;
use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    // Readers of videos start this program in place of ffmpeg.
    if std::env::args().nth(1).is_some_and(|first| first == ffmpeg::FIRST_ARGUMENT) {
        return ffmpeg::answer();
    }
    let arguments = Arguments::parse();
    let outcome = match &arguments.command {
        None => run::run(&arguments),
        Some(arguments::Command::Worker { scratch }) => worker::serve(&arguments, scratch),
        Some(arguments::Command::WriteSeeds { folder }) => seeds::write(folder).map(|()| true),
    };
    match outcome {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(message) => {
            eprintln!("i2slam-fuzz: {message}");
            ExitCode::from(2)
        }
    }
}

//! The program `i2slam`, which makes sharp 3D maps in high dynamic range and camera paths from blurred
//! video, as a library of one call: a program that records runs in a format of its own hands its
//! [`Recorder`] over.

mod allocator;
mod arguments;
mod commands;
mod console;
mod exposure_table;
mod failure;
mod ground_truth;
mod held_out_frames;
mod image_files;
mod interrupt;
mod live_viewer;
mod messages;
mod output_file;
mod pose_lines;
mod progress;
mod reconstruction;
mod recording;
mod result_folder;
mod taken_pictures;

pub use recording::{RecordedRun, Recorder};

use std::process::ExitCode;

/// Runs the program with the arguments of this process. `recorder` writes the file of `--rerun`; without
/// one the flag is refused.
pub fn run_program(recorder: Option<Recorder>) -> ExitCode {
    let arguments: commands::Arguments = console::parse_arguments();
    match failure::catch_panics(|| commands::dispatch(arguments.command, recorder))
        .and_then(|()| console::check_output_is_whole())
    {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => ExitCode::from(failure.report()),
    }
}

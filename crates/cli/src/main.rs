//! The program `i2slam`: RGB-D SLAM that inverts image formation.

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
mod pose_lines;
mod progress;
mod reconstruction;
mod result_folder;
mod taken_pictures;

use std::process::ExitCode;

fn main() -> ExitCode {
    let arguments: commands::Arguments = console::parse_arguments();
    match failure::catch_panics(|| commands::dispatch(arguments.command)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => ExitCode::from(failure.report()),
    }
}

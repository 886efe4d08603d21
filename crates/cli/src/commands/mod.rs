//! Subcommands with their arguments.

mod completions;
mod degrade;
mod demo;
mod eval;
mod export;
mod info;
mod man;
mod presets;
mod render;
mod run;
mod synth;
mod views;

use crate::failure::Failure;
use crate::recording::Recorder;
use clap::{Parser, Subcommand};

/// SLAM on blurred video with drifting exposure, with depth or without: a sharp HDR map and the path of the
/// camera.
#[derive(Parser, Debug)]
#[command(name = "i2slam", version, max_term_width = 100)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Subcommand, Debug)]
pub(crate) enum Command {
    /// Reconstruct a sequence
    Run(Box<run::Run>),
    /// Render pictures of a result: sharp, blurred as observed, HDR, depth; as large as `run --max-side` has
    /// made those of the map
    Render(render::Render),
    /// Write a result for other programs: Gaussians, pictures with poses, mesh, path
    Export(export::Export),
    /// Compare a result with ground truth
    Eval(eval::Eval),
    /// Reconstruct the clip that comes with the program (2 s, hand-held, blurred)
    Demo(demo::Demo),
    /// List the presets, or print every value of one
    Presets(presets::Presets),
    /// Render a test sequence with ground truth: a furnished room, blur, exposure changes
    Synth(synth::Synth),
    /// Put noise, exposure steps, gaps or a covered lens on a sequence
    Degrade(degrade::Degrade),
    /// Print the completions of this program for a shell
    Completions(completions::Completions),
    /// Print the manual page of this program, or write those of all commands
    Man(man::Man),
    /// Moved to the program i2slam-bench
    #[command(hide = true, disable_help_flag = true)]
    Bench {
        #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
        arguments: Vec<String>,
    },
    /// Describe a sequence before it is run: layout, times, camera, depth, exposure
    Info(info::Info),
}

/// Runs a subcommand; `recorder` writes the file of `--rerun`.
pub(crate) fn dispatch(command: Command, recorder: Option<Recorder>) -> Result<(), Failure> {
    match command {
        Command::Run(arguments) => run::run(&arguments, recorder),
        Command::Render(arguments) => render::render(&arguments),
        Command::Export(arguments) => export::export(&arguments),
        Command::Eval(arguments) => eval::eval(&arguments),
        Command::Demo(arguments) => demo::demo(&arguments, recorder),
        Command::Presets(arguments) => presets::presets(&arguments),
        Command::Synth(arguments) => synth::synth(&arguments),
        Command::Degrade(arguments) => degrade::degrade(&arguments),
        Command::Completions(arguments) => completions::completions(&arguments),
        Command::Man(arguments) => man::man(&arguments),
        Command::Bench { .. } => Err(Failure::Usage(
            "benchmarks are run by the program i2slam-bench: i2slam-bench SUITE --out DIR".into(),
        )),
        Command::Info(arguments) => info::info(&arguments),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn definitions_are_sound() {
        Arguments::command().debug_assert();
    }
}

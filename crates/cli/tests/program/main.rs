//! The program from outside: tiny made-up sequences in, result folders out.

#[cfg(unix)]
mod bounds;
mod commands;
mod eval;
mod eval_result;
mod export;
#[cfg(unix)]
mod footage;
mod info;
mod limits;
mod program;
mod result_folder;
mod run_depth;
mod run_keyframes;
#[cfg(unix)]
mod run_video;
mod safety;
#[cfg(unix)]
mod signals;
#[cfg(unix)]
mod terminal;

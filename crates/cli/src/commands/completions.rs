//! `i2slam completions`: completions of this program for a shell.

use super::Arguments;
use crate::console::print_text;
use crate::failure::Failure;
use clap::{Args, CommandFactory};
use clap_complete::Shell;

#[derive(Args, Debug)]
pub(crate) struct Completions {
    /// The shell; `source <(i2slam completions bash)` loads them
    #[arg(value_enum)]
    pub(crate) shell: Shell,
}

pub(crate) fn completions(arguments: &Completions) -> Result<(), Failure> {
    let mut script = Vec::new();
    clap_complete::generate(arguments.shell, &mut Arguments::command(), "i2slam", &mut script);
    print_text(String::from_utf8_lossy(&script).trim_end());
    Ok(())
}

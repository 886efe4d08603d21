//! Command line.

use clap::{Parser, Subcommand};
use std::path::PathBuf;

/// Feeds damaged files to every reader
#[derive(Parser, Clone, Debug)]
#[command(version, args_conflicts_with_subcommands = true)]
pub(crate) struct Arguments {
    #[command(subcommand)]
    pub(crate) command: Option<Command>,
    /// Readers, the names of the corpus's folders [default: all]
    #[arg(value_name = "READER")]
    pub(crate) readers: Vec<String>,
    /// End after this time [s]
    #[arg(long, value_name = "N", conflicts_with_all = ["cases", "case"])]
    pub(crate) seconds: Option<u64>,
    /// End after this number of cases over all readers [default: 1000, if there is no --seconds]
    #[arg(long, value_name = "N")]
    pub(crate) cases: Option<u64>,
    /// Run only this case, of one reader
    #[arg(long, value_name = "K", conflicts_with = "cases", requires = "readers")]
    pub(crate) case: Option<u64>,
    /// With --case: also write the case's files into this new folder
    #[arg(long, value_name = "DIR", requires = "case")]
    pub(crate) write: Option<PathBuf>,
    /// Seed of the cases [default: the time]
    #[arg(long, value_name = "S", global = true)]
    pub(crate) seed: Option<u64>,
    /// Workers at once [default: one per processor, at most 8]
    #[arg(long, value_name = "N")]
    pub(crate) jobs: Option<usize>,
    /// Folder of the seeds, READER/SEED/FILES
    #[arg(long, value_name = "DIR", default_value = concat!(env!("CARGO_MANIFEST_DIR"), "/corpus"), global = true)]
    pub(crate) corpus: PathBuf,
    /// Time above which a case fails [s]
    #[arg(long, value_name = "S", default_value_t = 10.0)]
    pub(crate) time_limit: f64,
}

#[derive(Subcommand, Clone, Debug)]
pub(crate) enum Command {
    /// Write the seeds of the corpus anew
    WriteSeeds {
        /// Folder, `crates/fuzz/corpus`
        folder: PathBuf,
    },
    /// Runs the cases that the standard input names; started by the program itself
    #[command(hide = true)]
    Worker {
        /// Folder for the files of cases
        scratch: PathBuf,
    },
}

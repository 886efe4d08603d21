//! Quality and cost of the blur methods.
//!
//! ```sh
//! cargo bench -p i2slam --bench blur             # all tables
//! cargo bench -p i2slam --bench blur -- quality  # one of: quality, truth, steps
//! ```
//!
//! Tables are lines of comma-separated values under a line `# name`; `docs/performance.py` writes
//! them into `docs/performance.md`. `truth` wants the path-traced sequences in `../shared/data`.

mod fitted;
mod quality;
mod steps;
mod truth;

use std::error::Error;

type Outcome = Result<(), Box<dyn Error>>;

/// A table's name and what prints it.
type Table = (&'static str, fn() -> Outcome);

const TABLES: [Table; 3] =
    [("quality", quality::print), ("truth", truth::print), ("steps", steps::print)];

fn main() -> Outcome {
    let asked: Vec<_> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    for (name, print) in TABLES {
        if asked.is_empty() || asked.iter().any(|word| word == name) {
            println!("# {name}");
            print()?;
        }
    }
    Ok(())
}

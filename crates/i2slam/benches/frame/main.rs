//! Cost of a frame: tracking and mapping by preset, and allocations in steady state.
//!
//! ```sh
//! cargo bench -p i2slam --bench frame              # all tables
//! cargo bench -p i2slam --bench frame -- presets   # one of: frame, presets, allocations
//! ```

mod allocations;
mod counting;
mod presets;

use std::error::Error;

type Outcome = Result<(), Box<dyn Error>>;

/// A table's name and what prints it.
type Table = (&'static str, fn() -> Outcome);

const TABLES: [Table; 3] = [
    ("frame", presets::print_frame),
    ("presets", presets::print),
    ("allocations", allocations::print),
];

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

//! Tables that a bench prints.

use std::error::Error;

/// Result of printing a table.
pub(crate) type Outcome = Result<(), Box<dyn Error>>;

/// Name of a table and the function that prints it.
pub(crate) type Table = (&'static str, fn() -> Outcome);

/// Prints the tables named on the command line, or all, each under a line `# name`.
pub(crate) fn print(tables: &[Table]) -> Outcome {
    let names: Vec<_> = std::env::args().skip(1).filter(|word| !word.starts_with('-')).collect();
    for (name, print) in tables {
        if names.is_empty() || names.iter().any(|word| word == name) {
            println!("# {name}");
            print()?;
        }
    }
    Ok(())
}

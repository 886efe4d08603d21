//! Pinholes of results, of sequences with depth: `cargo run --release -p i2slam-bench --example pinholes
//! -- RESULT...` prints for each the share of the surface through which more than half of the light
//! passes, as viewers draw `map.ply` from 40 % nearer.

#[path = "../src/pinholes.rs"]
mod pinholes;

use std::path::Path;

fn main() -> Result<(), pinholes::Failure> {
    for result in std::env::args().skip(1) {
        match pinholes::of_result(Path::new(&result))? {
            Some(share) => println!("{result}: {:.2} %", 100.0 * share),
            None => println!("{result}: no Gaussians, or no depth"),
        }
    }
    Ok(())
}

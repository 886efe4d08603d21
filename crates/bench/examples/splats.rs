//! Figures of the maps of results, of sequences with depth: `cargo run --release -p i2slam-bench
//! --example splats -- RESULT...` prints for each the share of the surface through which more than
//! half of the light passes, as viewers draw `map.ply` from 40 % nearer, that where Gaussians at all
//! depths are in its way, and the share of the Gaussians that are off the surface by more than 2 % of
//! its depth.

#[path = "../src/splats.rs"]
mod splats;

use std::path::Path;

fn main() -> Result<(), splats::Failure> {
    for result in std::env::args().skip(1) {
        match splats::of_result(Path::new(&result))? {
            Some(figures) => println!(
                "{result}: pinholes {:.2} % (all depths {:.2} %), off the surface {:.2} %",
                100.0 * figures.pinholes,
                100.0 * figures.see_through,
                100.0 * figures.off_surface
            ),
            None => println!("{result}: no Gaussians, or no depth"),
        }
    }
    Ok(())
}

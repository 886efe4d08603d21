//! Trains a hash-grid field on a sequence with known poses, exposures and sharp pictures, and
//! reports quality and time per step; the counterpart in PyTorch is `docs/hashgrid/reference.py`.
//! Then runs whole sessions with both maps on the same pictures.
//!
//! ```sh
//! cargo run --release -p i2slam --example fit_field -- DATA [--steps N] [--rays N] [--seed N]
//!                                                            [--threads N] [--log2-table N]
//! cargo run --release -p i2slam --example fit_field -- DATA --sessions [--threads N]
//! ```
//!
//! `DATA` has `sharp/`, `depth/`, `groundtruth.txt`, `exposure.csv` and `camera.json`. Pictures are
//! taken at half their size, and every eighth frame is held out.

mod fit;
mod frames;
mod sessions;

use std::error::Error;
use std::path::PathBuf;

/// Arguments of the command line.
struct Arguments {
    data: PathBuf,
    sessions: bool,
    steps: usize,
    rays: usize,
    seed: u64,
    threads: usize,
    log2_table: u32,
}

impl Arguments {
    fn read(mut words: impl Iterator<Item = String>) -> Result<Self, Box<dyn Error>> {
        let data = words.next().ok_or("a sequence is asked for")?.into();
        let (steps, rays, seed, threads, log2_table) = (1000, 1024, 0, 1, 17);
        let mut asked = Self { data, sessions: false, steps, rays, seed, threads, log2_table };
        while let Some(word) = words.next() {
            if word == "--sessions" {
                asked.sessions = true;
                continue;
            }
            let value = words.next().ok_or_else(|| format!("{word} wants a number"))?;
            match word.as_str() {
                "--steps" => asked.steps = value.parse()?,
                "--rays" => asked.rays = value.parse()?,
                "--seed" => asked.seed = value.parse()?,
                "--threads" => asked.threads = value.parse()?,
                "--log2-table" => asked.log2_table = value.parse()?,
                _ => return Err(format!("{word} is not known").into()),
            }
        }
        Ok(asked)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let asked = Arguments::read(std::env::args().skip(1))?;
    rayon::ThreadPoolBuilder::new().num_threads(asked.threads).build_global()?;
    let frames = frames::Frames::read(&asked.data)?;
    if asked.sessions { sessions::print(&frames, asked.seed) } else { fit::print(&frames, &asked) }
}

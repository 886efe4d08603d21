//! Training of a hash-grid field at known poses and exposures on sharp pictures, with the time per
//! step; the counterpart of `docs/hashgrid/reference.py` in PyTorch. With `--sessions`: held-out PSNR
//! of both kinds of map by whole sessions.
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

use frames::{Frames, HOLD_OUT};
use i2slam::config::MapKind;
use i2slam::{Config, Session};
use std::error::Error;
use std::path::PathBuf;

/// Command line arguments.
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
        let data = words.next().ok_or("missing argument: DATA")?.into();
        let (steps, rays, seed, threads, log2_table) = (1000, 1024, 0, 1, 17);
        let mut arguments = Self { data, sessions: false, steps, rays, seed, threads, log2_table };
        while let Some(word) = words.next() {
            if word == "--sessions" {
                arguments.sessions = true;
                continue;
            }
            let value = words.next().ok_or_else(|| format!("{word} needs a number"))?;
            match word.as_str() {
                "--steps" => arguments.steps = value.parse()?,
                "--rays" => arguments.rays = value.parse()?,
                "--seed" => arguments.seed = value.parse()?,
                "--threads" => arguments.threads = value.parse()?,
                "--log2-table" => arguments.log2_table = value.parse()?,
                _ => return Err(format!("unknown argument {word}").into()),
            }
        }
        Ok(arguments)
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let arguments = Arguments::read(std::env::args().skip(1))?;
    rayon::ThreadPoolBuilder::new().num_threads(arguments.threads).build_global()?;
    let frames = frames::Frames::read(&arguments.data)?;
    if arguments.sessions {
        print_sessions(&frames, arguments.seed)
    } else {
        fit::print(&frames, &arguments)
    }
}

/// Held-out PSNR of both kinds of map on the same pictures, each by a whole session.
fn print_sessions(frames: &Frames, seed: u64) -> Result<(), Box<dyn Error>> {
    for (name, kind) in [("Gaussians", MapKind::Gaussian), ("hash grid", MapKind::HashGrid)] {
        let mut config = Config { seed, ..Config::default() };
        config.map.kind = kind;
        config.mapping.hold_out = HOLD_OUT;
        let mut session = Session::new(config, frames.camera, frames.frame_rate);
        for frame in &frames.frames {
            session.process(frame)?;
        }
        session.finish(&mut |_, _| true);
        let reconstruction = session.reconstruction();
        let mut viewer = reconstruction.viewer();
        let psnr = frames.held_out(|frame| viewer.sharp(&reconstruction.frames[frame]));
        println!("{name}, by a session: held out {psnr:.2} dB");
    }
    Ok(())
}

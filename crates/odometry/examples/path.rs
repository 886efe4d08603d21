//! The camera path of a sequence from its colour pictures alone.
//!
//! `cargo run --release -p i2slam-odometry --example path -- SEQUENCE OUT.txt [FLAGS]` writes
//! `world_from_camera` poses in the TUM format. A sequence may be a video (ffmpeg decodes it),
//! whose focal length is unknown unless `--fov DEGREES` gives it. `--guess FACTOR`: the focal
//! length is taken as unknown and looked for from FACTOR times that of the sequence; `--wrong
//! FACTOR`: that value is claimed; `--lens`: its distortion is looked for too; `--scale S`:
//! pictures of S times the size; `--stride N`: every N-th picture; `--passes N`: forth and back
//! through the pictures so many times, as one long video; `--cover N`: the lens is covered for
//! twelve pictures from the N-th on; `--verbose`: the report of each.

use i2slam_dataset::{OpenOptions, Sequence, write_trajectory};
use i2slam_geometry::Camera;
use i2slam_odometry::{FrameStatus, FrontEnd, Intrinsics};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

/// Pictures for which a lens is covered.
const COVERED: usize = 12;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, out, rest @ ..] = arguments.as_slice() else {
        return Err(
            "usage: path SEQUENCE OUT.txt [--guess F | --wrong F] [--fov DEGREES] [--scale S] [--stride N] \
             [--lens] [--passes N] [--cover N] [--verbose]"
                .into(),
        );
    };
    let stride = factor(rest, "--stride")?.map_or(1, |s| s as usize);
    let options = OpenOptions {
        colour_only: true,
        guess_camera: true,
        field_of_view: factor(rest, "--fov")?,
        minimum_gap: 0.0,
        scale: factor(rest, "--scale")?.unwrap_or(1.0),
        stride,
        ..OpenOptions::default()
    };
    let sequence = Sequence::open(Path::new(folder), &options)?;
    let mut front_end = FrontEnd::new(intrinsics(&sequence, rest)?);
    let begin = Instant::now();
    let mut tracking = 0.0;
    let passes = factor(rest, "--passes")?.map_or(1, |n| n as usize);
    let covered = factor(rest, "--cover")?.map(|n| n as usize..n as usize + COVERED);
    for (i, (place, timestamp)) in order(&sequence, passes).into_iter().enumerate() {
        let mut frame = sequence.load(place)?;
        if covered.as_ref().is_some_and(|c| c.contains(&i)) {
            std::sync::Arc::make_mut(&mut frame.colour).data.fill(0.0);
        }
        let start = Instant::now();
        let report = front_end.push(&frame.colour, timestamp)?;
        tracking += start.elapsed().as_secs_f64();
        if rest.iter().any(|a| a == "--verbose") {
            println!("{i:4} {report:?}");
        }
    }
    let start = Instant::now();
    let found = front_end.finish()?;
    let mapping = start.elapsed().as_secs_f64();
    if rest.iter().any(|a| a == "--verbose") {
        for (i, status) in found.frames.iter().enumerate() {
            match status {
                FrameStatus::Posed { landmarks, .. } => println!("{i:4} posed by {landmarks}"),
                FrameStatus::Lost => println!("{i:4} lost"),
            }
        }
    }
    for warning in &found.warnings {
        println!("warning: {warning}");
    }
    println!(
        "{} of {} frames posed, {} keyframes; focal length {:.1} px (given {:.1}), deviation {:?}; readout {:.1} ms",
        found.trajectory().len(),
        found.frames.len(),
        found.keyframes.len(),
        found.camera.fx,
        sequence.camera.fx,
        found.focal_deviation,
        1e3 * found.rolling_shutter_readout,
    );
    if let Some([k1, k2]) = found.distortion {
        println!("lens distortion k1 {k1:.4}, k2 {k2:.4}");
    }
    println!(
        "tracking {:.2} s, mapping {:.2} s, with reading {:.2} s: {:.1} frames a second",
        tracking,
        mapping,
        begin.elapsed().as_secs_f64(),
        found.frames.len() as f64 / (tracking + mapping),
    );
    write_trajectory(out, &found.trajectory())?;
    Ok(())
}

/// Place and stamp of the pictures of all passes; those of later ones follow at the usual rate.
fn order(sequence: &Sequence, passes: usize) -> Vec<(usize, f64)> {
    let stamps = sequence.entries.iter().map(|entry| entry.timestamp);
    let mut out: Vec<(usize, f64)> = stamps.enumerate().collect();
    let (count, end) = (out.len(), out.last().map_or(0.0, |(_, stamp)| *stamp));
    for i in 1..=passes.saturating_sub(1) * (count - 1) {
        let (pass, step) = ((i - 1) / (count - 1), (i - 1) % (count - 1) + 1);
        let place = if pass % 2 == 0 { count - 1 - step } else { step };
        out.push((place, end + i as f64 / sequence.frame_rate));
    }
    out
}

/// The number behind a flag.
fn factor(arguments: &[String], name: &str) -> Result<Option<f64>, Box<dyn Error>> {
    let place = arguments.iter().position(|a| a == name);
    let value = place.and_then(|i| arguments.get(i + 1));
    Ok(value.map(|v| v.parse()).transpose()?)
}

fn intrinsics(sequence: &Sequence, arguments: &[String]) -> Result<Intrinsics, Box<dyn Error>> {
    let camera = sequence.camera;
    let scaled = |f: f64| Camera { fx: camera.fx * f, fy: camera.fy * f, ..camera };
    let has_lens = arguments.iter().any(|a| a == "--lens");
    Ok(match (factor(arguments, "--guess")?, factor(arguments, "--wrong")?) {
        (guess, _) if has_lens => Intrinsics::GuessWithDistortion(scaled(guess.unwrap_or(1.0))),
        (Some(f), _) => Intrinsics::Guess(scaled(f)),
        (None, Some(f)) => Intrinsics::Known(scaled(f)),
        (None, None) if sequence.camera_is_guess => Intrinsics::Guess(camera),
        (None, None) => Intrinsics::Known(camera),
    })
}

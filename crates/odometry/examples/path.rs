//! The camera path of a sequence or video from its colour pictures alone.
//!
//! `cargo run --release -p i2slam-odometry --example path -- SEQUENCE OUT.txt [--fov DEGREES]
//! [--guess FACTOR]` writes `world_from_camera` poses in the TUM format. The focal length is taken
//! from the sequence or `--fov`; it is estimated where neither gives it, or from FACTOR times that
//! of the sequence with `--guess`.

use i2slam_dataset::{OpenOptions, Sequence, write_trajectory};
use i2slam_geometry::Camera;
use i2slam_odometry::{FrontEnd, Intrinsics, Progress};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().collect();
    let [_, folder, out, flags @ ..] = arguments.as_slice() else {
        return Err("usage: path SEQUENCE OUT.txt [--fov DEGREES] [--guess FACTOR]".into());
    };
    let options = OpenOptions {
        colour_only: true,
        guess_camera: true,
        field_of_view: number(flags, "--fov")?,
        minimum_gap: 0.0,
        ..OpenOptions::default()
    };
    let sequence = Sequence::open(Path::new(folder), &options)?;
    let camera = sequence.camera;
    let mut front_end = FrontEnd::new(match number(flags, "--guess")? {
        Some(f) => Intrinsics::Guess(Camera { fx: f * camera.fx, fy: f * camera.fy, ..camera }),
        None if sequence.camera_is_guess => Intrinsics::Guess(camera),
        None => Intrinsics::Known(camera),
    });
    for frame in sequence.stream() {
        let frame = frame?;
        front_end.push(&frame.colour, frame.timestamp)?;
    }
    let found = front_end.finish(Progress::default())?;
    found.warnings.iter().for_each(|warning| println!("warning: {warning}"));
    println!(
        "{} of {} frames posed, {} keyframes; focal length {:.1} px, deviation {:?}; readout {:.1} ms",
        found.trajectory().len(),
        found.poses.len(),
        found.keyframes.len(),
        found.camera.fx,
        found.focal_deviation,
        1e3 * found.rolling_shutter_readout,
    );
    write_trajectory(out, &found.trajectory())?;
    Ok(())
}

/// The number behind a flag.
fn number(flags: &[String], name: &str) -> Result<Option<f64>, Box<dyn Error>> {
    let value = flags.iter().position(|flag| flag == name).and_then(|i| flags.get(i + 1));
    Ok(value.map(|v| v.parse()).transpose()?)
}

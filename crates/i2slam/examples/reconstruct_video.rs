//! Reconstructs a video, or a folder of pictures, by colour alone.
use i2slam::{RunError, RunOptions, RunOutcome, reconstruct};
use std::error::Error;
use std::path::Path;

fn main() -> Result<(), Box<dyn Error>> {
    let video = std::env::args().nth(1).ok_or("usage: reconstruct_video VIDEO")?;
    let outcome = reconstruct_video(video.as_ref(), &RunOptions::colour_alone())?;
    for pose in outcome.reconstruction.trajectory() {
        println!("{:.3} s  {:?}", pose.timestamp, pose.world_from_camera.translation);
    }
    println!("map: {}", outcome.reconstruction.map);
    if !outcome.shortfalls.is_empty() {
        return Err(outcome.shortfalls.join("; ").into());
    }
    Ok(())
}

pub(crate) fn reconstruct_video(path: &Path, options: &RunOptions) -> Result<RunOutcome, RunError> {
    let sequence = options.open_sequence(path)?;
    reconstruct(&sequence, options, ())
}

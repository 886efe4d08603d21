//! Frames with depth given to a session at the rate of a camera, as a robot would.
//!
//! `cargo run --release -p i2slam --example live -- SEQUENCE [FRAMES_PER_SECOND] [MAX_SIDE]` prints the
//! time from a frame to its pose, and how many frames and corrections waited for the map, each as
//! median and largest.

use i2slam::{Config, OnlineSession, RunOptions};
use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let folder = arguments.first().ok_or("usage: live SEQUENCE [FRAMES_PER_SECOND] [MAX_SIDE]")?;
    let mut options = RunOptions::with_depth();
    options.open.max_side = arguments.get(2).map(|side| side.parse()).transpose()?;
    let sequence = options.open_sequence(Path::new(folder))?;
    let rate = arguments.get(1).map_or(Ok(sequence.frame_rate), |rate| rate.parse())?;
    let mut session = OnlineSession::new(Config::default(), sequence.camera, sequence.frame_rate);
    let (mut late, mut behind) = (Vec::new(), Vec::new());
    let started = Instant::now();
    for (number, frame) in sequence.stream().enumerate() {
        let frame = frame?;
        let due = started + Duration::from_secs_f64(number as f64 / rate);
        std::thread::sleep(due.saturating_duration_since(Instant::now()));
        let update = session.push(frame)?;
        late.push(due.elapsed().as_secs_f64());
        behind.push(session.waiting_for_map() as f64);
        if update.world_from_camera.is_none() {
            println!("frame {}: {:?}", update.index, update.status);
        }
    }
    let summary = |mut values: Vec<f64>| {
        values.sort_by(f64::total_cmp);
        (values[values.len() / 2], values[values.len() - 1])
    };
    let ((late, latest), (behind, farthest)) = (summary(late), summary(behind));
    println!(
        "{} frames at {rate} a second: pose after {:.0} ms, {:.0} at most; {behind:.0} jobs waited \
         for the map, {farthest:.0} at most",
        sequence.len(),
        1e3 * late,
        1e3 * latest
    );
    let found = session.finish(&mut |_, _| true)?;
    println!(
        "{}; finished {:.1} s after the first frame",
        found.map,
        started.elapsed().as_secs_f64()
    );
    Ok(())
}

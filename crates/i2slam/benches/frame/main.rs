//! Cost of a frame: tracking and mapping by preset.
//!
//! ```sh
//! cargo bench -p i2slam --bench frame              # all tables
//! cargo bench -p i2slam --bench frame -- presets   # one of: frame, presets
//! ```

#[path = "../support/tables.rs"]
mod tables;

use i2slam::dataset::{Frame, OpenOptions, Sequence};
use i2slam::geometry::Camera;
use i2slam::{Config, FrameEstimate, Session};
use std::error::Error;
use std::path::Path;
use tables::{Outcome, Table};

const TABLES: [Table; 2] = [("frame", print_frame), ("presets", print_presets)];

fn main() -> Outcome {
    tables::print(&TABLES)
}

/// Frames in memory, and what a session needs to know of them.
struct Clip {
    frames: Vec<Frame>,
    camera: Camera<f64>,
    frame_rate: f64,
}

impl Clip {
    /// The first `count` frames of the clip inside the program, resized by `scale`.
    fn demo(count: usize, scale: f64) -> Result<Self, Box<dyn Error>> {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../cli/assets/demo"));
        let sequence = Sequence::open(folder, &OpenOptions { scale, ..OpenOptions::default() })?;
        let frames = sequence.stream().take(count).collect::<Result<_, _>>()?;
        Ok(Self { frames, camera: sequence.camera, frame_rate: sequence.frame_rate })
    }

    fn run(&self, preset: &str) -> Result<Vec<FrameEstimate>, Box<dyn Error>> {
        let mut session = Session::tracking(Config::preset(preset)?, self.camera, self.frame_rate);
        for frame in &self.frames {
            session.track(frame)?;
        }
        Ok(session.frames().to_vec())
    }
}

/// The fastest and the median of the frames after the first, which starts the map [s].
fn times(frames: &[FrameEstimate], of: impl Fn(&FrameEstimate) -> f64) -> (f64, f64) {
    let mut seconds: Vec<_> = frames.iter().skip(1).map(of).collect();
    seconds.sort_by(f64::total_cmp);
    (seconds[0], seconds[seconds.len() / 2])
}

/// Tracking and mapping of one frame by the default preset, at the clip's own size.
fn print_frame() -> Outcome {
    let clip = Clip::demo(16, 1.0)?;
    let frames = clip.run("default")?;
    println!("part,width,height,fastest_ms,median_ms");
    for mapping in [false, true] {
        let name = if mapping { "mapping" } else { "tracking" };
        let of = |f: &FrameEstimate| if mapping { f.mapping_seconds } else { f.tracking_seconds };
        let (fastest, median) = times(&frames, of);
        let Camera { width, height, .. } = clip.camera;
        println!("{name},{width},{height},{:.2},{:.2}", fastest * 1e3, median * 1e3);
        println!("time,frame/{name},{fastest:.6e}");
    }
    Ok(())
}

/// The mean of the five frames after the first: the paper's presets map every fifth [s].
fn mean(frames: &[FrameEstimate], of: impl Fn(&FrameEstimate) -> f64) -> f64 {
    frames.iter().skip(1).map(of).sum::<f64>() / (frames.len() - 1) as f64
}

/// Presets at a third of the clip's size: the paper's take minutes a frame at full size.
fn print_presets() -> Outcome {
    const PRESETS: [&str; 3] = ["default", "paper-synthetic-s", "paper-synthetic"];
    let clip = Clip::demo(6, 1.0 / 3.0)?;
    println!("preset,tracking_ms,mapping_ms,frame_ms,times_default");
    let mut first = None;
    for preset in PRESETS {
        let frames = clip.run(preset)?;
        let tracking = mean(&frames, |f| f.tracking_seconds);
        let mapping = mean(&frames, |f| f.mapping_seconds);
        let whole = tracking + mapping;
        let ratio = whole / *first.get_or_insert(whole);
        let [tracking, mapping, ms] = [tracking, mapping, whole].map(|s| s * 1e3);
        println!("{preset},{tracking:.1},{mapping:.1},{ms:.1},{ratio:.1}");
        println!("time,presets/{preset},{whole:.6e}");
    }
    Ok(())
}

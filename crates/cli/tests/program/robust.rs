//! What a camera goes through: a jump, a hand over the lens.

use crate::tools::{Scratch, number, reconstruct, run};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

/// A slow, then ever faster turn through a synthetic room: 21 degrees from frame 10 to frame 22.
const ROOM: &str = "
[camera]
frames = 34
width = 128
height = 96
sub_frames = 4
sharp_samples = 1
[light]
texel = 0.08
reflections = 0.0
[motion]
speed = 0.2
sweep = 80.0
sweep_period = 4.0
look_around = 0.0
bursts = 0.0
";

fn room(scratch: &Scratch) -> PathBuf {
    let (specification, room) = (scratch.join("room.toml"), scratch.join("room"));
    fs::write(&specification, ROOM).expect("room");
    let arguments = ["synth".as_ref(), specification.as_os_str(), "--out".as_ref(), room.as_ref()];
    run(arguments).ended_with(0);
    room
}

fn degraded(room: &Path, name: &str, how: &[&str]) -> PathBuf {
    let out = room.with_file_name(name);
    let mut arguments: Vec<&OsStr> = vec!["degrade".as_ref(), room.as_ref()];
    arguments.extend(["--out".as_ref(), out.as_os_str()]);
    arguments.extend(how.iter().map(OsStr::new));
    run(arguments).ended_with(0);
    out
}

#[test]
fn a_jump_and_a_covered_lens_are_told_and_survived() {
    let scratch = Scratch::new("robust");
    let room = room(&scratch);

    let jump = degraded(&room, "jump", &["--drop-frames", "11..22"]);
    let result = scratch.join("jump-result");
    reconstruct(&jump, &result, &["--render", "none"]).ended_with(0);
    let metrics = result.join("metrics.json");
    assert!(number(&metrics, "tracked").expect("a count") >= 21.0, "of 23 frames");
    assert!(
        number(&metrics, "ate_rmse_m").expect("metres") < 0.03,
        "{:?}",
        number(&metrics, "ate_rmse_m")
    );

    let cover = degraded(&room, "cover", &["--cover", "16..21"]);
    let result = scratch.join("cover-result");
    reconstruct(&cover, &result, &["--render", "none"])
        .ended_with(0)
        .complaining("frame 20: it has no depth");
    let metrics = result.join("metrics.json");
    assert_eq!(number(&metrics, "tracked"), Some(29.0), "of 34 frames");
    assert!(
        number(&metrics, "ate_rmse_m").expect("metres") < 0.02,
        "{:?}",
        number(&metrics, "ate_rmse_m")
    );
}

//! A camera that reads its rows one after another.

use crate::tools::{Scratch, number, run};
use std::fs;
use std::path::Path;

/// Turns of a hundred degrees a second, rows read over half of the frame interval, and depth
/// that leaves something to the pictures.
const SPEC: &str = "
[camera]
frames = 14
width = 96
height = 72
sub_frames = 8
sharp_samples = 2
readout = 0.48
[light]
texel = 0.1
[motion]
bursts = 5.0
burst_angle = 25.0
[depth]
kinect = true
[output]
hdr_every = 0
";

/// The readout of [`SPEC`] [s].
const READOUT: f64 = 0.016;

/// Sharp PSNR [dB], trajectory error [m] and readout [s] of a run.
fn metrics(data: &Path, out: &Path, settings: &str) -> [f64; 3] {
    let config = out.with_extension("toml");
    let quick = "[mapping]\niterations = 8\nfinal_iterations = 40\n";
    fs::write(&config, format!("{settings}{quick}")).expect("room");
    let words = [
        "run",
        &data.display().to_string(),
        "--out",
        &out.display().to_string(),
        "--config",
        &config.display().to_string(),
        "--quiet",
    ]
    .map(str::to_owned);
    run(words).ended_with(0);
    let figure = |key| number(&out.join("metrics.json"), key).expect(key);
    ["psnr_sharp_db", "ate_rmse_m", "rolling_shutter_readout_s"].map(figure)
}

#[test]
fn a_known_or_found_readout_makes_better_maps() {
    let scratch = Scratch::new("rolling");
    let (spec, data) = (scratch.join("spec.toml"), scratch.join("room"));
    fs::write(&spec, SPEC).expect("room");
    let words = ["synth", &spec.display().to_string(), "--seed", "7", "--out"];
    let words = words.map(str::to_owned).into_iter().chain([data.display().to_string()]);
    run(words).ended_with(0);
    let input = |text: &str| format!("[input]\n{text}\n");
    let ignored = metrics(&data, &scratch.join("ignored"), "");
    let known = input(&format!("rolling_shutter_readout = {READOUT}"));
    let known = metrics(&data, &scratch.join("known"), &known);
    let found = metrics(&data, &scratch.join("found"), &input("optimise_rolling_shutter = true"));
    println!("PSNR [dB], ATE [m], readout [s]: ignored {ignored:?}, known {known:?}");
    println!("found {found:?}, true {READOUT}");
    assert_eq!((ignored[2], known[2]), (0.0, READOUT));
    assert!(known[0] > ignored[0] + 0.5 && found[0] > ignored[0] + 0.5);
    assert!(known[1] < 0.8 * ignored[1] && found[1] < 0.9 * ignored[1]);
    // The search could end anywhere from 0 to twice the readout.
    assert!((0.5..1.6).contains(&(found[2] / READOUT)));
}

#[test]
fn exact_renders_cannot_roll() {
    let scratch = Scratch::new("rolling-exact");
    let config = scratch.join("exact.toml");
    let text = "[input]\nrolling_shutter_readout = 0.02\n[formation]\nblur_model = \"exact\"\n";
    fs::write(&config, text).expect("room");
    let (data, out) = (scratch.join("none"), scratch.join("out"));
    let paths = [data, out, config].map(|path| path.display().to_string());
    let words = ["run", &paths[0], "--out", &paths[1], "--config", &paths[2]].map(str::to_owned);
    run(words).ended_with(2).complaining("formation.blur_model").complaining("image");
}

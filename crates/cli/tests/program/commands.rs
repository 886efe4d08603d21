//! The other commands, on one small result.

use crate::program::{Ran, Scene, Scratch, reconstruct, run};
use std::ffi::OsStr;
use std::fs;
use std::path::Path;

fn result(name: &str) -> Scratch {
    let scratch = Scratch::new(name);
    Scene::default().write(&scratch.join("room"));
    reconstruct(&scratch.join("room"), &scratch.join("out"), &[]).exits_with(0);
    scratch
}

fn on(command: &str, folder: &Path, more: &[&OsStr]) -> Ran {
    run([command.as_ref(), folder.as_os_str()].into_iter().chain(more.iter().copied()))
}

#[test]
fn a_saved_result_is_drawn_again_as_it_was() {
    let scratch = result("render");
    let (out, again) = (scratch.join("out"), scratch.join("again"));
    let flags: [&OsStr; 4] =
        ["--frames".as_ref(), "2..4".as_ref(), "--out".as_ref(), again.as_ref()];
    on("render", &out, &flags).exits_with(0);
    for (kind, extension) in
        [("sharp", "png"), ("blurred", "png"), ("hdr", "exr"), ("depth", "png")]
    {
        let file = |frame: usize| format!("{kind}/{frame:06}.{extension}");
        let first = fs::read(out.join("renders").join(file(2))).expect("a render of the run");
        assert!(first == fs::read(again.join(file(2))).expect("a new render"), "{kind}");
        assert!(again.join(file(3)).is_file() && !again.join(file(4)).exists());
    }
}

#[test]
fn poses_of_ones_own_are_drawn() {
    let scratch = result("poses");
    let out = scratch.join("out");
    let pose: [&OsStr; 4] =
        ["--pose".as_ref(), "-0.01 0 0 0 0 0 1".as_ref(), "--kinds".as_ref(), "sharp,hdr".as_ref()];
    on("render", &out, &pose).exits_with(0);
    assert!(out.join("views/sharp/000000.png").is_file());
    assert!(out.join("views/hdr/000000.exr").is_file() && !out.join("views/depth").exists());
    let trajectory = out.join("trajectory.txt");
    let poses: [&OsStr; 2] = ["--poses".as_ref(), trajectory.as_ref()];
    on("render", &out, &poses).exits_with(0);
    assert!(out.join("views/depth/000005.png").is_file() && !out.join("views/blurred").exists());
}

#[test]
fn render_refuses_what_it_cannot_mean() {
    let scratch = result("refuse");
    let out = scratch.join("out");
    let refused = |flags: &[&str], word: &str| {
        let flags: Vec<&OsStr> = flags.iter().map(OsStr::new).collect();
        on("render", &out, &flags).exits_with(2).stderr_contains(word);
    };
    refused(&["--pose", "1 2 3"], "seven numbers");
    refused(&["--pose", "0 0 0 0 0 0 0"], "no pose");
    refused(&["--pose", "0 0 0 0 0 0 1", "--kinds", "blurred"], "no motion");
    refused(&["--kinds", "sharpest"], "sharpest");
    refused(&["--frames", "90..99"], "90..99");
    refused(&["--frames", "4..2"], "holds no frame");
    let nowhere = on("render", &scratch.join("nowhere"), &[]).exits_with(1);
    nowhere.stderr_contains("no such folder");
    on("render", &scratch.join("room"), &[]).exits_with(1).stderr_contains("no result of a run");
}

#[test]
fn eval_fits_the_scale_of_a_unit_that_is_unknown() {
    let scratch = result("eval-unit");
    let truth = scratch.join("room/groundtruth.txt");
    let metric = scratch.join("out/trajectory.txt");
    let text = fs::read_to_string(&metric).expect("a trajectory");
    let unknown = scratch.join("unknown.txt");
    fs::write(&unknown, text.replacen("[m]", "[unit of length unknown]", 1)).expect("room");
    let fit = |file: &Path, flags: &[&str]| {
        let mut all: Vec<&OsStr> = vec!["--groundtruth".as_ref(), truth.as_ref()];
        all.extend(flags.iter().map(OsStr::new));
        on("eval", file, &all).exits_with(0).out
    };
    assert!(fit(&metric, &[]).contains("SE(3)"));
    assert!(fit(&unknown, &[]).contains("Sim(3)"));
    assert!(fit(&unknown, &["--align", "se3"]).contains("SE(3)"));
}

#[test]
fn usage_is_checked() {
    run(["run"]).exits_with(2);
    run(["bench", "ablation", "--out", "x"]).exits_with(2).stderr_contains("i2slam-bench");
    run(["run", "data", "--out", "out", "--sharpen"]).exits_with(2).stderr_contains("--sharpen");
    let preset = ["run", "data", "--out", "out", "--preset", "fast"];
    run(preset).exits_with(2).stderr_contains("paper-tum");
    run(["run", "data", "--out", "out", "--threads", "0"]).exits_with(2);
    run(["run", "data", "--out", "out", "--virtual-cameras", "0"])
        .exits_with(2)
        .stderr_contains("virtual_cameras");
}

#[test]
fn presets_are_listed_and_printed() {
    let list = run(["presets"]).exits_with(0).out;
    for name in ["default", "paper-tum", "paper-scannet-s", "paper-synthetic"] {
        assert!(list.contains(name), "{name}");
    }
    let printed = run(["presets", "paper-synthetic"]).exits_with(0).out;
    assert!(printed.contains("[tracking]"));
    for words in ["# Adam steps per frame", "# Source: ", "`second-order`: "] {
        assert!(printed.contains(words), "{words} is not in\n{printed}");
    }
    run(["presets", "none"]).exits_with(2);
}

#[cfg(unix)]
#[test]
fn a_reader_that_goes_away_ends_nothing_badly() {
    use crate::program::program;
    use std::process::Stdio;
    let mut child = program(["presets", "default"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    drop(child.stdout.take());
    Ran::of(child.wait_with_output().expect("an end")).exits_with(0);
}

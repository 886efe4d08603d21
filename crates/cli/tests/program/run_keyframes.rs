//! Radiance fields: of imported keyframes by colour alone, and of frames with depth.

use crate::program::{Scene, Scratch, number, run, stamp};
use std::fmt::Write;
use std::fs;
use std::path::Path;

const FRAMES: usize = 8;
const QUICK_KEYFRAMES: &str = "[hashgrid]\nbound = 2.0\nlog2_table = 12\nfinest_cell = 0.02\n\
    rays = 256\nfirst_iterations = 40\niterations = 5\nfinal_iterations = 120\n";

/// The true poses, some a little off.
fn write_poses(path: &Path) {
    let mut text = String::new();
    for frame in 0..FRAMES {
        let (x, off) = (0.03 * frame as f64, 0.008 * f64::from(frame as i32 % 3 - 1));
        let z = 0.3 * x - off;
        writeln!(text, "{} {:.6} {off:.6} {z:.6} 0 0 0 1", stamp(frame), x + off).expect("memory");
    }
    fs::write(path, text).expect("room");
}

fn reconstruct_keyframes(scratch: &Scratch, out: &Path, threads: &str, more: &[&str]) {
    let config = scratch.join("quick.toml");
    fs::write(&config, QUICK_KEYFRAMES).expect("room");
    let (data, poses) = (scratch.join("room"), scratch.join("poses.txt"));
    let [data, out, config, poses] =
        [&data, out, &config, &poses].map(|path| path.to_str().expect("a name"));
    let flags = ["--rgb", "--keyframes", poses, "--config", config, "--threads", threads];
    let arguments = ["run", data, "--out", out].into_iter().chain(flags);
    let ran = run(arguments.chain(more.iter().copied())).exits_with(0);
    assert!(ran.out.contains("a hash grid of"), "{}", ran.out);
}

#[test]
fn a_trajectory_and_pictures_become_a_field() {
    let scratch = Scratch::new("keyframed");
    let (data, a, b) = (scratch.join("room"), scratch.join("a"), scratch.join("b"));
    Scene { frames: FRAMES, step: 0.03, ..Scene::default() }.write(&data);
    write_poses(&scratch.join("poses.txt"));
    // Depth is not looked at.
    fs::remove_dir_all(data.join("depth")).expect("a folder");
    fs::remove_file(data.join("depth.txt")).expect("a list");
    reconstruct_keyframes(&scratch, &a, "1", &[]);
    reconstruct_keyframes(&scratch, &b, "2", &["--render", "none"]);
    for file in ["map.i2slam", "trajectory_shutter.txt", "state.json"] {
        let same = fs::read(a.join(file)).expect(file) == fs::read(b.join(file)).expect(file);
        assert!(same, "{file} depends on the number of threads");
    }
    let metrics = a.join("metrics.json");
    assert_eq!(number(&metrics, "keyframes"), Some(FRAMES as f64));
    assert!(fs::read_to_string(&metrics).expect("figures").contains("\"ate_scale_aligned\": true"));
    let error = number(&metrics, "ate_rmse_m").expect("a truth");
    let psnr = number(&metrics, "psnr_blurred_db").expect("pictures");
    eprintln!("{error} m, {psnr} dB");
    assert!(error < 0.011 && psnr > 20.0, "{error} m, {psnr} dB");
    assert!(a.join("report.html").is_file() && a.join("renders/depth/000003.png").is_file());
    run(["eval", a.to_str().expect("a name")]).exits_with(0);
}

#[test]
fn keyframes_that_are_held_out_are_found_in_the_map() {
    let scratch = Scratch::new("keyframed-held-out");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: FRAMES, step: 0.03, ..Scene::default() }.write(&data);
    write_poses(&scratch.join("poses.txt"));
    reconstruct_keyframes(&scratch, &out, "2", &["--hold-out", "3"]);
    let metrics = out.join("metrics.json");
    assert_eq!(number(&metrics, "frames"), Some(FRAMES as f64));
    assert_eq!(number(&metrics, "keyframes"), Some(FRAMES as f64 - 2.0));
    let judged = run(["eval", out.to_str().expect("a name"), "--protocol", "held-out"]);
    let judged = judged.exits_with(0).out;
    let frames = judged.lines().find(|line| line.starts_with("frames evaluated")).expect("a row");
    assert_eq!(frames.split_whitespace().last(), Some("2"), "{judged}");
}

#[test]
fn depth_pictures_can_be_taken_along() {
    let scratch = Scratch::new("keyframed-depth");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: FRAMES, step: 0.03, ..Scene::default() }.write(&data);
    write_poses(&scratch.join("poses.txt"));
    let more = ["--keyframe-depth", "pictures", "--render", "none"];
    let off = ["--no-blur", "--no-tone", "--no-trajectory-loss"];
    reconstruct_keyframes(&scratch, &out, "2", &[more.as_slice(), &off].concat());
    let frames = fs::read_to_string(out.join("frames.csv")).expect("a table");
    let column = frames.lines().next().expect("names").split(',').position(|n| n == "loss_depth");
    let last = frames.lines().last().expect("a row").split(',').nth(column.expect("a column"));
    let loss: f64 = last.expect("a cell").parse().expect("a number");
    assert!(loss > 0.0 && loss < 0.5, "{loss}");
}

#[test]
fn what_goes_with_what_is_told() {
    let scratch = Scratch::new("keyframed-usage");
    let out = scratch.join("out");
    let out = out.to_str().expect("a name");
    let refused = |more: &[&str], text: &str| {
        let arguments = ["run", "data", "--out", out].into_iter().chain(more.iter().copied());
        run(arguments).exits_with(2).stderr_contains(text);
    };
    refused(&["--keyframes", "poses.txt"], "--rgb");
    refused(&["--rgb", "--keyframes", "p", "--preset", "paper-tum"], "is for RGB-D");
    refused(&["--preset", "paper-rgb"], "add --rgb");
}

#[test]
fn pictures_without_a_path_say_why() {
    let scratch = Scratch::new("keyframed-native");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 3, step: 0.03, ..Scene::default() }.write(&data);
    let [data, out] = [&data, &out].map(|path| path.to_str().expect("a name"));
    let ran = run(["run", data, "--out", out, "--rgb"]).exits_with(1);
    ran.stderr_contains("no path of the camera was found")
        .stderr_contains("48x36 pixels is too small");
}

const QUICK_FIELD: &str = "[hashgrid]\nlog2_table = 12\nfinest_cell = 0.02\nrays = 256\n\
    first_iterations = 120\niterations = 12\nfinal_iterations = 30\n";

fn reconstruct_field(data: &Path, out: &Path, threads: &str) {
    let config = out.with_extension("toml");
    fs::write(&config, QUICK_FIELD).expect("room");
    let [data, out, config] = [data, out, &config].map(|path| path.to_str().expect("a name"));
    let flags = ["--map", "hashgrid", "--config", config, "--threads", threads];
    let arguments = ["run", data, "--out", out].into_iter().chain(flags);
    let ran = run(arguments).exits_with(0);
    assert!(ran.out.contains("a hash grid of"), "{}", ran.out);
}

#[test]
fn a_field_is_saved_drawn_again_and_judged() {
    let scratch = Scratch::new("field");
    let (data, a, b) = (scratch.join("room"), scratch.join("a"), scratch.join("b"));
    Scene { frames: 4, ..Scene::default() }.write(&data);
    reconstruct_field(&data, &a, "1");
    reconstruct_field(&data, &b, "2");
    for file in ["map.i2slam", "trajectory_shutter.txt", "state.json"] {
        let same = fs::read(a.join(file)).expect(file) == fs::read(b.join(file)).expect(file);
        assert!(same, "{file} depends on the number of threads");
    }
    assert!(a.join("map.i2slam").is_file() && !a.join("map.ply").exists());
    let page = fs::read_to_string(a.join("report.html")).expect("a report");
    assert!(page.contains("<code>map.i2slam</code>") && !page.contains("<code>map.ply</code>"));
    let metrics = a.join("metrics.json");
    assert_eq!(
        (number(&metrics, "tracked"), number(&metrics, "gaussians")),
        (Some(4.0), Some(0.0))
    );
    assert!(number(&metrics, "ate_rmse_m").is_some_and(|error| error < 0.01));
    assert!(number(&metrics, "psnr_blurred_db").is_some_and(|psnr| psnr > 20.0));
    let again = scratch.join("again");
    let [a_name, again_name] = [&a, &again].map(|path| path.to_str().expect("a name"));
    run(["render", a_name, "--out", again_name]).exits_with(0);
    for file in ["sharp/000003.png", "blurred/000003.png", "depth/000003.png", "hdr/000003.exr"] {
        let first = fs::read(a.join("renders").join(file)).expect(file);
        assert!(first == fs::read(again.join(file)).expect(file), "{file}");
    }
    let truth = data.to_str().expect("a name");
    run(["eval", a_name, "--reference", truth]).exits_with(0);
}

//! `i2slam run` with depth: damaged input, jumps and covered lenses, rolling shutters.

use crate::program::{
    HEIGHT, Ran, Scene, Scratch, WIDTH, number, reconstruct, rows, run, stamp, write_colour,
    write_depth,
};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

/// A sequence changed by `damage`, reconstructed; the number of poses written.
fn damaged(name: &str, scene: Scene, damage: impl FnOnce(&Path)) -> (Ran, usize) {
    let scratch = Scratch::new(name);
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    scene.write(&data);
    damage(&data);
    let ran = reconstruct(&data, &out, &["--render", "none"]).exits_with(0);
    assert!(out.join("map.i2slam").is_file() && out.join("report.html").is_file());
    let poses = rows(&out.join("trajectory.txt"));
    (ran, poses)
}

fn colour(data: &Path, frame: usize) -> PathBuf {
    data.join(format!("rgb/{}.png", stamp(frame)))
}

fn depth(data: &Path, frame: usize) -> PathBuf {
    data.join(format!("depth/{}.png", stamp(frame)))
}

#[test]
fn a_wrong_depth_scale_is_suspected() {
    let scene = Scene { declared_units: 100.0, frames: 3, ..Scene::default() };
    let (ran, poses) = damaged("scale", scene, |_| ());
    ran.stderr_contains("wrong depth scale?");
    assert_eq!(poses, 3);
}

#[test]
fn a_folder_without_a_sequence_is_named_and_nothing_is_written() {
    let scratch = Scratch::new("missing");
    fs::create_dir(scratch.join("empty")).expect("a folder");
    for (folder, text) in [("nowhere", "nowhere"), ("empty", "rgb.txt")] {
        let ran = reconstruct(&scratch.join(folder), &scratch.join("out"), &[]).exits_with(1);
        ran.stderr_contains(text);
        assert!(!scratch.join("out").exists());
    }
}

fn edit(path: &Path, change: impl FnOnce(String) -> String) {
    let text = fs::read_to_string(path).expect("a text file");
    fs::write(path, change(text)).expect("room");
}

/// Damages of the default scene, words of the warning, and the number of poses that remain of 6:
/// unreadable frames are left out, those without depth or light keep a predicted pose.
#[test]
fn damaged_frames_are_left_out_or_carried_over() {
    type Damage = fn(&Path);
    let cases: [(&str, Damage, &[&str], usize); 7] = [
        (
            "truncated",
            |data| {
                let bytes = fs::read(colour(data, 3)).expect("a picture");
                fs::write(colour(data, 3), &bytes[..bytes.len() / 2]).expect("room");
            },
            &["frame left out", "100.120000"],
            5,
        ),
        (
            "partner",
            |data| {
                edit(&data.join("depth.txt"), |list| {
                    let kept = list.lines().filter(|line| !line.starts_with(&stamp(5)));
                    kept.chain(["107.0 depth/none.png"]).collect::<Vec<_>>().join("\n")
                });
                edit(&data.join("rgb.txt"), |list| {
                    list.replace(&format!("{} ", stamp(5)), "103.0 ")
                });
            },
            &["1 colour image left out: no depth image"],
            5,
        ),
        (
            "size",
            |data| write_colour(&colour(data, 2), (24, 18), &[90; 24 * 18 * 3]),
            &["24x18"],
            5,
        ),
        (
            "nan",
            |data| {
                edit(&data.join("groundtruth.txt"), |text| {
                    text.replacen(" 0 0 0 1", " 0 nan 0 1", 1)
                });
            },
            &["ground truth ignored", "groundtruth.txt"],
            6,
        ),
        (
            "no-depth",
            |data| write_depth(&depth(data, 2), &[0; WIDTH * HEIGHT]),
            &["frame 2", "depth"],
            6,
        ),
        (
            "no-first-depth",
            |data| write_depth(&depth(data, 0), &[0; WIDTH * HEIGHT]),
            &["frame 0", "depth"],
            6,
        ),
        (
            "black",
            |data| write_colour(&colour(data, 3), (WIDTH, HEIGHT), &[0; WIDTH * HEIGHT * 3]),
            &["frame 3", "black"],
            6,
        ),
    ];
    for (name, damage, texts, due) in cases {
        let (mut ran, poses) = damaged(name, Scene::default(), damage);
        for text in texts {
            ran = ran.stderr_contains(text);
        }
        assert_eq!(poses, due, "{name}");
    }
}

#[test]
fn no_usable_image_at_all_is_an_error() {
    let scratch = Scratch::new("unusable");
    let data = scratch.join("room");
    Scene { frames: 3, ..Scene::default() }.write(&data);
    for frame in 0..3 {
        fs::write(depth(&data, frame), b"no picture").expect("room");
    }
    let ran = reconstruct(&data, &scratch.join("out"), &[]).exits_with(1);
    ran.stderr_contains("none of the 3 frames could be used");
}

#[test]
fn an_unknown_setting_is_named() {
    let scratch = Scratch::new("setting");
    let data = scratch.join("room");
    Scene { frames: 2, ..Scene::default() }.write(&data);
    let file = scratch.join("mine.toml");
    fs::write(&file, "[tracking]\niteratons = 3\n").expect("room");
    let arguments = ["run".as_ref(), data.as_os_str(), "--config".as_ref(), file.as_os_str()];
    let out = scratch.join("out");
    let out = ["--out".as_ref(), out.as_os_str()];
    let ran = run(arguments.into_iter().chain(out)).exits_with(2);
    ran.stderr_contains("iteratons").stderr_contains("mine.toml, line 2");
    fs::write(&file, "seed = 2\n[mapping]\nwindow = 0\n").expect("room");
    let head = ["run".as_ref(), data.as_os_str(), "--config".as_ref(), file.as_os_str()];
    let ran = run(head.into_iter().chain(out)).exits_with(2);
    ran.stderr_contains("mine.toml, line 3: mapping.window = 0");
}

#[test]
fn a_result_folder_that_cannot_be_written_is_found_out_at_once() {
    let scratch = Scratch::new("unwritable");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 2, ..Scene::default() }.write(&data);
    fs::write(&out, b"a file").expect("room");
    reconstruct(&data, &out, &[]).exits_with(2).stderr_contains("out is a file");
    let below = out.join("deeper");
    let arguments = ["run".as_ref(), data.as_os_str(), "--out".as_ref(), below.as_os_str()];
    run(arguments).exits_with(1).stderr_contains("cannot write");
}

#[test]
fn a_camera_that_stands_still_stays_where_it_is() {
    let scratch = Scratch::new("still");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { step: 0.0, ..Scene::default() }.write(&data);
    let ran = reconstruct(&data, &out, &["--render", "none"]).exits_with(0);
    ran.stderr_contains("trajectory error not measured");
    assert_eq!(number(&out.join("metrics.json"), "tracked"), Some(6.0));
    let text = fs::read_to_string(out.join("trajectory.txt")).expect("poses");
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let numbers: Vec<f64> = line.split(' ').map(|n| n.parse().expect("a number")).collect();
        assert!(numbers[1..4].iter().all(|t| t.abs() < 0.005), "{line}");
    }
}

#[cfg(unix)]
#[test]
fn a_file_that_cannot_be_finished_does_not_lose_the_others() {
    let scratch = Scratch::new("limit");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene::default().write(&data);
    // No file may grow beyond 32 blocks of 512 bytes: the map does not fit.
    let limited = "trap '' XFSZ; ulimit -f 32; exec \"$0\" run \"$1\" --out \"$2\"";
    let program = env!("CARGO_BIN_EXE_i2slam").as_ref();
    let arguments = ["-c".as_ref(), limited.as_ref(), program, data.as_os_str(), out.as_os_str()];
    let output = std::process::Command::new("sh").args(arguments).output().expect("a shell");
    let ran = Ran::of(output).exits_with(1);
    ran.stderr_contains("cannot write").stderr_contains("map.i2slam");
    assert_eq!(rows(&out.join("trajectory.txt")), 6);
    assert!(out.join("metrics.json").is_file() && out.join("renders/sharp/000005.png").is_file());
    assert!(!out.join("map.i2slam").exists() && !out.join(".map.i2slam.partial").exists());
}

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
    run(arguments).exits_with(0);
    room
}

fn degraded(room: &Path, name: &str, how: &[&str]) -> PathBuf {
    let out = room.with_file_name(name);
    let mut arguments: Vec<&OsStr> = vec!["degrade".as_ref(), room.as_ref()];
    arguments.extend(["--out".as_ref(), out.as_os_str()]);
    arguments.extend(how.iter().map(OsStr::new));
    run(arguments).exits_with(0);
    out
}

#[test]
fn a_jump_and_a_covered_lens_are_told_and_survived() {
    let scratch = Scratch::new("robust");
    let room = room(&scratch);

    let jump = degraded(&room, "jump", &["--drop-frames", "11..22"]);
    let result = scratch.join("jump-result");
    reconstruct(&jump, &result, &["--render", "none"]).exits_with(0);
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
        .exits_with(0)
        .stderr_contains("frame 20: it has no depth");
    let metrics = result.join("metrics.json");
    assert_eq!(number(&metrics, "tracked"), Some(29.0), "of 34 frames");
    assert!(
        number(&metrics, "ate_rmse_m").expect("metres") < 0.02,
        "{:?}",
        number(&metrics, "ate_rmse_m")
    );
}

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
fn rolling_metrics(data: &Path, out: &Path, settings: &str) -> [f64; 3] {
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
    run(words).exits_with(0);
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
    run(words).exits_with(0);
    let input = |text: &str| format!("[input]\n{text}\n");
    let ignored = rolling_metrics(&data, &scratch.join("ignored"), "");
    let known = input(&format!("rolling_shutter_readout = {READOUT}"));
    let known = rolling_metrics(&data, &scratch.join("known"), &known);
    let found =
        rolling_metrics(&data, &scratch.join("found"), &input("optimise_rolling_shutter = true"));
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
    run(words).exits_with(2).stderr_contains("formation.blur_model").stderr_contains("image");
}

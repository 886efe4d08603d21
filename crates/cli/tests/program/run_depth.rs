//! `i2slam run` with depth: damaged input, jumps and covered lenses, rolling shutters.

use crate::program::{
    HEIGHT, Ran, Room, Scene, TemporaryFolder, WIDTH, i2slam, number, reconstruct, rows, stamp,
    write_colour, write_depth,
};
use std::fs;
use std::path::{Path, PathBuf};

/// A sequence changed by `damage`, reconstructed; the number of poses written.
fn damaged(name: &str, scene: Scene, damage: impl FnOnce(&Path)) -> (Ran, usize) {
    let room = Room::new(name, scene);
    damage(&room.data);
    let ran = room.run(&["--render", "none"]).exits_with(0);
    assert!(room.has("map.i2slam") && room.has("report.html"));
    (ran, rows(&room.out.join("trajectory.txt")))
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
fn an_assumed_depth_scale_stays_with_the_result() {
    let room = Room::new("assumed", Scene { frames: 3, ..Scene::default() });
    let path = room.scratch.join("path.csv");
    let export = || i2slam!("export", room.out, "--format", "csv", "--out", path, "--overwrite");
    room.run(&["--render", "none"]).exits_with(0);
    assert_eq!(number(&room.out.join("metrics.json"), "depth_scale_assumed"), None);
    assert!(!export().exits_with(0).out.contains("as was assumed"));
    for list in ["rgb.txt", "depth.txt"] {
        fs::remove_file(room.data.join(list)).expect("a list");
    }
    edit(&room.data.join("camera.json"), |camera| {
        camera.replace("\"depth_scale\"", "\"of_depth\"")
    });
    let ran = room.run(&["--render", "none", "--overwrite"]).exits_with(0);
    ran.stderr_contains("the depth scale is not given: 5000 is taken for one metre");
    assert_eq!(number(&room.out.join("metrics.json"), "depth_scale_assumed"), Some(5000.0));
    let out = export().exits_with(0).out;
    assert!(
        out.contains("in metres if 5000 in the depth pictures is one, as was assumed"),
        "{out}"
    );
    let report = fs::read_to_string(room.out.join("report.html")).expect("a report");
    assert!(report.contains("Lengths hold if 5000 in the depth pictures is one metre"));
}

#[test]
fn a_folder_without_a_sequence_is_named_and_nothing_is_written() {
    let scratch = TemporaryFolder::new("missing");
    fs::create_dir(scratch.join("empty")).expect("a folder");
    for (folder, text) in [("nowhere", "nowhere"), ("empty", "rgb.txt")] {
        let ran = reconstruct(&scratch.join(folder), &scratch.join("out"), &[]).exits_with(2);
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
            &["1 frame left out: no ground-truth pose"],
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
    let room = Room::new("unusable", Scene { frames: 3, ..Scene::default() });
    for frame in 0..3 {
        fs::write(depth(&room.data, frame), b"no picture").expect("room");
    }
    room.run(&[]).exits_with(1).stderr_contains("none of the 3 frames could be used");
}

#[test]
fn settings_and_folders_that_cannot_be_used_are_named() {
    let room = Room::new("setting", Scene { frames: 2, ..Scene::default() });
    let file = room.scratch.join("mine.toml");
    for (text, words) in [
        ("[tracking]\niteratons = 3\n", ["iteratons", "mine.toml, line 2"]),
        ("seed = 2\n[mapping]\nwindow = 0\n", ["mine.toml, line 3", "mapping.window = 0"]),
        (
            "[input]\nrolling_shutter_readout = 0.02\n[formation]\nblur_model = \"exact\"\n",
            ["formation.blur_model", "image"],
        ),
    ] {
        fs::write(&file, text).expect("room");
        let ran = i2slam!("run", room.data, "--out", room.out, "--config", file).exits_with(2);
        words.into_iter().fold(ran, |ran, word| ran.stderr_contains(word));
    }
    fs::write(&room.out, b"a file").expect("room");
    room.run(&[]).exits_with(2).stderr_contains("out is a file");
    let below = i2slam!("run", room.data, "--out", room.out.join("deeper")).exits_with(1);
    below.stderr_contains("cannot write");
}

#[test]
fn a_camera_that_stands_still_stays_where_it_is() {
    let room = Room::new("still", Scene { step: 0.0, ..Scene::default() });
    let ran = room.run(&["--render", "none"]).exits_with(0);
    ran.stderr_contains("trajectory error not measured");
    assert_eq!(room.metric("tracked"), Some(6.0));
    let text = room.text("trajectory.txt");
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let numbers: Vec<f64> = line.split(' ').map(|n| n.parse().expect("a number")).collect();
        assert!(numbers[1..4].iter().all(|t| t.abs() < 0.005), "{line}");
    }
}

#[cfg(unix)]
#[test]
fn a_file_that_cannot_be_finished_does_not_lose_the_others() {
    let room = Room::new("limit", Scene::default());
    // No file may grow beyond 32 blocks of 512 bytes: the map does not fit.
    let limited = "trap '' XFSZ; ulimit -f 32; exec \"$0\" run \"$1\" --out \"$2\"";
    let mut shell = std::process::Command::new("sh");
    shell.args(["-c", limited, env!("CARGO_BIN_EXE_i2slam")]).args([&room.data, &room.out]);
    let ran = Ran::of(&mut shell).exits_with(1);
    ran.stderr_contains("cannot write").stderr_contains("map.i2slam");
    assert_eq!(rows(&room.out.join("trajectory.txt")), 6);
    assert!(room.has("metrics.json") && room.has("renders/sharp/000005.png"));
    assert!(!room.has("map.i2slam") && !room.has(".map.i2slam.partial"));
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

/// A quick run of the room made worse in one way; tracked frames and trajectory error [m].
fn degraded(room: &Path, name: &str, how: &[&str]) -> (Ran, f64, f64) {
    let (data, result) = (room.with_file_name(name), room.with_file_name("result"));
    i2slam!("degrade", room, "--out", data; how).exits_with(0);
    let ran = reconstruct(&data, &result, &["--render", "none", "--overwrite"]).exits_with(0);
    let metric = |key| number(&result.join("metrics.json"), key).expect(key);
    (ran, metric("tracked"), metric("ate_rmse_m"))
}

#[test]
fn a_jump_and_a_covered_lens_are_told_and_survived() {
    let scratch = TemporaryFolder::new("robust");
    let (specification, room) = (scratch.join("room.toml"), scratch.join("room"));
    fs::write(&specification, ROOM).expect("room");
    i2slam!("synth", specification, "--out", room).exits_with(0);
    let (_, tracked, error) = degraded(&room, "jump", &["--drop-frames", "11..22"]);
    assert!(tracked >= 21.0 && error < 0.03, "{tracked} of 23 frames, {error} m");
    let (ran, tracked, error) = degraded(&room, "cover", &["--cover", "16..21"]);
    ran.stderr_contains("frames 16 to 20 are black or of one colour");
    assert!(tracked == 29.0 && error < 0.02, "{tracked} of 34 frames, {error} m");
    // A camera without signal: one grey, and depth as ever.
    for frame in 16..21 {
        let picture = room.join(format!("rgb/{frame:06}.png"));
        write_colour(&picture, (128, 96), &[119; 128 * 96 * 3]);
    }
    let (ran, tracked, error) = degraded(&room, "grey", &[]);
    ran.stderr_contains("frames 16 to 20 are black or of one colour");
    assert!(tracked >= 28.0 && error < 0.02, "{tracked} of 34 frames, {error} m");
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
    i2slam!("run", data, "--out", out, "--config", config, "--quiet").exits_with(0);
    let figure = |key| number(&out.join("metrics.json"), key).expect(key);
    ["psnr_sharp_db", "ate_rmse_m", "rolling_shutter_readout_s"].map(figure)
}

#[test]
fn a_rolling_shutter_is_found_without_a_setting() {
    let scratch = TemporaryFolder::new("rolling");
    let (spec, data) = (scratch.join("spec.toml"), scratch.join("room"));
    fs::write(&spec, SPEC).expect("room");
    i2slam!("synth", spec, "--seed", "7", "--out", data).exits_with(0);
    let [psnr, error, readout] = rolling_metrics(&data, &scratch.join("found"), "");
    let known = format!("[input]\nrolling_shutter_readout = {READOUT}\n");
    let known = rolling_metrics(&data, &scratch.join("known"), &known);
    println!("PSNR [dB], ATE [m], readout [s]: {psnr} {error} {readout}, known {known:?}");
    assert!((readout / READOUT - 1.0).abs() < 0.25, "{readout}");
    assert!(known[2] == READOUT && psnr > known[0] - 1.0 && error < known[1] + 0.005);
}

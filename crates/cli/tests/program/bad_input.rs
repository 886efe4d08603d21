//! Everything that can be wrong with what is given: a clear message, and no lost work.

use crate::scene::{HEIGHT, Scene, WIDTH, stamp, write_colour, write_depth};
use crate::tools::{Ran, Scratch, number, reconstruct, rows};
use std::fs;
use std::path::Path;

/// A sequence changed by `damage`, reconstructed; the number of poses written.
fn damaged(name: &str, scene: Scene, damage: impl FnOnce(&Path)) -> (Ran, usize) {
    let scratch = Scratch::new(name);
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    scene.write(&data);
    damage(&data);
    let ran = reconstruct(&data, &out, &["--render", "none"]).ended_with(0);
    assert!(out.join("map.i2slam").is_file() && out.join("report.html").is_file());
    let poses = rows(&out.join("trajectory.txt"));
    (ran, poses)
}

fn colour(data: &Path, frame: usize) -> std::path::PathBuf {
    data.join(format!("rgb/{}.png", stamp(frame)))
}

fn depth(data: &Path, frame: usize) -> std::path::PathBuf {
    data.join(format!("depth/{}.png", stamp(frame)))
}

#[test]
fn a_missing_folder_is_named() {
    let scratch = Scratch::new("missing");
    let ran = reconstruct(&scratch.join("nowhere"), &scratch.join("out"), &[]).ended_with(1);
    ran.complaining("nowhere");
    assert!(!scratch.join("out").exists(), "nothing is written for a run that cannot begin");
}

#[test]
fn an_empty_folder_says_what_was_expected() {
    let scratch = Scratch::new("empty");
    fs::create_dir(scratch.join("room")).expect("a folder");
    let ran = reconstruct(&scratch.join("room"), &scratch.join("out"), &[]).ended_with(1);
    ran.complaining("rgb.txt");
}

#[test]
fn a_wrong_depth_scale_is_suspected() {
    let scene = Scene { declared_units: 100.0, frames: 3, ..Scene::default() };
    let (ran, poses) = damaged("scale", scene, |_| ());
    ran.complaining("wrong depth scale?");
    assert_eq!(poses, 3);
}

#[test]
fn a_truncated_image_is_left_out() {
    let (ran, poses) = damaged("truncated", Scene::default(), |data| {
        let path = colour(data, 3);
        let bytes = fs::read(&path).expect("a picture");
        fs::write(&path, &bytes[..bytes.len() / 2]).expect("room");
    });
    ran.complaining("frame left out").complaining(&stamp(3));
    assert_eq!(poses, 5);
}

#[test]
fn a_frame_without_partner_is_left_out() {
    let (ran, poses) = damaged("partner", Scene::default(), |data| {
        let path = data.join("depth.txt");
        let list = fs::read_to_string(&path).expect("a list");
        let without: Vec<&str> = list.lines().filter(|l| !l.starts_with(&stamp(5))).collect();
        let late = "107.0 depth/none.png".to_owned();
        fs::write(&path, without.join("\n") + "\n" + &late).expect("room");
        let colours = data.join("rgb.txt");
        let list = fs::read_to_string(&colours).expect("a list");
        fs::write(&colours, list.replace(&format!("{} ", stamp(5)), "103.0 ")).expect("room");
    });
    ran.complaining("1 colour image left out: no depth image");
    assert_eq!(poses, 5);
}

#[test]
fn a_nan_pose_in_the_truth_is_named_and_the_run_goes_on() {
    let (ran, poses) = damaged("nan", Scene::default(), |data| {
        let path = data.join("groundtruth.txt");
        let text = fs::read_to_string(&path).expect("poses");
        fs::write(&path, text.replacen(" 0 0 0 1", " 0 nan 0 1", 1)).expect("room");
    });
    ran.complaining("ground truth ignored").complaining("groundtruth.txt");
    assert_eq!(poses, 6);
}

#[test]
fn an_image_of_another_size_is_left_out() {
    let (ran, poses) = damaged("size", Scene::default(), |data| {
        write_colour(&colour(data, 2), (24, 18), &[90; 24 * 18 * 3]);
    });
    ran.complaining("24x18");
    assert_eq!(poses, 5);
}

#[test]
fn no_usable_image_at_all_is_an_error() {
    let scratch = Scratch::new("unusable");
    let data = scratch.join("room");
    Scene { frames: 3, ..Scene::default() }.write(&data);
    for frame in 0..3 {
        fs::write(depth(&data, frame), b"no picture").expect("room");
    }
    let ran = reconstruct(&data, &scratch.join("out"), &[]).ended_with(1);
    ran.complaining("none of the 3 frames could be used");
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
    let ran = crate::tools::run(arguments.into_iter().chain(out)).ended_with(2);
    ran.complaining("iteratons").complaining("mine.toml, line 2");
    fs::write(&file, "seed = 2\n[mapping]\nwindow = 0\n").expect("room");
    let head = ["run".as_ref(), data.as_os_str(), "--config".as_ref(), file.as_os_str()];
    let ran = crate::tools::run(head.into_iter().chain(out)).ended_with(2);
    ran.complaining("mine.toml, line 3: mapping.window = 0");
}

#[test]
fn a_result_folder_that_cannot_be_written_is_found_out_at_once() {
    let scratch = Scratch::new("unwritable");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 2, ..Scene::default() }.write(&data);
    fs::write(&out, b"a file").expect("room");
    reconstruct(&data, &out, &[]).ended_with(2).complaining("out is a file");
    let below = out.join("deeper");
    let arguments = ["run".as_ref(), data.as_os_str(), "--out".as_ref(), below.as_os_str()];
    crate::tools::run(arguments).ended_with(1).complaining("cannot write");
}

#[test]
fn a_frame_without_depth_is_carried_over() {
    let (ran, poses) = damaged("no-depth", Scene::default(), |data| {
        write_depth(&depth(data, 2), &[0; WIDTH * HEIGHT]);
    });
    ran.complaining("frame 2").complaining("depth");
    assert_eq!(poses, 6);
}

#[test]
fn a_black_frame_is_carried_over() {
    let (ran, poses) = damaged("black", Scene::default(), |data| {
        write_colour(&colour(data, 3), (WIDTH, HEIGHT), &[0; WIDTH * HEIGHT * 3]);
    });
    ran.complaining("frame 3").complaining("black");
    assert_eq!(poses, 6);
}

#[test]
fn a_first_frame_without_depth_is_no_end() {
    let (_, poses) = damaged("no-first", Scene::default(), |data| {
        write_depth(&depth(data, 0), &[0; WIDTH * HEIGHT]);
    });
    assert_eq!(poses, 6);
}

#[test]
fn a_camera_that_stands_still_stays_where_it_is() {
    let scratch = Scratch::new("still");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { step: 0.0, ..Scene::default() }.write(&data);
    let ran = reconstruct(&data, &out, &["--render", "none"]).ended_with(0);
    ran.complaining("trajectory error not measured");
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
    let ran = Ran::of(output).ended_with(1);
    ran.complaining("cannot write").complaining("map.i2slam");
    assert_eq!(rows(&out.join("trajectory.txt")), 6);
    assert!(out.join("metrics.json").is_file() && out.join("renders/sharp/000005.png").is_file());
    assert!(!out.join("map.i2slam").exists() && !out.join(".map.i2slam.partial").exists());
}

//! `i2slam eval` on pictures and trajectories of its own, and its errors.

use crate::program::{Ran, Room, Scene, TemporaryFolder, i2slam, json, write_colour};
use std::fs;
use std::path::{Path, PathBuf};

const SIDE: (usize, usize) = (40, 34);

/// A PNG whose values follow a wave; `shift` makes another picture of it, no wave a black one.
fn write_png(path: &Path, (width, height): (usize, usize), wave: Option<f64>) {
    let value = |i: usize| {
        let (x, y) = ((i / 3 % width) as f64, (i / 3 / width) as f64);
        wave.map_or(0, |shift| (127.0 + 90.0 * (0.7 * x + shift).sin() * (0.4 * y).cos()) as u8)
    };
    let data: Vec<u8> = (0..3 * width * height).map(value).collect();
    write_colour(path, (width, height), &data);
}

fn picture(frame: u32) -> String {
    format!("{frame:06}.png")
}

/// Folders `ours` and `theirs` with as many pictures.
fn folders(name: &str, shift: f64) -> (TemporaryFolder, PathBuf, PathBuf) {
    let scratch = TemporaryFolder::new(name);
    let (ours, theirs) = (scratch.join("ours"), scratch.join("theirs"));
    for (folder, shift) in [(&ours, shift), (&theirs, 0.0)] {
        fs::create_dir(folder).expect("a folder");
        for frame in 0..3 {
            write_png(&folder.join(picture(frame)), SIDE, Some(shift + f64::from(frame)));
        }
    }
    (scratch, ours, theirs)
}

fn against(ours: &Path, theirs: &Path, more: &[&str]) -> Ran {
    i2slam!("eval", ours, "--reference", theirs; more)
}

#[test]
fn two_folders_of_pictures_are_compared() {
    let (scratch, ours, theirs) = folders("eval-folders", 0.02);
    let table = against(&ours, &theirs, &[]).exits_with(0).out;
    for word in ["sharp PSNR", "sharp SSIM", "LPIPS", "frames evaluated"] {
        assert!(table.contains(word), "{table}");
    }
    let figures = json(&against(&ours, &theirs, &["--json"]));
    let of = |key: &str| figures[key].as_f64();
    assert!(of("psnr_sharp_db").is_some_and(|v| (35.0..50.0).contains(&v)), "{figures}");
    assert!(of("ssim_sharp").is_some_and(|v| v > 0.98), "{figures}");
    assert!(of("lpips_sharp").is_some_and(|v| (0.0..0.05).contains(&v)), "{figures}");
    assert!(of("ms_ssim_sharp").is_none(), "too small for five scales");
    assert_eq!(figures["sharp_frames"].as_u64(), Some(3));
    assert_eq!(figures["frames"][2]["index"].as_u64(), Some(2));

    // A missing frame is named, and no mean hides it.
    fs::remove_file(ours.join(picture(1))).expect("a picture");
    let missing = against(&ours, &theirs, &[]).exits_with(1);
    missing.stderr_contains("000001").stderr_contains("--partial");
    let partial = json(&against(&ours, &theirs, &["--partial", "--json"]));
    assert_eq!(partial["missing_frames"], serde_json::json!([1]));
    // A true picture less is no fault of the renders.
    fs::remove_file(theirs.join(picture(1))).expect("a picture");
    let fewer = json(&against(&ours, &theirs, &["--json"]));
    assert_eq!(fewer["sharp_frames"].as_u64(), Some(2));

    write_png(&theirs.join(picture(2)), (80, 68), Some(0.0));
    let size = against(&ours, &theirs, &[]).exits_with(1);
    size.stderr_contains("000002.png").stderr_contains("40x34").stderr_contains("80x68");
    let other = scratch.join("other");
    fs::create_dir(&other).expect("a folder");
    write_png(&other.join(picture(7)), SIDE, Some(0.0));
    against(&ours, &other, &[]).exits_with(1).stderr_contains("has a partner");
    i2slam!("eval", ours).exits_with(2).stderr_contains("--reference");
    let trajectory = i2slam!("eval", ours, "--groundtruth", theirs).exits_with(2);
    trajectory.stderr_contains("--reference");
}

#[test]
fn equal_and_black_pictures_have_numbers() {
    let (_scratch, ours, theirs) = folders("eval-equal", 0.0);
    let figures = json(&against(&ours, &theirs, &["--json"]));
    assert!(figures["psnr_sharp_db"].is_null());
    let equal = (figures["equal_frames"].as_u64(), figures["ssim_sharp"].as_f64());
    assert_eq!(equal, (Some(3), Some(1.0)));
    for frame in 0..3 {
        write_png(&ours.join(picture(frame)), SIDE, None);
    }
    let figures = json(&against(&ours, &theirs, &["--json"]));
    let of = |key: &str| figures[key].as_f64();
    assert!(of("psnr_sharp_db").is_some_and(|v| (3.0..9.0).contains(&v)), "{figures}");
    assert!(of("ssim_sharp").is_some_and(|v| v < 0.2), "{figures}");
    assert!(of("lpips_sharp").is_some_and(|v| v > 0.3), "{figures}");
}

fn write_exr(path: &Path, value: impl Fn(usize) -> f32 + Sync) {
    let pixel = |x: usize, y: usize| {
        let v = value(y * SIDE.0 + x);
        (v, 0.5 * v, 0.25 * v)
    };
    exr::prelude::write_rgb_file(path, SIDE.0, SIDE.1, pixel).expect("room");
}

#[test]
fn radiance_is_compared_after_a_gain_and_a_nan_is_refused() {
    let scratch = TemporaryFolder::new("eval-radiance");
    let (ours, theirs) = (scratch.join("ours"), scratch.join("theirs"));
    for (folder, gain) in [(&ours, 8.0), (&theirs, 1.0)] {
        fs::create_dir(folder).expect("a folder");
        write_exr(&folder.join("000004.exr"), |i| gain * (1.0 + (i % 7) as f32));
    }
    let figures = json(&against(&ours, &theirs, &["--json"]));
    assert!(figures["hdr_log2_rmse_stops"].as_f64().is_some_and(|v| v < 1e-3), "{figures}");
    assert!(figures["hdr_mu_law_psnr_channel_gains_db"].as_f64().is_some_and(|v| v > 60.0));
    write_exr(&ours.join("000004.exr"), |i| if i == 9 { f32::NAN } else { 1.0 });
    against(&ours, &theirs, &[]).exits_with(1).stderr_contains("NaN or infinity");
}

/// A trajectory of so many poses on a spiral.
fn write_trajectory(path: &Path, start: f64, poses: usize) {
    let line = |i: usize| {
        let t = i as f64;
        format!("{} {} {} {} 0 0 0 1\n", start + 0.1 * t, t.cos(), t.sin(), 0.1 * t)
    };
    fs::write(path, (0..poses).map(line).collect::<String>()).expect("room");
}

#[test]
fn bare_trajectories_are_compared() {
    let scratch = TemporaryFolder::new("eval-trajectories");
    let (ours, theirs) = (scratch.join("ours.txt"), scratch.join("theirs.txt"));
    write_trajectory(&ours, 5.0, 20);
    write_trajectory(&theirs, 5.001, 30);
    let compare = |more: &[&str]| i2slam!("eval", ours, "--groundtruth", theirs; more);
    let figures = json(&compare(&["--json", "--rpe", "0.5s"]));
    assert_eq!(figures["pairs"].as_u64(), Some(20));
    assert!(figures["ate_median_m"].as_f64().is_some_and(|v| v < 1e-9), "{figures}");
    assert_eq!(figures["rpe_step"], serde_json::json!({"seconds": 0.5}));
    let table = compare(&["--rpe", "3"]).exits_with(0).out;
    assert!(table.contains("RPE rotation") && table.contains("over 3 frames"), "{table}");
    let long = compare(&["--rpe", "100"]).exits_with(0).out;
    assert!(
        long.contains("ATE RMSE") && long.contains("no two poses are 100 frames apart"),
        "{long}"
    );
    assert!(json(&compare(&["--json", "--rpe", "100"]))["rpe_rotation_rmse_deg"].is_null());
    compare(&["--rpe", "0"]).exits_with(2).stderr_contains("0.5s");
    compare(&["--protocol", "monogs"]).exits_with(2).stderr_contains("frames.csv");

    let refused = |word: &str| compare(&[]).exits_with(1).stderr_contains(word);
    write_trajectory(&ours, 100.0, 20);
    refused("covers 100 to 101.9 s");
    write_trajectory(&ours, 5.0, 2);
    refused("2, at least 3");
    fs::write(&ours, "5 1 nan 3 0 0 0 1\n").expect("room");
    refused("ours.txt, line 1");
    write_trajectory(&ours, 5.0, 20);
    fs::write(&theirs, "0 1 2 3 0 0 0 1\n1 1 nan 3 0 0 0 1\n").expect("room");
    refused("theirs.txt, line 2");
    fs::remove_file(&theirs).expect("a file");
    compare(&[]).exits_with(2).stderr_contains("theirs.txt");
}

#[test]
fn protocols_choose_frames_and_numbers() {
    let room = Room::reconstructed("eval-protocols", Scene::default(), &[]);
    let judged = |flags: &[&str]| {
        let figures = room.eval_json(flags);
        let frames = figures["frames"].as_array().expect("frames");
        let indices: Vec<u64> = frames.iter().filter_map(|f| f["index"].as_u64()).collect();
        (figures, indices)
    };
    let (all, frames) = judged(&[]);
    assert_eq!(frames, [0, 1, 2, 3, 4, 5]);
    assert!(all["ate_rmse_m"].as_f64().is_some_and(|v| v < 0.01), "the dataset's own truth");
    assert!(all["depth_l1_m"].as_f64().is_some_and(|v| v < 0.2), "{all}");
    // Depth is compared in the lengths of the truth.
    let doubled = room.scratch.join("doubled.txt");
    let truth = fs::read_to_string(room.data.join("groundtruth.txt")).expect("true poses");
    let double = |line: &str| -> String {
        let number = |(i, v): (usize, &str)| match (1..4).contains(&i) {
            true => (2.0 * v.parse::<f64>().expect("a number")).to_string(),
            false => v.to_owned(),
        };
        line.split_whitespace().enumerate().map(number).collect::<Vec<_>>().join(" ")
    };
    let poses = truth.lines().filter(|line| !line.starts_with('#'));
    fs::write(&doubled, poses.map(double).collect::<Vec<_>>().join("\n")).expect("room");
    let [doubled, data] = [&doubled, &room.data].map(|path| path.to_str().expect("a name"));
    let (scaled, _) = judged(&["--reference", data, "--groundtruth", doubled, "--align", "sim3"]);
    let [metric, scaled] = [&all, &scaled].map(|figures| figures["depth_l1_m"].as_f64());
    assert!(scaled.zip(metric).is_some_and(|(scaled, metric)| scaled > 1.0 + metric));
    let list = room.scratch.join("list.txt");
    fs::write(&list, "# mine\n2\n4\n77\n").expect("room");
    let list = list.to_str().expect("a name");
    assert_eq!(judged(&["--protocol", "i2slam", "--list", list]).1, [2, 4]);
    let (splatam, frames) = judged(&["--protocol", "splatam", "--every", "2"]);
    assert_eq!(frames, [0, 1, 3, 5]);
    assert!(splatam["psnr_splatam_db"].as_f64().is_some_and(|v| v > 20.0), "{splatam}");
    assert!(splatam["psnr_sharp_db"].is_null());
    let monogs = room.eval(&["--protocol", "monogs", "--list", list]).exits_with(2);
    monogs.stderr_contains("--list");
    room.eval(&["--list", "tum-fr9"]).exits_with(2).stderr_contains("tum-fr1-desk");
    fs::remove_file(room.out.join("renders/sharp/000004.png")).expect("a render");
    room.eval(&["--list", list]).exits_with(1).stderr_contains("000004");
}

#[test]
fn sharp_frames_are_listed() {
    let scratch = TemporaryFolder::new("eval-list");
    let (folder, list) = (scratch.join("rgb"), scratch.join("list.txt"));
    fs::create_dir(&folder).expect("a folder");
    for frame in 0..9 {
        write_png(&folder.join(picture(frame)), SIDE, (frame == 3).then_some(0.0));
    }
    let ran = i2slam!("eval", folder, "--write-list", list).exits_with(0);
    assert!(ran.out.contains("1 of 9 frames is sharp"), "{}", ran.out);
    let text = fs::read_to_string(&list).expect("a list");
    assert!(text.starts_with('#') && text.contains("\n3\n# CRC-32"), "{text}");
    let published = i2slam!("eval", folder, "--list", "help").exits_with(0).out;
    assert!(published.contains("tum-fr2-xyz"), "{published}");
}

//! `i2slam eval` on pictures and trajectories of its own, and what it says to bad ones.

use crate::program::{Ran, Scene, Scratch, reconstruct, run};
use std::ffi::OsStr;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

const SIDE: [usize; 2] = [40, 34];

/// A PNG whose values follow a wave; `shift` makes another picture of it, no wave a black one.
fn write_png(path: &Path, [width, height]: [usize; 2], wave: Option<f64>) {
    let value = |i: usize| {
        let (x, y) = ((i / 3 % width) as f64, (i / 3 / width) as f64);
        wave.map_or(0, |shift| (127.0 + 90.0 * (0.7 * x + shift).sin() * (0.4 * y).cos()) as u8)
    };
    let data: Vec<u8> = (0..3 * width * height).map(value).collect();
    let file = File::create(path).expect("room");
    let mut encoder = png::Encoder::new(file, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(&data).expect("pixels");
}

/// Folders `ours` and `theirs` with as many pictures.
fn folders(name: &str, shift: f64) -> (Scratch, PathBuf, PathBuf) {
    let scratch = Scratch::new(name);
    let (ours, theirs) = (scratch.join("ours"), scratch.join("theirs"));
    for (folder, shift) in [(&ours, shift), (&theirs, 0.0)] {
        fs::create_dir(folder).expect("a folder");
        for frame in 0..3 {
            let shift = shift + f64::from(frame);
            write_png(&folder.join(format!("{frame:06}.png")), SIDE, Some(shift));
        }
    }
    (scratch, ours, theirs)
}

fn eval_os(estimate: &Path, flags: &[&OsStr]) -> Ran {
    run(["eval".as_ref(), estimate.as_os_str()].into_iter().chain(flags.iter().copied()))
}

fn against(ours: &Path, theirs: &Path, more: &[&str]) -> Ran {
    let mut flags: Vec<&OsStr> = vec!["--reference".as_ref(), theirs.as_os_str()];
    flags.extend(more.iter().map(OsStr::new));
    eval_os(ours, &flags)
}

fn json(ran: &Ran) -> serde_json::Value {
    serde_json::from_str(&ran.out).expect("JSON")
}

#[test]
fn two_folders_of_pictures_are_compared() {
    let (_scratch, ours, theirs) = folders("eval-folders", 0.02);
    let table = against(&ours, &theirs, &[]).exits_with(0).out;
    for word in ["sharp PSNR", "sharp SSIM", "LPIPS", "frames evaluated"] {
        assert!(table.contains(word), "{table}");
    }
    let figures = json(&against(&ours, &theirs, &["--json"]).exits_with(0));
    let of = |key: &str| figures[key].as_f64();
    assert!(of("psnr_sharp_db").is_some_and(|v| (35.0..50.0).contains(&v)), "{figures}");
    assert!(of("ssim_sharp").is_some_and(|v| v > 0.98), "{figures}");
    assert!(of("lpips_sharp").is_some_and(|v| (0.0..0.05).contains(&v)), "{figures}");
    assert!(of("ms_ssim_sharp").is_none(), "too small for five scales");
    assert_eq!(figures["sharp_frames"].as_u64(), Some(3));
    assert_eq!(figures["frames"][2]["index"].as_u64(), Some(2));
}

#[test]
fn equal_pictures_are_said_to_be_equal() {
    let (_scratch, ours, theirs) = folders("eval-equal", 0.0);
    let ran = against(&ours, &theirs, &["--json"]).exits_with(0);
    let figures = json(&ran);
    assert!(figures["psnr_sharp_db"].is_null());
    assert_eq!(
        (figures["equal_frames"].as_u64(), figures["ssim_sharp"].as_f64()),
        (Some(3), Some(1.0))
    );
    against(&ours, &theirs, &[]).exits_with(0).stderr_contains("3 renders equal");
}

#[test]
fn a_missing_frame_is_named_and_no_mean_hides_it() {
    let (_scratch, ours, theirs) = folders("eval-missing", 0.02);
    fs::remove_file(ours.join("000001.png")).expect("a picture");
    against(&ours, &theirs, &[])
        .exits_with(1)
        .stderr_contains("000001")
        .stderr_contains("--partial");
    let ran = against(&ours, &theirs, &["--partial", "--json"]).exits_with(0);
    assert_eq!(json(&ran)["missing_frames"], serde_json::json!([1]));
    // A true picture less is no fault of the renders.
    fs::remove_file(theirs.join("000001.png")).expect("a picture");
    let ran = against(&ours, &theirs, &["--json"]).exits_with(0);
    assert_eq!(json(&ran)["sharp_frames"].as_u64(), Some(2));
}

#[test]
fn pictures_of_another_size_are_refused() {
    let (_scratch, ours, theirs) = folders("eval-size", 0.02);
    write_png(&theirs.join("000002.png"), [80, 68], Some(0.0));
    let ran = against(&ours, &theirs, &[]).exits_with(1);
    ran.stderr_contains("000002.png").stderr_contains("40x34").stderr_contains("80x68");
}

#[test]
fn all_black_pictures_have_numbers() {
    let (_scratch, ours, theirs) = folders("eval-black", 0.0);
    for frame in 0..3 {
        write_png(&ours.join(format!("{frame:06}.png")), SIDE, None);
    }
    let figures = json(&against(&ours, &theirs, &["--json"]).exits_with(0));
    assert!(
        figures["psnr_sharp_db"].as_f64().is_some_and(|v| (3.0..9.0).contains(&v)),
        "{figures}"
    );
    assert!(figures["ssim_sharp"].as_f64().is_some_and(|v| v < 0.2), "{figures}");
    assert!(figures["lpips_sharp"].as_f64().is_some_and(|v| v > 0.3), "{figures}");
}

#[test]
fn folders_without_a_common_picture_are_an_error() {
    let (scratch, ours, theirs) = folders("eval-disjoint", 0.0);
    let other = scratch.join("other");
    fs::create_dir(&other).expect("a folder");
    write_png(&other.join("000007.png"), SIDE, Some(0.0));
    against(&ours, &other, &[]).exits_with(1).stderr_contains("has a partner");
    eval_os(&ours, &[]).exits_with(2).stderr_contains("--reference");
    let trajectory: [&OsStr; 2] = ["--groundtruth".as_ref(), theirs.as_ref()];
    eval_os(&ours, &trajectory).exits_with(2).stderr_contains("--reference");
}

fn write_exr(path: &Path, value: impl Fn(usize) -> f32 + Sync) {
    let pixel = |x: usize, y: usize| {
        let v = value(y * SIDE[0] + x);
        (v, 0.5 * v, 0.25 * v)
    };
    exr::prelude::write_rgb_file(path, SIDE[0], SIDE[1], pixel).expect("room");
}

#[test]
fn radiance_is_compared_after_a_gain_and_a_nan_is_refused() {
    let scratch = Scratch::new("eval-radiance");
    let (ours, theirs) = (scratch.join("ours"), scratch.join("theirs"));
    for (folder, gain) in [(&ours, 8.0), (&theirs, 1.0)] {
        fs::create_dir(folder).expect("a folder");
        write_exr(&folder.join("000004.exr"), |i| gain * (1.0 + (i % 7) as f32));
    }
    let figures = json(&against(&ours, &theirs, &["--json"]).exits_with(0));
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

fn compare(estimate: &Path, truth: &Path, more: &[&str]) -> Ran {
    let mut flags: Vec<&OsStr> = vec!["--groundtruth".as_ref(), truth.as_os_str()];
    flags.extend(more.iter().map(OsStr::new));
    eval_os(estimate, &flags)
}

#[test]
fn bare_trajectories_are_compared() {
    let scratch = Scratch::new("eval-trajectories");
    let (ours, theirs) = (scratch.join("ours.txt"), scratch.join("theirs.txt"));
    write_trajectory(&ours, 5.0, 20);
    write_trajectory(&theirs, 5.001, 30);
    let figures = json(&compare(&ours, &theirs, &["--json", "--rpe", "0.5s"]).exits_with(0));
    assert_eq!(figures["pairs"].as_u64(), Some(20));
    assert!(figures["ate_median_m"].as_f64().is_some_and(|v| v < 1e-9), "{figures}");
    assert_eq!(figures["rpe_step"], serde_json::json!({"seconds": 0.5}));
    let table = compare(&ours, &theirs, &["--rpe", "3"]).exits_with(0).out;
    assert!(table.contains("RPE rotation") && table.contains("over 3 frames"), "{table}");
    compare(&ours, &theirs, &["--rpe", "0"]).exits_with(2).stderr_contains("0.5s");
    compare(&ours, &theirs, &["--protocol", "monogs"]).exits_with(2).stderr_contains("frames.csv");
}

#[test]
fn trajectories_that_cannot_be_compared_are_an_error() {
    let scratch = Scratch::new("eval-bad-trajectories");
    let (ours, theirs) = (scratch.join("ours.txt"), scratch.join("theirs.txt"));
    write_trajectory(&theirs, 5.0, 30);
    write_trajectory(&ours, 100.0, 20);
    compare(&ours, &theirs, &[]).exits_with(1).stderr_contains("covers 100 to 101.9 s");
    write_trajectory(&ours, 5.0, 2);
    compare(&ours, &theirs, &[]).exits_with(1).stderr_contains("2, at least 3");
    fs::write(&ours, "5 1 nan 3 0 0 0 1\n").expect("room");
    compare(&ours, &theirs, &[]).exits_with(1).stderr_contains("ours.txt, line 1");
    compare(&ours, &scratch.join("none.txt"), &[]).exits_with(1).stderr_contains("none.txt");
    write_trajectory(&ours, 5.0, 20);
    fs::write(&theirs, "0 1 2 3 0 0 0 1\n1 1 nan 3 0 0 0 1\n").expect("room");
    compare(&ours, &theirs, &[]).exits_with(1).stderr_contains("theirs.txt, line 2");
}

#[test]
fn protocols_choose_frames_and_numbers() {
    let scratch = Scratch::new("eval-protocols");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene::default().write(&data);
    reconstruct(&data, &out, &[]).exits_with(0);
    let judged = |flags: &[&str]| {
        let flags: Vec<&str> = flags.iter().copied().chain(["--json"]).collect();
        let figures = json(&against(&out, &data, &flags).exits_with(0));
        let frames = figures["frames"].as_array().expect("frames");
        let indices: Vec<u64> = frames.iter().filter_map(|f| f["index"].as_u64()).collect();
        (figures, indices)
    };
    let (all, frames) = judged(&[]);
    assert_eq!(frames, [0, 1, 2, 3, 4, 5]);
    assert!(all["ate_rmse_m"].as_f64().is_some_and(|v| v < 0.01), "the dataset's own truth");
    assert!(all["depth_l1_m"].as_f64().is_some_and(|v| v < 0.2), "{all}");
    let list = scratch.join("list.txt");
    fs::write(&list, "# mine\n2\n4\n77\n").expect("room");
    let list = list.to_str().expect("a name");
    assert_eq!(judged(&["--protocol", "i2slam", "--list", list]).1, [2, 4]);
    let (splatam, frames) = judged(&["--protocol", "splatam", "--every", "2"]);
    assert_eq!(frames, [0, 1, 3, 5]);
    assert!(splatam["psnr_splatam_db"].as_f64().is_some_and(|v| v > 20.0), "{splatam}");
    assert!(splatam["psnr_sharp_db"].is_null());
    let wrong = |flags: &[&str], word: &str| {
        against(&out, &data, flags).exits_with(2).stderr_contains(word);
    };
    wrong(&["--protocol", "monogs", "--list", list], "--list");
    wrong(&["--list", "tum-fr9"], "tum-fr1-desk");
    fs::remove_file(out.join("renders/sharp/000004.png")).expect("a render");
    against(&out, &data, &["--list", list]).exits_with(1).stderr_contains("000004");
}

#[test]
fn sharp_frames_are_listed() {
    let scratch = Scratch::new("eval-list");
    let folder = scratch.join("rgb");
    fs::create_dir(&folder).expect("a folder");
    for frame in 0..9 {
        let wave = if frame == 3 { Some(0.0) } else { None };
        write_png(&folder.join(format!("{frame:06}.png")), SIDE, wave);
    }
    let list = scratch.join("list.txt");
    let flags: [&OsStr; 2] = ["--write-list".as_ref(), list.as_ref()];
    let ran = eval_os(&folder, &flags).exits_with(0);
    assert!(ran.out.contains("1 of 9 frames is sharp"), "{}", ran.out);
    let text = fs::read_to_string(&list).expect("a list");
    assert!(text.starts_with('#') && text.ends_with("\n3\n"), "{text}");
    assert!(
        eval_os(&folder, &["--list".as_ref(), "help".as_ref()])
            .exits_with(0)
            .out
            .contains("tum-fr2-xyz")
    );
}

//! Lens distortion that nobody gave: found in the pictures, and removed from them.

use crate::footage::{FOCAL, Footage, View};
use crate::tools::{number, run};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Of a wide-angle lens: 12 % at the corners.
const K1: f64 = -0.2;

/// Steps to the right, looking around, which shows focal length and lens.
fn bent(frames: u32) -> Vec<(u32, View)> {
    let view = |i: u32| {
        let turned = 0.35 * (0.25 * f64::from(i)).sin();
        View { turned, k1: K1, ..View::moved(0.06 * f64::from(i)) }
    };
    (0..frames).map(|i| (20 * i, view(i))).collect()
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).expect("a file")).expect("JSON")
}

#[test]
fn the_lens_is_found_and_removed() {
    let footage = Footage::new("lens");
    let video = footage.video("wide.mp4", &bent(28));
    let ran = footage.run(&video, &["--distortion", "estimate"]).ended_with(0);
    assert!(ran.out.contains("lens distortion: k1 -0."), "{}", ran.out);
    let ran = ran.complaining("lens distortion: k1 -0.");
    println!("{}", ran.err);
    let out = footage.scratch.join("out");
    let metrics = json(&out.join("metrics.json"));
    let found = |i: usize| metrics["lens_distortion"][i].as_f64().expect("a number");
    let focal = number(&out.join("metrics.json"), "focal_length_px").expect("a focal length");
    println!("k1 {} k2 {} f {focal}", found(0), found(1));
    assert!((focal / FOCAL - 1.0).abs() < 0.05, "{focal}");
    // At the middle of the sides of the picture, where the distortion is best seen.
    let square = (80.0 / FOCAL) * (80.0 / FOCAL);
    let (shift, due) = (found(0) * square + found(1) * square * square, K1 * square);
    assert!((found(0) - K1).abs() < 0.03 && (shift - due).abs() < 0.005, "{shift}, not {due}");
    // The same lens afterwards.
    let input = json(&out.join("input.json"));
    assert_eq!(input["estimated_camera"]["distortion"], metrics["lens_distortion"]);
    let page = fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(page.contains("Lens distortion found and removed"));
    let path = fs::read_to_string(out.join("trajectory.txt")).expect("a path");
    assert!(path.starts_with("# world_from_camera at mid-exposure [unit of length unknown]"));
}

#[test]
fn a_lens_is_looked_for_only_where_it_can_be() {
    let footage = Footage::new("lens-refused");
    let video = footage.video("wide.mp4", &bent(8));
    let estimate = ["--distortion", "estimate"];
    let with = |more: &[&'static str]| [&estimate, more].concat();
    let ran = footage.run(&video, &with(&["--rgb", "--keyframes", "poses.txt"])).ended_with(2);
    ran.complaining("--distortion estimate does not go with --keyframes");
    let ran = footage.run(&video, &with(&["--fov", "63"])).ended_with(2);
    ran.complaining("does not go with --camera, --intrinsics or --fov");
    let folder = footage.scratch.join("room");
    crate::scene::Scene::default().write(&folder);
    let out = footage.scratch.join("out").display().to_string();
    let words = |more: &[&str]| {
        let head = ["run", folder.to_str().expect("a name"), "--out", &out];
        run([&head, &estimate[..], more].concat()).ended_with(2)
    };
    words(&[]).complaining("--distortion estimate goes with --rgb or a video");
    words(&["--rgb"]).complaining("camera.json");
    assert!(!Path::new(&out).exists());
}

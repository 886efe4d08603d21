//! Radiance fields: of imported keyframes by colour alone, and of frames with depth.

use crate::program::{Room, Scene, i2slam, number, stamp};
use std::fmt::Write;
use std::fs;
use std::path::Path;

const FRAMES: usize = 8;
const QUICK_KEYFRAMES: &str = "[map]\nkind = \"hashgrid\"\n[hashgrid]\nbound = 2.0\nlog2_table = 12\n\
    finest_cell = 0.02\n\
    rays = 256\nfirst_iterations = 40\niterations = 5\nfinal_iterations = 120\n";

/// A sequence with the true poses in `poses.txt`, some a little off.
fn keyframes(name: &str) -> Room {
    let room = Room::new(name, Scene { frames: FRAMES, step: 0.03, ..Scene::default() });
    let mut text = String::new();
    for frame in 0..FRAMES {
        let (x, off) = (0.03 * frame as f64, 0.008 * f64::from(frame as i32 % 3 - 1));
        let z = 0.3 * x - off;
        writeln!(text, "{} {:.6} {off:.6} {z:.6} 0 0 0 1", stamp(frame), x + off).expect("memory");
    }
    fs::write(room.scratch.join("poses.txt"), text).expect("room");
    fs::write(room.scratch.join("quick.toml"), QUICK_KEYFRAMES).expect("room");
    room
}

fn reconstruct_keyframes(room: &Room, out: &Path, threads: &str, more: &[&str]) {
    let (poses, config) = (room.scratch.join("poses.txt"), room.scratch.join("quick.toml"));
    let ran = i2slam!(
        "run", room.data, "--out", out, "--rgb", "--keyframes", poses, "--config", config,
        "--threads", threads; more
    );
    let ran = ran.exits_with(0);
    assert!(ran.out.contains("a hash grid of"), "{}", ran.out);
}

fn same_bytes(a: &Path, b: &Path) {
    for file in ["map.i2slam", "trajectory_shutter.txt", "state.json"] {
        let same = fs::read(a.join(file)).expect(file) == fs::read(b.join(file)).expect(file);
        assert!(same, "{file} depends on the number of threads");
    }
}

#[test]
fn keyframes_with_depth_become_gaussians() {
    let room = keyframes("keyframed-gaussians");
    let (poses, config) = (room.scratch.join("poses.txt"), room.scratch.join("gaussians.toml"));
    fs::write(&config, "[mapping]\niterations = 3\nfinal_iterations = 20\n").expect("room");
    let run = |more: &[&str]| i2slam!("run", room.data, "--out", room.out, "--keyframes", poses, "--config", config; more);
    let without = run(&["--keyframe-depth", "none", "--map", "gaussian"]).exits_with(1);
    without.stderr_contains("the keyframes have no depth").stderr_contains("--map hashgrid");
    assert!(!room.has("metrics.json"));
    run(&["--keyframe-depth", "pictures"]).exits_with(0);
    assert!(room.has("map.ply") && room.has("viewer.html"));
    assert_eq!(room.metric("keyframes"), Some(FRAMES as f64));
    let metrics = room.text("metrics.json");
    assert!(metrics.contains("\"unit_of_length\": \"keyframes\""), "{metrics}");
    assert!(metrics.contains("camera.json\""), "no source of the camera: {metrics}");
    let first = room.text("trajectory.txt").lines().next().map(str::to_owned);
    assert!(first.is_some_and(|line| line.ends_with("[unit of length of the keyframes given]")));
    let exported = room.scratch.join("path.txt");
    let export = i2slam!("export", room.out, "--format", "tum", "--out", exported).exits_with(0);
    assert!(export.out.contains("in the unit of length of the keyframes given"), "{}", export.out);
}

/// Against the poses that were given there is no error.
#[test]
fn keyframes_are_not_judged_by_themselves() {
    let room = keyframes("keyframed-truth");
    let (truth, config) = (room.data.join("groundtruth.txt"), room.scratch.join("quick.toml"));
    let ran = i2slam!(
        "run",
        room.data,
        "--out",
        room.out,
        "--rgb",
        "--keyframes",
        truth,
        "--config",
        config
    );
    let ran = ran.exits_with(0);
    assert!(ran.err.contains("no error against it is told"), "{}", ran.err);
    assert_eq!(room.metric("ate_rmse_m"), None);
}

#[test]
fn a_trajectory_and_pictures_become_a_field() {
    let room = keyframes("keyframed");
    // Depth is not looked at.
    fs::remove_dir_all(room.data.join("depth")).expect("a folder");
    fs::remove_file(room.data.join("depth.txt")).expect("a list");
    let b = room.scratch.join("b");
    reconstruct_keyframes(&room, &room.out, "1", &[]);
    reconstruct_keyframes(&room, &b, "2", &["--render", "none"]);
    same_bytes(&room.out, &b);
    assert_eq!(room.metric("keyframes"), Some(FRAMES as f64));
    assert!(room.text("metrics.json").contains("\"ate_scale_aligned\": true"));
    let error = room.metric("ate_rmse_m").expect("a truth");
    let psnr = room.metric("psnr_blurred_db").expect("pictures");
    assert!(error < 0.011 && psnr > 20.0, "{error} m, {psnr} dB");
    assert!(room.has("report.html") && room.has("renders/depth/000003.png"));
    room.eval(&[]).exits_with(0);
}

/// A folder of COLMAP, pictures and model, is the dataset and its keyframes.
#[test]
fn a_plain_colmap_folder_needs_no_camera_file() {
    let room = Room::new("colmap", Scene { frames: FRAMES, step: 0.03, ..Scene::default() });
    let model = room.scratch.join("model");
    fs::create_dir_all(model.join("sparse/0")).expect("a folder");
    fs::rename(room.data.join("rgb"), model.join("images")).expect("pictures");
    let mut images = String::new();
    for frame in 0..FRAMES {
        let x = 0.03 * frame as f64;
        let (number, name) = (frame + 1, stamp(frame));
        writeln!(images, "{number} 1 0 0 0 {} 0 {} 1 {name}.png\n", -x, -0.3 * x).expect("memory");
    }
    fs::write(model.join("sparse/0/images.txt"), images).expect("room");
    let camera = "1 PINHOLE 48 36 45 45 24 18\n";
    fs::write(model.join("sparse/0/cameras.txt"), camera).expect("room");
    let config = room.scratch.join("quick.toml");
    fs::write(&config, QUICK_KEYFRAMES).expect("room");
    let ran =
        i2slam!("run", model, "--out", room.out, "--rgb", "--keyframes", model, "--config", config);
    let ran = ran.exits_with(0);
    assert!(!ran.err.contains("ignored"), "{}", ran.err);
    assert_eq!(room.metric("keyframes"), Some(FRAMES as f64));
    let input = room.text("input.json");
    assert!(input.contains("sparse/0/cameras.txt"), "{input}");
    let poses = model.join("poses.txt");
    fs::copy(room.data.join("groundtruth.txt"), &poses).expect("room");
    i2slam!("eval", room.out, "--groundtruth", poses).exits_with(0);
    // Neither has a camera.
    fs::remove_dir_all(model.join("sparse")).expect("a model");
    let again = room.scratch.join("again");
    i2slam!("run", model, "--out", again, "--rgb", "--keyframes", poses)
        .exits_with(1)
        .stderr_contains("no camera for");
}

#[test]
fn keyframes_that_are_held_out_are_found_in_the_map() {
    let room = keyframes("keyframed-held-out");
    reconstruct_keyframes(&room, &room.out, "2", &["--hold-out", "3"]);
    assert_eq!(room.metric("frames"), Some(FRAMES as f64));
    assert_eq!(room.metric("keyframes"), Some(FRAMES as f64 - 2.0));
    let judged = room.eval(&["--protocol", "held-out"]).exits_with(0).out;
    let frames = judged.lines().find(|line| line.starts_with("frames evaluated")).expect("a row");
    assert_eq!(frames.split_whitespace().last(), Some("2"), "{judged}");
}

#[test]
fn depth_pictures_can_be_taken_along() {
    let room = keyframes("keyframed-depth");
    let more = ["--keyframe-depth", "pictures", "--render", "none"];
    let off = ["--no-blur", "--no-tone", "--no-trajectory-loss"];
    reconstruct_keyframes(&room, &room.out, "2", &[&more[..], &off].concat());
    let loss = *room.column("loss_depth").last().expect("a row");
    assert!(loss > 0.0 && loss < 0.5, "{loss}");
}

#[test]
fn pictures_without_a_path_say_why() {
    let room = Room::new("keyframed-native", Scene { frames: 3, step: 0.03, ..Scene::default() });
    let ran = i2slam!("run", room.data, "--out", room.out, "--rgb").exits_with(1);
    ran.stderr_contains("no path of the camera was found")
        .stderr_contains("48x36 pixels is too small");
}

const QUICK_FIELD: &str = "[hashgrid]\nlog2_table = 12\nfinest_cell = 0.02\nrays = 256\n\
    first_iterations = 120\niterations = 12\nfinal_iterations = 30\n";

#[test]
fn a_field_is_saved_drawn_again_and_judged() {
    let room = Room::new("field", Scene { frames: 4, ..Scene::default() });
    let (config, b, again) =
        (room.scratch.join("quick.toml"), room.scratch.join("b"), room.scratch.join("again"));
    fs::write(&config, QUICK_FIELD).expect("room");
    for (out, threads) in [(&room.out, "1"), (&b, "2")] {
        let flags = ["--map", "hashgrid", "--threads", threads];
        let ran = i2slam!("run", room.data, "--out", out, "--config", config; flags);
        let ran = ran.exits_with(0);
        assert!(ran.out.contains("a hash grid of"), "{}", ran.out);
    }
    same_bytes(&room.out, &b);
    assert!(!room.has("map.ply"));
    let page = room.text("report.html");
    assert!(page.contains("<code>map.i2slam</code>") && !page.contains("<code>map.ply</code>"));
    let [tracked, gaussians] = ["tracked", "gaussians"].map(|key| room.metric(key));
    assert_eq!((tracked, gaussians), (Some(4.0), Some(0.0)));
    assert!(room.metric("ate_rmse_m").is_some_and(|error| error < 0.01));
    assert!(number(&b.join("metrics.json"), "psnr_blurred_db").is_some_and(|psnr| psnr > 20.0));
    i2slam!("render", room.out, "--out", again).exits_with(0);
    for file in ["sharp/000003.png", "blurred/000003.png", "depth/000003.png", "hdr/000003.exr"] {
        let first = fs::read(room.out.join("renders").join(file)).expect(file);
        assert!(first == fs::read(again.join(file)).expect(file), "{file}");
    }
    room.eval(&[]).exits_with(0);
}

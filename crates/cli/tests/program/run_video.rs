//! `i2slam run` and `info` on videos, by colour alone, with and without a camera.

use crate::footage::{FOCAL, Footage, HEIGHT, View, WIDTH, walk};
use crate::program::{
    Ran, Running, Scene, TemporaryFolder, i2slam, json, number, program, reconstruct, write_colour,
};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};

/// Steps to the right while looking around, from which the focal length can be estimated.
fn stroll(frames: u32) -> Vec<(u32, View)> {
    let mut views = walk(frames, 0.05);
    for (i, (_, view)) in views.iter_mut().enumerate() {
        view.turned = 0.2 * (0.3 * i as f64).sin();
    }
    views
}

#[test]
fn a_video_needs_no_flags() {
    let footage = Footage::new("video");
    // Frames 5 and 6 are missing, so that the frame rate varies.
    let views: Vec<(u32, View)> = stroll(24)
        .into_iter()
        .enumerate()
        .filter(|(i, _)| !matches!(i, 5 | 6))
        .map(|v| v.1)
        .collect();
    let video = footage.video("walk.mp4", &views);
    let ran = footage.run(&video, &[]).exits_with(0);
    assert!(ran.out.contains("unit of length: unknown"), "{}", ran.out);
    let ran = ran
        .stderr_contains("camera not given")
        .stderr_contains("60 degrees")
        .stderr_contains("22 frames");
    ran.stderr_contains("estimated from the pictures");
    let out = footage.scratch.join("out");
    let metrics = out.join("metrics.json");
    let focal = number(&metrics, "focal_length_px").expect("a focal length");
    assert!((focal / FOCAL - 1.0).abs() < 0.1, "{focal}");
    let assumed = number(&metrics, "focal_length_assumed_px").expect("a guess");
    assert!((assumed - 138.6).abs() < 0.1, "{assumed}");
    let text = fs::read_to_string(&metrics).expect("figures");
    assert!(text.contains("\"unit_of_length\": \"unknown\""), "{text}");
    assert!(text.contains("\"camera_source\": \"the pictures; assumed first: "), "{text}");
    let page = fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(page.contains("Unit of length: unknown") && page.contains("Field of view"));
    let stamps = fs::read_to_string(out.join("trajectory.txt")).expect("a path");
    for line in stamps.lines().filter(|line| !line.starts_with('#')) {
        let stamp: f64 = line.split(' ').next().expect("a stamp").parse().expect("a number");
        let due = |view: &(u32, View)| (f64::from(view.0) / 600.0 - stamp).abs() < 1e-6;
        assert!(views.iter().any(due), "{line}");
    }
}

#[test]
fn info_tells_of_a_video() {
    let footage = Footage::new("video-info");
    let video = footage.video("walk.mp4", &walk(9, 0.06));
    let out = footage.i2slam("info", &video, &[]).exits_with(0).out;
    for part in [
        "video",
        "30.00 frames a second",
        "160x120, fx 138.56",
        "a guess",
        "depth             none",
    ] {
        assert!(out.contains(part), "{part} is not in\n{out}");
    }
    assert!(!out.contains("depth scale"), "{out}");
    let flags = "--json --max-side 80 --fov 90 --frames 2..9 --stride 2 --quick";
    let flags: Vec<&str> = flags.split(' ').collect();
    let told = json(&footage.i2slam("info", &video, &flags));
    assert_eq!((&told["frames"], &told["camera"]["width"]), (&4.into(), &80.into()));
    assert_eq!(told["camera"]["recorded"], serde_json::json!([WIDTH, HEIGHT]));
    assert!((told["camera"]["fx"].as_f64().expect("a number") - 40.0).abs() < 1e-9);
    let file = footage.scratch.join("camera.txt");
    fs::write(&file, "1 PINHOLE 320 240 260 260 160 120\n").expect("room");
    let flags = ["--json", "--quick", "--intrinsics", file.to_str().expect("a name")];
    let told = json(&footage.i2slam("info", &video, &flags));
    assert_eq!(
        (&told["camera"]["fx"], &told["camera"]["is_guess"]),
        (&130.0.into(), &false.into())
    );
}

#[test]
fn videos_without_a_path_say_why() {
    let footage = Footage::new("video-no-path");
    let short = footage.run(&footage.video("short.mp4", &walk(3, 0.06)), &[]).exits_with(1);
    short
        .stderr_contains("no path of the camera was found")
        .stderr_contains("3 pictures are too few");
    let still = footage.video("still.mp4", &walk(12, 0.0));
    footage.run(&still, &[]).exits_with(1).stderr_contains("the camera stands still");
    assert!(!footage.scratch.join("out").exists(), "nothing was written");
    // Nor the folders above it, but those that were there.
    fs::create_dir(footage.scratch.join("mine")).expect("room");
    Ran::of(&mut footage.quick("mine/a/b", &still, &[])).exits_with(1);
    assert!(footage.scratch.join("mine").exists() && !footage.scratch.join("mine/a").exists());
    let turn = |i: u32| View { turned: 0.02 * f64::from(i), ..View::moved(0.0) };
    let views: Vec<(u32, View)> = (0..16).map(|i| (20 * i, turn(i))).collect();
    let turning = footage.video("turn.mp4", &views);
    for more in [&[][..], &["--fov", "63.2"]] {
        footage.run(&turning, more).exits_with(1).stderr_contains("the camera only turned");
    }
}

#[test]
fn behind_a_cut_frames_are_lost_and_counted() {
    let footage = Footage::new("video-cut");
    let mut views = walk(24, 0.06);
    views[16..].iter_mut().for_each(|(_, view)| view.scene = 1);
    let video = footage.video("cut.mp4", &views);
    let ran = footage.run(&video, &["--fov", "63.2"]).exits_with(0);
    assert!(ran.out.contains(" of 24 frames tracked"), "{}", ran.out);
    ran.stderr_contains("8 of 24 frames have no pose").stderr_contains("frames 16..24");
    let out = footage.scratch.join("out");
    let metrics = out.join("metrics.json");
    assert_eq!(number(&metrics, "frames_given"), Some(24.0));
    assert_eq!(number(&metrics, "frames"), Some(16.0));
    let told: Value =
        serde_json::from_str(&fs::read_to_string(&metrics).expect("figures")).expect("JSON");
    let cut = told["warnings"].as_array().expect("warnings").iter().find(|w| w["frame"] == 16);
    let cut = cut.expect("where the cut is");
    assert_eq!(cut["last_frame"], 23);
    assert!((cut["time_s"].as_f64().expect("a time") - 16.0 / 30.0).abs() < 1e-9, "{cut}");
    let page = fs::read_to_string(out.join("report.html")).expect("a report");
    for part in
        ["16 of 24 blurred frames", "of 24", "<h2>Warnings</h2>", "frames 16 to 23", "0.53 s"]
    {
        assert!(page.contains(part), "{part}");
    }
    assert!(!page.contains("Depth loss"), "no depth was measured");
}

#[test]
fn one_bad_stamp_does_not_spoil_the_others() {
    let footage = Footage::new("video-stamp");
    let mut views = walk(9, 0.06);
    views[4].0 = 100_000;
    let video = footage.video("walk.mp4", &views);
    let told = json(&footage.i2slam("info", &video, &["--json", "--quick"]));
    let seconds = told["times"]["duration_s"].as_f64().expect("a number");
    assert!((seconds - 8.0 / 30.0).abs() < 1e-9, "{seconds}");
    assert_eq!(told["times"]["gaps"], serde_json::json!([]));
    let warnings = told["warnings"].to_string();
    assert!(warnings.contains("frame 4 has no usable time stamp"), "{warnings}");
}

/// The estimate comes early; only the first frames are there.
#[test]
fn what_a_long_job_takes_is_told_after_a_few_frames() {
    let footage = Footage::new("video-long");
    let video = footage.video("long.mp4", &stroll(40));
    let words: String = (0..20_000)
        .map(|n| format!("showinfo n: {n} pts: {} s:{WIDTH}x{HEIGHT} i:P\n", 20 * n))
        .collect();
    let words = format!("showinfo config in time_base: 1/600\n{words}");
    fs::write(video.with_extension("mp4.words"), words).expect("room");
    let mut run = footage.command("run", &video, &["--out", "long", "--threads", "1"]);
    let mut running = Running::start(run.current_dir(footage.scratch.join("")));
    let line = running.until("this will take about");
    for part in ["20000 frames of 160x120 px", "keyframes", "--frames", "--stride"] {
        assert!(line.contains(part), "{line}");
    }
    running.interrupted().exits_with(130).stderr_contains("neither exposure nor motion blur");
}

#[test]
fn a_wrong_field_of_view_is_doubted() {
    let footage = Footage::new("video-wrong");
    let video = footage.video("walk.mp4", &stroll(24));
    // A focal length of 156 px: a fifth too long.
    let ran = footage.run(&video, &["--fov", "54.3"]).exits_with(0);
    ran.stderr_contains("the focal length was given as 156")
        .stderr_contains("(54.3 degrees across)");
}

#[test]
fn what_cannot_be_decoded_is_told_in_one_line() {
    let footage = Footage::new("video-broken");
    for (words, part) in [
        (
            "[vist#0:0/none @ 0x5] [error] Decoding requested, but no decoder found for: none\n\
          [error] Error opening output file -.\n",
            "cannot decode its video codec",
        ),
        (
            "[in#0 @ 0x5] [error] moov atom not found\n[fatal] Error opening input files: Invalid\n",
            "damaged, cut off",
        ),
        ("[fatal] Stream map '' matches no streams.\nTo ignore this, add '?'\n", "no video in it"),
        ("[in#0 @ 0x5] [error] Error opening input: Permission denied\n", "Permission denied"),
    ] {
        let video = footage.broken("odd.mp4", words);
        let ran =
            footage.run(&video, &[]).exits_with(1).stderr_contains(part).stderr_contains("odd.mp4");
        let errors = ran.err.lines().filter(|line| line.starts_with("error:")).count();
        assert!(errors == 1 && ran.err.lines().count() == 2, "{}", ran.err);
        assert!(!footage.scratch.join("out").exists());
    }
}

#[test]
fn frames_that_break_off_are_left_out() {
    let footage = Footage::new("video-cut-off");
    let video = footage.video("cut.mp4", &walk(16, 0.06));
    let frames = fs::read(video.with_extension("mp4.rgb")).expect("frames");
    fs::write(video.with_extension("mp4.rgb"), &frames[..frames.len() * 3 / 4 + 7]).expect("room");
    let ran = footage.run(&video, &["--fov", "63.2"]).exits_with(0);
    ran.stderr_contains("frame 12: left out").stderr_contains("cannot be decoded");
}

/// One picture is cut off, one is black.
#[test]
fn warnings_call_photographs_by_their_files() {
    let scratch = TemporaryFolder::new("photographs");
    let (folder, out) = (scratch.join("holiday"), scratch.join("out"));
    let clip = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo/rgb");
    let found = fs::read_dir(clip).expect("the clip").flatten().map(|file| file.path());
    let mut pictures: Vec<_> = found.collect();
    pictures.sort();
    fs::create_dir(&folder).expect("room");
    for (i, picture) in pictures.iter().take(9).enumerate() {
        let bytes = fs::read(picture).expect("a picture");
        let end = if i == 5 { bytes.len() / 2 } else { bytes.len() };
        fs::write(folder.join(format!("IMG_1{i}.jpg")), &bytes[..end]).expect("room");
    }
    fs::remove_file(folder.join("IMG_13.jpg")).expect("it is there");
    write_colour(&folder.join("IMG_13.png"), (304, 224), &[0; 304 * 224 * 3]);
    let flags = ["--rgb", "--max-side", "160", "--render", "none"];
    let ran = reconstruct(&folder, &out, &flags).exits_with(0);
    let metrics = fs::read_to_string(out.join("metrics.json")).expect("metrics");
    let report = fs::read_to_string(out.join("report.html")).expect("a report");
    for words in ["frame 5, IMG_15.jpg: left out: ", "frame 3, IMG_13.png, is black"] {
        for told in [&ran.err, &metrics, &report] {
            assert!(told.contains(words), "{words} is not in {told}");
        }
    }
}

#[test]
fn without_ffmpeg_the_way_to_it_is_told() {
    let footage = Footage::new("video-none");
    let video = footage.video("walk.mp4", &walk(4, 0.06));
    let arguments = ["run", video.to_str().expect("a name"), "--out", "out"];
    let nowhere = footage.scratch.join("nowhere");
    let named = Ran::of(program(arguments).env("I2SLAM_FFMPEG", &nowhere)).exits_with(1);
    named.stderr_contains("nowhere").stderr_contains("as I2SLAM_FFMPEG names it");
    let mut none = program(arguments);
    let none = Ran::of(none.env_remove("I2SLAM_FFMPEG").env("PATH", "")).exits_with(1);
    none.stderr_contains("needs the program ffmpeg").stderr_contains("install");
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let footage = Footage::new("video-usage");
    let video = footage.video("walk.mp4", &walk(5, 0.06));
    let refused = |more: &[&str], part: &str| {
        footage.run(&video, more).exits_with(2).stderr_contains(part);
    };
    refused(&["--intrinsics", "100", "100"], "four numbers FX FY CX CY");
    refused(&["--fov", "200"], "below 180 degrees");
    refused(&["--frames", "7..9"], "frames 0..5");
    refused(&["--preset", "paper-tum"], "an input without depth) goes with default-rgb");
    footage
        .run(&footage.scratch.join("none.mp4"), &[])
        .exits_with(2)
        .stderr_contains("no file or folder");
    let file = footage.scratch.join("camera.txt");
    fs::write(&file, "500 500\n").expect("room");
    let flags = ["--intrinsics", file.to_str().expect("a name")];
    footage
        .run(&video, &flags)
        .exits_with(1)
        .stderr_contains("2 numbers")
        .stderr_contains("camera.txt");
    fs::write(&file, "1 PINHOLE 320 320 260 260 160 160\n").expect("room");
    footage.run(&video, &flags).exits_with(1).stderr_contains("any size of that shape");
}

/// Times, sizes and pixels of a video made by ffmpeg.
#[test]
#[ignore = "needs ffmpeg on the search path or in I2SLAM_FFMPEG"]
fn the_real_ffmpeg_is_understood() {
    let name = std::env::var("I2SLAM_FFMPEG").unwrap_or_else(|_| "ffmpeg".to_owned());
    let succeeds = |arguments: &[&str]| {
        let mut command = Command::new(&name);
        command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
        command.status().is_ok_and(|status| status.success())
    };
    assert!(succeeds(&["-version"]), "{name} does not run");
    let footage = Footage::new("video-real");
    let raw = footage.video("walk.mp4", &walk(20, 0.06)).with_extension("mp4.rgb");
    let video = footage.scratch.join("real.mkv");
    let [raw, to] = [&raw, &video].map(|path| path.to_str().expect("a name"));
    let head =
        ["-y", "-f", "rawvideo", "-pix_fmt", "rgb24", "-s", "160x120", "-r", "25", "-i", raw];
    let tail = ["-vf", "select=not(between(n\\,4\\,6))", "-vsync", "0", "-c:v", "ffv1", to];
    let newer =
        ["-vf", "select=not(between(n\\,4\\,6))", "-fps_mode", "passthrough", "-c:v", "ffv1", to];
    let made = succeeds(&[&head[..], &newer].concat()) || succeeds(&[&head[..], &tail].concat());
    assert!(made, "ffmpeg makes a video");
    let mut command = program(["info", to, "--json", "--fov", "63.2"]);
    let told = json(&Ran::of(command.env("I2SLAM_FFMPEG", &name)));
    assert_eq!((&told["frames"], &told["pictures"]["measured_frames"]), (&17.into(), &17.into()));
    assert_eq!(told["times"]["gaps"][0]["after_frame"], 3);
    let gap = told["times"]["gaps"][0]["seconds"].as_f64().expect("a number");
    assert!((gap - 0.16).abs() < 1e-3, "{gap}");
    let median = told["pictures"]["brightness"]["median"].as_f64().expect("a number");
    assert!((median - 0.5).abs() < 0.03, "{median}");
}

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

fn read_json(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).expect("a file")).expect("JSON")
}

#[test]
fn the_lens_is_found_and_removed() {
    let footage = Footage::new("lens");
    let video = footage.video("wide.mp4", &bent(28));
    let ran = footage.run(&video, &["--distortion", "estimate"]).exits_with(0);
    assert!(ran.out.contains("lens distortion: k1 -0."), "{}", ran.out);
    ran.stderr_contains("lens distortion: k1 -0.");
    let out = footage.scratch.join("out");
    let metrics = read_json(&out.join("metrics.json"));
    let found = |i: usize| metrics["lens_distortion"][i].as_f64().expect("a number");
    let focal = number(&out.join("metrics.json"), "focal_length_px").expect("a focal length");
    println!("k1 {} k2 {} f {focal}", found(0), found(1));
    assert!((focal / FOCAL - 1.0).abs() < 0.05, "{focal}");
    // At the middle of the sides of the picture, where the distortion is best seen.
    let square = (80.0 / FOCAL) * (80.0 / FOCAL);
    let (shift, due) = (found(0) * square + found(1) * square * square, K1 * square);
    assert!((found(0) - K1).abs() < 0.03 && (shift - due).abs() < 0.005, "{shift}, not {due}");
    // The same lens afterwards.
    let input = read_json(&out.join("input.json"));
    assert_eq!(input["estimated_camera"]["distortion"], metrics["lens_distortion"]);
    let page = fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(page.contains("Lens distortion found and removed"));
    let path = fs::read_to_string(out.join("trajectory.txt")).expect("a path");
    assert!(path.starts_with("# world_from_camera at mid-exposure [unit of length unknown]"));
}

#[test]
fn a_depth_track_is_described_and_asks_for_a_camera() {
    let footage = Footage::new("video-depth");
    let video = footage.video_with_depth("depth.mp4", &walk(3, 0.05));
    let told = footage.i2slam("info", &video, &["--fov", "63.2"]).exits_with(0);
    let told = told.out.lines().find(|line| line.starts_with("depth ")).expect("depth").to_owned();
    assert!(!told.contains("none"), "{told}");
    let ran = footage.run(&video, &["--rgb", "--fov", "63.2", "--depth-scale", "777"]);
    ran.stderr_contains("--depth-scale changes nothing");
    for (command, status) in [("info", 0), ("run", 1)] {
        let ran = footage.i2slam(command, &video, &[]).exits_with(status);
        ran.stderr_contains("no camera for").stderr_contains("depth.mp4, which depth");
    }
}

#[test]
fn a_lens_is_looked_for_only_where_it_can_be() {
    let footage = Footage::new("lens-refused");
    let video = footage.video("wide.mp4", &bent(8));
    let estimate = ["--distortion", "estimate"];
    let with = |more: &[&'static str]| [&estimate, more].concat();
    let ran = footage.run(&video, &with(&["--rgb", "--keyframes", "poses.txt"])).exits_with(2);
    ran.stderr_contains("--distortion estimate does not go with --keyframes");
    let ran = footage.run(&video, &with(&["--fov", "63"])).exits_with(2);
    ran.stderr_contains("does not go with --camera, --intrinsics or --fov");
    let folder = footage.scratch.join("room");
    Scene::default().write(&folder);
    let out = footage.scratch.join("out");
    let refused =
        |more: &[&'static str]| i2slam!("run", folder, "--out", out; with(more)).exits_with(2);
    refused(&[])
        .stderr_contains("--distortion estimate goes with --rgb, or an input without depth");
    refused(&["--rgb"]).stderr_contains("camera.json");
    assert!(!out.exists());
}

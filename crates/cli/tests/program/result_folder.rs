//! Files of a result folder, and folders that are not empty: refused, or replaced on request.

use crate::program::{HEIGHT, Ran, Scene, Scratch, WIDTH, number, reconstruct, rows, run};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

#[test]
fn every_file_of_the_result_folder_is_written() {
    let scratch = Scratch::new("result");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene::default().write(&data);
    let ran = reconstruct(&data, &out, &[]).exits_with(0);
    let report = out.join("report.html");
    assert_eq!(ran.out.lines().last(), report.to_str(), "{}", ran.out);
    assert_eq!(rows(&out.join("trajectory.txt")), 6);
    assert_eq!(rows(&out.join("trajectory_shutter.txt")), 6);
    assert_eq!(rows(&out.join("frames.csv")), 7);
    assert_eq!(rows(&out.join("camera_response.csv")), 257);
    for file in ["camera.json", "state.json", "map.i2slam", "map.ply", "config.toml", "input.json"]
    {
        assert!(out.join(file).is_file(), "{file}");
    }
    for (kind, extension) in
        [("sharp", "png"), ("blurred", "png"), ("hdr", "exr"), ("depth", "png")]
    {
        for frame in 0..6 {
            let file = format!("renders/{kind}/{frame:06}.{extension}");
            assert!(out.join(&file).is_file(), "{file}");
        }
    }
    let config = fs::read_to_string(out.join("config.toml")).expect("settings");
    for part in ["i2slam_version", "seed = ", "preset = \"default\"", "final_iterations = 3"] {
        assert!(config.contains(part), "{part} is not in\n{config}");
    }
    let metrics = out.join("metrics.json");
    assert_eq!(number(&metrics, "tracked"), Some(6.0));
    let error = number(&metrics, "ate_rmse_m").expect("ground truth lies beside the frames");
    assert!(error < 0.01, "{error}");
    let psnr = number(&metrics, "psnr_blurred_db").expect("the input is known");
    assert!(psnr > 20.0, "{psnr}");
    let page = fs::read_to_string(&report).expect("a report");
    assert!(page.contains("data:image/jpeg") && page.contains("Trajectory error"));
}

#[test]
fn an_earlier_result_is_only_replaced_on_request() {
    let scratch = Scratch::new("overwrite");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 4, ..Scene::default() }.write(&data);
    reconstruct(&data, &out, &[]).exits_with(0);
    let pose = ["--pose", "0 0 0 0 0 0 1"];
    run(["render", out.to_str().expect("a name")].into_iter().chain(pose)).exits_with(0);
    run(["eval", out.to_str().expect("a name")]).exits_with(0);
    fs::write(out.join("notes.txt"), "mine").expect("room");
    let before = fs::read(out.join("trajectory.txt")).expect("a result");
    let refused = reconstruct(&data, &out, &["--frames", "0..2"]).exits_with(2);
    refused.stderr_contains("holds what `i2slam run` wrote before").stderr_contains("--overwrite");
    assert_eq!(fs::read(out.join("trajectory.txt")).ok(), Some(before));
    reconstruct(&data, &out, &["--frames", "0..2", "--overwrite"]).exits_with(0);
    assert_eq!(rows(&out.join("trajectory.txt")), 2);
    for stale in ["views", "evaluation.json", "renders/sharp/000003.png"] {
        assert!(!out.join(stale).exists(), "{stale}");
    }
    assert!(out.join("notes.txt").is_file() && out.join("renders/sharp/000001.png").is_file());
}

#[test]
fn files_of_the_user_are_never_replaced() {
    let scratch = Scratch::new("foreign");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 2, ..Scene::default() }.write(&data);
    fs::create_dir(&out).expect("a folder");
    for flags in [&[][..], &["--overwrite"][..]] {
        fs::write(out.join("camera.json"), "mine").expect("room");
        let refused = reconstruct(&data, &out, flags).exits_with(2);
        refused
            .stderr_contains("camera.json would be overwritten")
            .stderr_contains("another folder");
        assert_eq!(fs::read_to_string(out.join("camera.json")).ok().as_deref(), Some("mine"));
        assert_eq!(fs::read_dir(&out).map(Iterator::count).ok(), Some(1));
    }
}

#[test]
fn renders_have_the_size_and_units_that_the_camera_says() {
    let scratch = Scratch::new("units");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 3, ..Scene::default() }.write(&data);
    reconstruct(&data, &out, &["--render", "keyframes"]).exits_with(0);
    assert!(!out.join("renders/depth/000001.png").exists(), "only keyframes");
    let file = fs::File::open(out.join("renders/depth/000000.png")).expect("the first keyframe");
    let mut reader = png::Decoder::new(std::io::BufReader::new(file)).read_info().expect("a PNG");
    let mut bytes = vec![0; reader.output_buffer_size().expect("a size")];
    let info = reader.next_frame(&mut bytes).expect("pixels");
    assert_eq!((info.width as usize, info.height as usize), (WIDTH, HEIGHT));
    assert_eq!(info.bit_depth, png::BitDepth::Sixteen);
    let mut units: Vec<u16> =
        bytes.chunks_exact(2).map(|b| u16::from_be_bytes([b[0], b[1]])).collect();
    units.sort_unstable();
    // The back wall, 1.6 m away, fills most of the picture.
    let median = f64::from(units[units.len() / 2]) / 5000.0;
    assert!((median - 1.5).abs() < 0.15, "{median} m");
}

#[test]
fn truth_beside_the_frames_is_measured() {
    let scratch = Scratch::new("truth");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene::default().write(&data);
    fs::create_dir(data.join("sharp")).expect("a folder");
    for entry in fs::read_dir(data.join("rgb")).expect("pictures").flatten() {
        fs::copy(entry.path(), data.join("sharp").join(entry.file_name())).expect("room");
    }
    let exposure = "frame,dt\n0,1\n1,1.1\n2,1.2\n3,1.1\n4,1\n5,0.9\n";
    fs::write(data.join("exposure.csv"), exposure).expect("room");
    reconstruct(&data, &out, &["--render", "none"]).exits_with(0);
    let metrics = out.join("metrics.json");
    assert!(number(&metrics, "psnr_sharp_db").is_some_and(|v| v > 20.0));
    assert_eq!(number(&metrics, "sharp_frames"), Some(6.0));
    assert!(number(&metrics, "ssim_sharp").is_some_and(|v| (0.5..=1.0).contains(&v)));
    assert!(number(&metrics, "log_exposure_correlation").is_some());
    assert!(!out.join("renders").exists());
    let page = || fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(page().contains("<code>map.ply</code>") && !page().contains("<code>renders/"));
    assert!(page().contains("true log exposure"));
    // A camera of one exposure: there is nothing to correlate.
    let constant = "frame,dt\n0,1\n1,1.001\n2,1\n3,0.999\n4,1\n5,1\n";
    fs::write(data.join("exposure.csv"), constant).expect("room");
    reconstruct(&data, &out, &["--render", "none", "--overwrite"]).exits_with(0);
    assert!(number(&metrics, "log_exposure_correlation").is_none());
    assert!(!page().contains("true log exposure"));
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let scratch = Scratch::new("seed");
    let data = scratch.join("room");
    Scene::default().write(&data);
    let runs = [("a", "1"), ("b", "1"), ("c", "2")].map(|(name, threads)| {
        let out = scratch.join(name);
        let flags = ["--seed", "7", "--threads", threads, "--render", "none", "--quiet"];
        reconstruct(&data, &out, &flags).exits_with(0);
        let read = |file: &str| fs::read(out.join(file)).expect("a result");
        (read("trajectory.txt"), read("trajectory_shutter.txt"), read("map.i2slam"))
    });
    assert!(runs[0] == runs[1], "the same run twice");
    assert!(runs[0] == runs[2], "one thread and two");
}

#[test]
fn module_switches_change_the_settings() {
    let scratch = Scratch::new("switches");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 3, ..Scene::default() }.write(&data);
    let flags = ["--no-blur", "--no-tone", "--no-trajectory-loss", "--virtual-cameras", "3"];
    reconstruct(&data, &out, &flags).exits_with(0);
    let config = fs::read_to_string(out.join("config.toml")).expect("settings");
    let off = ["blur = false", "tone = false", "trajectory_loss = false", "virtual_cameras = 3"];
    for line in off {
        assert!(config.contains(line), "{line} is not in\n{config}");
    }
    let page = fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(page.contains("no high dynamic range"));
}

const SPEC: &str = "camera = { frames = 2, width = 24, height = 18, sub_frames = 1, \
                    sharp_samples = 1 }\nlight = { texel = 0.4 }\n";

fn call(head: &[&str], paths: [&Path; 2], more: &[&str]) -> Ran {
    let [first, out] = paths.map(Path::as_os_str);
    let head = head.iter().map(OsStr::new).chain([first, "--out".as_ref(), out]);
    run(head.chain(more.iter().map(OsStr::new)))
}

/// All files below a folder.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("a folder").flatten().map(|entry| entry.path());
    let below = |path: PathBuf| if path.is_dir() { files(&path) } else { vec![path] };
    entries.flat_map(below).collect()
}

/// Checks the rule of output folders on `work`, which writes the file `made` into `out`.
fn keeps_the_rule(work: impl Fn(&[&str]) -> Ran, out: &Path, made: &str, stale: &str) {
    let mine = out.join("notes.txt");
    fs::create_dir_all(out).expect("a folder");
    fs::write(&mine, "mine").expect("room");
    work(&[]).exits_with(2).stderr_contains("is not empty").stderr_contains("--overwrite");
    fs::write(out.join(made), "mine").expect("room");
    work(&["--overwrite"]).exits_with(2).stderr_contains(made).stderr_contains("another folder");
    assert_eq!(fs::read_to_string(out.join(made)).ok().as_deref(), Some("mine"));
    fs::remove_file(out.join(made)).expect("a file");
    work(&["--overwrite"]).exits_with(0);
    let whole = files(out).len();
    let stale = out.join(stale);
    fs::copy(files(stale.parent().expect("a folder")).remove(0), &stale).expect("room");
    work(&[]).exits_with(2).stderr_contains("wrote before").stderr_contains("--overwrite");
    assert!(stale.is_file());
    work(&["--overwrite"]).exits_with(0);
    assert!(!stale.exists(), "a frame of the earlier work");
    assert_eq!((files(out).len(), fs::read(&mine).ok()), (whole, Some(b"mine".to_vec())));
    for file in files(out).iter().filter(|file| **file != mine) {
        fs::remove_file(file).expect("a file");
    }
}

#[test]
fn synth_and_degrade_replace_their_own_sequences_only() {
    let scratch = Scratch::new("over-synth");
    let (spec, room) = (scratch.join("small.toml"), scratch.join("room"));
    fs::write(&spec, SPEC).expect("room");
    let synth = |more: &[&str]| call(&["synth"], [&spec, &room], more);
    keeps_the_rule(synth, &room, "rgb.txt", "sharp/000777.png");
    let wrong = scratch.join("wrong.toml");
    fs::write(&wrong, "seed = 1\n[camera]\nframes = 0\n").expect("room");
    let refused = call(&["synth"], [&wrong, &scratch.join("none")], &[]).exits_with(2);
    refused.stderr_contains("wrong.toml, line 3: camera.frames = 0");
    let data = scratch.join("data");
    Scene { frames: 2, ..Scene::default() }.write(&data);
    let worse = scratch.join("worse");
    let degrade = |more: &[&str]| call(&["degrade"], [&data, &worse], more);
    keeps_the_rule(degrade, &worse, "camera.json", "rgb/000777.png");
    let beyond = |flags: &[&str]| {
        degrade(flags).exits_with(2).stderr_contains("frames 0 to 1");
    };
    beyond(&["--drop-frames", "0..90", "--overwrite"]);
    beyond(&["--cover", "1..3", "--overwrite"]);
    beyond(&["--exposure-step", "2:-1", "--overwrite"]);
    let all = degrade(&["--drop-frames", "0..2", "--overwrite"]).exits_with(2);
    all.stderr_contains("a frame must be left");
}

#[test]
fn pictures_and_lists_replace_their_own_only() {
    let scratch = Scratch::new("over-render");
    let (data, result, out) = (scratch.join("room"), scratch.join("result"), scratch.join("out"));
    Scene { frames: 3, ..Scene::default() }.write(&data);
    reconstruct(&data, &result, &["--render", "none"]).exits_with(0);
    let render = |more: &[&str]| {
        let flags = ["--frames", "0..2", "--kinds", "sharp"].iter().chain(more);
        call(&["render"], [&result, &out], &flags.copied().collect::<Vec<_>>())
    };
    keeps_the_rule(render, &out, "poses.txt", "sharp/000777.png");
    let list = scratch.join("list.txt");
    let write = |more: &[&str]| {
        let head: [&OsStr; 4] =
            ["eval".as_ref(), data.as_ref(), "--write-list".as_ref(), list.as_ref()];
        run(head.into_iter().chain(more.iter().map(OsStr::new)))
    };
    fs::write(&list, "2\n").expect("room");
    write(&["--overwrite"]).exits_with(2).stderr_contains("no list of this program");
    fs::remove_file(&list).expect("a file");
    write(&[]).exits_with(0);
    write(&[]).exits_with(2).stderr_contains("--overwrite");
    write(&["--overwrite"]).exits_with(0);
}

#[test]
fn views_are_numbered_on() {
    let scratch = Scratch::new("views");
    let (data, out) = (scratch.join("room"), scratch.join("result"));
    Scene { frames: 2, ..Scene::default() }.write(&data);
    reconstruct(&data, &out, &["--render", "none"]).exits_with(0);
    let view = |x: &str| {
        let pose = format!("{x} 0 0 0 0 0 1");
        let result = out.to_str().expect("a name");
        run(["render", result, "--pose", &pose, "--kinds", "sharp"]).exits_with(0);
    };
    view("0");
    let first = fs::read(out.join("views/sharp/000000.png")).expect("a view");
    view("-0.3");
    assert_eq!(fs::read(out.join("views/sharp/000000.png")).ok(), Some(first.clone()));
    assert!(fs::read(out.join("views/sharp/000001.png")).is_ok_and(|second| second != first));
    let poses = fs::read_to_string(out.join("views/poses.txt")).expect("poses");
    let poses: Vec<&str> = poses.lines().filter(|line| !line.starts_with('#')).collect();
    assert_eq!(poses, ["0 0 0 0 0 0 0 1", "1 -0.3 0 0 0 0 0 1"]);
}

//! Files of a result folder, and folders that are not empty: refused, or replaced on request.

use crate::program::{HEIGHT, Ran, Room, Scene, TemporaryFolder, WIDTH, i2slam, reconstruct, rows};
use std::fs;
use std::path::{Path, PathBuf};

fn frames(frames: usize) -> Scene {
    Scene { frames, ..Scene::default() }
}

#[test]
fn every_file_of_the_result_folder_is_written() {
    let room = Room::new("result", Scene::default());
    let ran = room.run(&[]).exits_with(0);
    assert_eq!(ran.out.lines().last(), room.out.join("report.html").to_str(), "{}", ran.out);
    for (file, due) in [
        ("trajectory.txt", 6),
        ("trajectory_shutter.txt", 6),
        ("frames.csv", 7),
        ("camera_response.csv", 257),
    ] {
        assert_eq!(rows(&room.out.join(file)), due, "{file}");
    }
    for file in ["camera.json", "state.json", "map.i2slam", "map.ply", "config.toml", "input.json"]
    {
        assert!(room.has(file), "{file}");
    }
    for (kind, extension) in
        [("sharp", "png"), ("blurred", "png"), ("hdr", "exr"), ("depth", "png")]
    {
        for frame in 0..6 {
            let file = format!("renders/{kind}/{frame:06}.{extension}");
            assert!(room.has(&file), "{file}");
        }
    }
    let table = room.text("frames.csv");
    let last = table.lines().last().and_then(|row| row.rsplit(',').next()).expect("a file");
    assert!(room.data.join(last).is_file() && last.contains('/'), "{last}");
    let config = room.text("config.toml");
    for part in ["i2slam_version", "seed = ", "preset = \"default\"", "final_iterations = 3"] {
        assert!(config.contains(part), "{part} is not in\n{config}");
    }
    assert_eq!(room.metric("tracked"), Some(6.0));
    let error = room.metric("ate_rmse_m").expect("ground truth lies beside the frames");
    assert!(error < 0.01, "{error}");
    let psnr = room.metric("psnr_blurred_db").expect("the input is known");
    assert!(psnr > 20.0, "{psnr}");
    let page = room.text("report.html");
    assert!(page.contains("data:image/jpeg") && page.contains("Trajectory error"));
}

#[test]
fn an_earlier_result_is_only_replaced_on_request() {
    let room = Room::reconstructed("overwrite", frames(4), &[]);
    i2slam!("render", room.out, "--pose", "0 0 0 0 0 0 1").exits_with(0);
    room.eval(&[]).exits_with(0);
    fs::write(room.out.join("notes.txt"), "mine").expect("room");
    let before = room.text("trajectory.txt");
    let refused = room.run(&["--frames", "0..2"]).exits_with(2);
    refused.stderr_contains("holds what `i2slam run` wrote before").stderr_contains("--overwrite");
    assert_eq!(room.text("trajectory.txt"), before);
    room.run(&["--frames", "0..2", "--overwrite"]).exits_with(0);
    assert_eq!(rows(&room.out.join("trajectory.txt")), 2);
    for stale in ["views", "evaluation.json", "renders/sharp/000003.png"] {
        assert!(!room.has(stale), "{stale}");
    }
    assert!(room.has("notes.txt") && room.has("renders/sharp/000001.png"));
}

#[test]
fn files_of_the_user_are_never_replaced() {
    let room = Room::new("foreign", frames(2));
    fs::create_dir(&room.out).expect("a folder");
    fs::write(room.out.join("camera.json"), "mine").expect("room");
    for flags in [&[][..], &["--overwrite"][..]] {
        let refused = room.run(flags).exits_with(2);
        refused
            .stderr_contains("holds camera.json, which would be replaced")
            .stderr_contains("another folder");
        assert_eq!(room.text("camera.json"), "mine");
        assert_eq!(fs::read_dir(&room.out).map(Iterator::count).ok(), Some(1));
    }
}

#[test]
fn renders_have_the_size_and_units_that_the_camera_says() {
    let room = Room::reconstructed("units", frames(3), &["--render", "keyframes"]);
    assert!(!room.has("renders/depth/000001.png"), "only keyframes");
    let file = fs::File::open(room.out.join("renders/depth/000000.png"));
    let file = std::io::BufReader::new(file.expect("the first keyframe"));
    let mut reader = png::Decoder::new(file).read_info().expect("a PNG");
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
    let room = Room::with_sharp("truth");
    let exposure = "frame,dt\n0,1\n1,1.1\n2,1.2\n3,1.1\n4,1\n5,0.9\n";
    fs::write(room.data.join("exposure.csv"), exposure).expect("room");
    room.run(&["--render", "none"]).exits_with(0);
    assert!(room.metric("psnr_sharp_db").is_some_and(|v| v > 20.0));
    assert_eq!(room.metric("sharp_frames"), Some(6.0));
    assert!(room.metric("ssim_sharp").is_some_and(|v| (0.5..=1.0).contains(&v)));
    assert!(room.metric("log_exposure_correlation").is_some());
    assert!(!room.has("renders"));
    let page = room.text("report.html");
    assert!(page.contains("<code>map.ply</code>") && !page.contains("<code>renders/"));
    assert!(page.contains("true log exposure"));
    // A camera of one exposure: there is nothing to correlate.
    let constant = "frame,dt\n0,1\n1,1.001\n2,1\n3,0.999\n4,1\n5,1\n";
    fs::write(room.data.join("exposure.csv"), constant).expect("room");
    room.run(&["--render", "none", "--overwrite"]).exits_with(0);
    assert!(room.metric("log_exposure_correlation").is_none());
    assert!(!room.text("report.html").contains("true log exposure"));
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    let room = Room::new("seed", Scene::default());
    let runs = [("a", "1"), ("b", "1"), ("c", "2")].map(|(name, threads)| {
        let out = room.scratch.join(name);
        let flags = ["--seed", "7", "--threads", threads, "--render", "none", "--quiet"];
        reconstruct(&room.data, &out, &flags).exits_with(0);
        let read = |file: &str| fs::read(out.join(file)).expect("a result");
        (read("trajectory.txt"), read("trajectory_shutter.txt"), read("map.i2slam"))
    });
    assert!(runs[0] == runs[1], "the same run twice");
    assert!(runs[0] == runs[2], "one thread and two");
}

/// Copies for a page change nothing.
#[test]
fn a_map_of_a_clip_has_the_same_bytes_on_any_number_of_threads() {
    let scratch = TemporaryFolder::new("seed-clip");
    let clip = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo");
    let live: [&[&str]; 2] = [&[], &["--live"]];
    let runs = [("a", "1", 0), ("b", "2", 0), ("c", "2", 1)].map(|(name, threads, page)| {
        let out = scratch.join(name);
        let flags = ["--seed", "7", "--threads", threads, "--render", "none"];
        let small = ["--frames", "0..10", "--max-side", "160"];
        let ran =
            reconstruct(&clip, &out, &[&flags[..], &small, live[page]].concat()).exits_with(0);
        assert_eq!(ran.err.contains("live view: http://127.0.0.1:"), page == 1);
        let read = |file: &str| fs::read(out.join(file)).expect("a result");
        ["trajectory.txt", "trajectory_shutter.txt", "map.i2slam"].map(read)
    });
    assert!(runs[0] == runs[1], "one thread and two");
    assert!(runs[1] == runs[2], "the same run with a page");
}

#[test]
fn module_switches_change_the_settings() {
    let flags = ["--no-blur", "--no-tone", "--no-trajectory-loss", "--virtual-cameras", "3"];
    let room = Room::reconstructed("switches", frames(3), &flags);
    let config = room.text("config.toml");
    for line in ["blur = false", "tone = false", "trajectory_loss = false", "virtual_cameras = 3"] {
        assert!(config.contains(line), "{line} is not in\n{config}");
    }
    assert!(room.text("report.html").contains("no high dynamic range"));
}

const SPEC: &str = "camera = { frames = 2, width = 24, height = 18, sub_frames = 1, \
                    sharp_samples = 1 }\nlight = { texel = 0.4 }\n";

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
    assert!(stale.is_file(), "no list names it: it is the user's");
    assert_eq!((files(out).len(), fs::read(&mine).ok()), (whole + 1, Some(b"mine".to_vec())));
    for file in files(out).iter().filter(|file| **file != mine) {
        fs::remove_file(file).expect("a file");
    }
}

#[test]
fn synth_and_degrade_replace_their_own_sequences_only() {
    let scratch = TemporaryFolder::new("over-synth");
    let (spec, room) = (scratch.join("small.toml"), scratch.join("room"));
    fs::write(&spec, SPEC).expect("room");
    let synth = |more: &[&str]| i2slam!("synth", spec, "--out", room; more);
    keeps_the_rule(synth, &room, "rgb.txt", "sharp/000777.png");
    let wrong = scratch.join("wrong.toml");
    fs::write(&wrong, "seed = 1\n[camera]\nframes = 0\n").expect("room");
    let refused = i2slam!("synth", wrong, "--out", scratch.join("none")).exits_with(2);
    refused.stderr_contains("wrong.toml, line 3: camera.frames = 0");
    let data = scratch.join("data");
    Scene { frames: 2, ..Scene::default() }.write(&data);
    let worse = scratch.join("worse");
    let degrade = |more: &[&str]| i2slam!("degrade", data, "--out", worse; more);
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
    let room = Room::reconstructed("over-render", frames(3), &["--render", "none"]);
    let (out, list) = (room.scratch.join("pictures"), room.scratch.join("list.txt"));
    let flags = ["--frames", "0..2", "--kinds", "sharp"];
    let render = |more: &[&str]| i2slam!("render", room.out, "--out", out; [&flags, more].concat());
    keeps_the_rule(render, &out, "poses.txt", "sharp/000777.png");
    let write = |more: &[&str]| i2slam!("eval", room.data, "--write-list", list; more);
    fs::write(&list, "2\n").expect("room");
    write(&["--overwrite"]).exits_with(2).stderr_contains("no list of this program");
    fs::remove_file(&list).expect("a file");
    write(&[]).exits_with(0);
    write(&[]).exits_with(2).stderr_contains("--overwrite");
    write(&["--overwrite"]).exits_with(0);
    let edited = fs::read_to_string(&list).expect("a list").replace("\n#", "\n3\n#");
    fs::write(&list, &edited).expect("room");
    write(&["--overwrite"]).exits_with(2).stderr_contains("was changed since");
    assert_eq!(fs::read_to_string(&list).ok(), Some(edited));

    // Views are numbered on.
    let view = |x: &str| {
        let pose = format!("{x} 0 0 0 0 0 1");
        i2slam!("render", room.out, "--pose", pose, "--kinds", "sharp").exits_with(0);
    };
    view("0");
    let first = fs::read(room.out.join("views/sharp/000000.png")).expect("a view");
    view("-0.3");
    assert_eq!(fs::read(room.out.join("views/sharp/000000.png")).ok(), Some(first.clone()));
    let second = fs::read(room.out.join("views/sharp/000001.png"));
    assert!(second.is_ok_and(|second| second != first));
    let poses = room.text("views/poses.txt");
    let poses: Vec<&str> = poses.lines().filter(|line| !line.starts_with('#')).collect();
    assert_eq!(poses, ["0 0 0 0 0 0 0 1", "1 -0.3 0 0 0 0 0 1"]);
}

//! Ctrl-C and SIGTERM; streams, which they end.

use crate::footage::{Footage, walk as views};
use crate::program::{Ran, Room, Running, Scene, TemporaryFolder, i2slam, number, program, rows};
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

#[test]
fn ctrl_c_leaves_a_result_that_can_be_read() {
    leaves_a_result("-INT");
}

#[test]
fn a_wish_of_the_system_leaves_a_result_too() {
    leaves_a_result("-TERM");
}

fn leaves_a_result(signal: &str) {
    let frames = 400;
    let scene = Scene { frames, step: 0.001, ..Scene::default() };
    let room = Room::new(&format!("interrupt{signal}"), scene);
    let arguments = ["run".as_ref(), room.data.as_os_str(), "--out".as_ref(), room.out.as_os_str()];
    let child = program(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // The program listens before it makes its folder.
    let begun = Instant::now();
    while !room.out.is_dir() && begun.elapsed() < Duration::from_secs(20) {
        sleep(Duration::from_millis(10));
    }
    sleep(Duration::from_millis(500));
    let sent = Command::new("kill").args([signal, &child.id().to_string()]).status();
    assert!(sent.expect("kill").success());
    let ran = Ran::from(child.wait_with_output().expect("an end")).exits_with(130);
    assert!(ran.err.contains("writing what there is"), "{}", ran.err);
    assert!(ran.out.contains("ended early"), "{}", ran.out);
    let poses = rows(&room.out.join("trajectory.txt"));
    assert!((1..frames).contains(&poses), "{poses}");
    assert_eq!(room.metric("frames"), Some(poses as f64));
    assert!(room.has("report.html"));
    i2slam!("render", room.out, "--frames", "0..1").exits_with(0);
}

#[test]
fn ctrl_c_during_the_search_leaves_no_folder() {
    let footage = Footage::new("interrupt-search");
    // Of a camera at rest there is no path.
    let video = footage.video("rest.mp4", &views(300, 0.0));
    let mut running = Running::start(&mut footage.quick("out", &video, &["--threads", "1"]));
    running.until("tracking points");
    running.interrupted().exits_with(130).stderr_contains("ended before the path");
    assert!(!footage.scratch.join("out").exists());
}

#[test]
fn ctrl_c_while_frames_are_tracked_keeps_their_path() {
    let footage = Footage::new("interrupt-tracking");
    let (video, poses) =
        (footage.video("walk.mp4", &views(300, 0.03)), footage.scratch.join("poses"));
    let to = poses.to_str().expect("a name");
    let flags = ["--threads", "1", "--fov", "63.2", "--poses", to];
    let running = Running::start(&mut footage.quick("out", &video, &flags));
    let begun = Instant::now();
    while rows_so_far(&poses) < 4 && begun.elapsed() < Duration::from_secs(60) {
        sleep(Duration::from_millis(20));
    }
    let ran = running.interrupted().exits_with(130).stderr_contains("writing what there is");
    ran.stderr_contains("neither exposure nor motion blur");
    let tracked = rows(&footage.scratch.join("out/trajectory.txt"));
    assert!((4..300).contains(&tracked), "{tracked}");
}

/// Lines of poses in a file that is being written.
fn rows_so_far(poses: &Path) -> usize {
    let is_pose = |line: &&str| !line.starts_with('#');
    fs::read_to_string(poses).map_or(0, |text| text.lines().filter(is_pose).count())
}

/// An earlier result that is complete stays where it is; the path that was found goes beside it.
#[test]
fn ctrl_c_keeps_the_path_and_the_earlier_result() {
    let footage = Footage::new("interrupt-path");
    let video = footage.video("walk.mp4", &views(24, 0.03));
    let focal = ["--fov", "63.2", "--threads", "1"];
    footage.run(&video, &focal).exits_with(0);
    let out = footage.scratch.join("out");
    let earlier = fs::read(out.join("report.html")).expect("a report");
    let slow = "--config slow.toml --map gaussian --overwrite --out out --fov 63.2";
    let slow: Vec<&str> = slow.split(' ').collect();
    let settings = "[mapping]\nfirst_iterations = 100000\n";
    fs::write(footage.scratch.join("slow.toml"), settings).expect("room");
    let interrupted = || {
        let mut command = footage.command("run", &video, &slow);
        let mut running = Running::start(command.current_dir(footage.scratch.join("")));
        running.until("mapping frames");
        running.interrupted().exits_with(130)
    };
    for name in ["out-partial", "out-partial-2"] {
        let beside = footage.scratch.join(name);
        let ran = interrupted().stderr_contains("stays").stderr_contains(name);
        let ran = ran.stderr_contains("neither exposure nor motion blur");
        assert_eq!(fs::read(out.join("report.html")).ok(), Some(earlier.clone()));
        assert_eq!(rows(&beside.join("trajectory.txt")), 24, "the whole path");
        let metrics = fs::read_to_string(beside.join("metrics.json")).expect("figures");
        let metrics: serde_json::Value = serde_json::from_str(&metrics).expect("JSON");
        assert_eq!((&metrics["complete"], &metrics["frames"]), (&false.into(), &24.into()));
        assert!(metrics["warnings"].to_string().contains("neither exposure nor motion blur"));
        assert!(["psnr_blurred_db", "blur_length_px_median"].iter().all(|f| metrics[f].is_null()));
        let report = fs::read_to_string(beside.join("report.html")).expect("a report");
        assert!(
            report.contains("A camera path, without a map,") && !report.contains("Longest blur")
        );
        let ran = ran.stderr_contains("degraded: the map is empty");
        assert!(!ran.err.contains("interrupted before all renders"), "{}", ran.err);
        let refused =
            |ran: Ran| ran.exits_with(1).stderr_contains("the map of the result is empty");
        for (format, place) in
            [("colmap", "c"), ("nerfstudio", "n"), ("video", "v.mp4"), ("ply", "p.ply")]
        {
            let place = footage.scratch.join(place);
            refused(i2slam!("export", beside, "--format", format, "-o", place));
            assert!(!place.exists(), "{format}");
        }
        refused(i2slam!("render", beside));
    }
}

/// All frames are in the result, with the map of those that were mapped.
#[test]
fn ctrl_c_while_frames_are_mapped_keeps_path_and_map() {
    let scratch = TemporaryFolder::new("interrupt-online");
    let (out, slow) = (scratch.join("out"), scratch.join("slow.toml"));
    fs::write(&slow, "[mapping]\nfirst_iterations = 100000\n").expect("room");
    let clip = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/demo");
    let paths = [&clip, Path::new("--out"), &out, Path::new("--config"), &slow];
    let mut running = Running::start(&mut program(["run".as_ref()].into_iter().chain(paths)));
    running.until("mapping frames");
    sleep(Duration::from_secs(2));
    let ran = running.interrupted().exits_with(130);
    ran.stderr_contains("writing what there is")
        .stderr_contains("neither exposure nor motion blur");
    assert!(rows(&out.join("trajectory.txt")) > 1);
    // On a busy machine no frame is mapped by then.
    let is_mapped = number(&out.join("metrics.json"), "gaussians").is_some_and(|count| count > 0.0);
    let drawn = i2slam!("render", out, "--frames", "0..1");
    match is_mapped {
        true => drawn.exits_with(0),
        false => drawn.exits_with(1).stderr_contains("the map of the result is empty"),
    };
}

/// A video of a walk, and the file of what flows when it is streamed.
fn walk(footage: &Footage) -> (PathBuf, PathBuf) {
    let video = footage.video("walk.mp4", &views(12, 0.06));
    let flow = footage.scratch.join("flow");
    fs::write(&flow, format!("{}\n", video.to_str().expect("a name"))).expect("room");
    (video, flow)
}

fn path(footage: &Footage, out: &str) -> String {
    fs::read_to_string(footage.scratch.join(out).join("trajectory.txt")).expect("a path")
}

const FLAGS: [&str; 2] = ["--fov", "63.2"];

#[test]
fn an_address_a_pipe_and_the_standard_input_are_as_good_as_a_file() {
    let footage = Footage::new("stream");
    let (video, flow) = walk(&footage);
    let from = |out: &str, source: &Path, stdin: Stdio| {
        let mut command = footage.quick(out, source, &FLAGS);
        Ran::of(command.stdin(stdin)).exits_with(0)
    };
    from("file", &video, Stdio::null());
    let due = path(&footage, "file");
    let address = Path::new("http://host/flow");
    from("address", address, Stdio::null()).stderr_contains("reading the stream http://host/flow");
    assert_eq!(path(&footage, "address"), due);
    let input = fs::read_to_string(footage.scratch.join("address/input.json")).expect("a file");
    assert!(input.contains("\"http://host/flow\""), "{input}");
    from("input", Path::new("-"), File::open(&flow).expect("a file").into());
    assert_eq!(path(&footage, "input"), due);
    let pipe = footage.scratch.join("camera");
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo").success());
    let (to, words) = (pipe.clone(), fs::read(&flow).expect("a file"));
    let camera = std::thread::spawn(move || fs::write(to, words));
    from("pipe", &pipe, Stdio::null());
    camera.join().expect("no panic").expect("somebody reads");
    assert_eq!(path(&footage, "pipe"), due);
    assert!(footage.is_tidy());
}

/// A stream with depth gives poses in metres while frames come, and the path of the file.
#[test]
fn a_stream_with_depth_is_mapped_while_it_comes() {
    let footage = Footage::new("stream-depth");
    let video = footage.video_with_depth("walk.mp4", &views(14, 0.06));
    let flow = footage.scratch.join("flow");
    fs::write(flow, format!("{}\n", video.to_str().expect("a name"))).expect("room");
    let run = |out: &str, source: &Path, more: &[&str]| {
        Ran::of(&mut footage.quick(out, source, &[&FLAGS[..], more].concat())).exits_with(0)
    };
    let address = Path::new("http://host/flow");
    run("file", &video, &[]);
    let live = run("live", address, &["--poses", "-"]).stderr_contains("tracking and mapping");
    let lines: Vec<&str> = live.out.lines().filter(|line| !line.starts_with('#')).collect();
    assert_eq!(lines.len(), 14, "{}", live.out);
    let x = |line: &str| line.split(' ').nth(1).and_then(|x| x.parse().ok()).unwrap_or(f64::NAN);
    let moved = x(lines[13]) - x(lines[0]);
    assert!((moved - 13.0 * 0.06).abs() < 0.02, "{moved}");
    for name in ["trajectory.txt", "trajectory_online.txt"] {
        let [file, live] = ["file", "live"].map(|out| footage.scratch.join(out).join(name));
        assert!(fs::read(file).expect(name) == fs::read(live).expect(name), "{name}");
    }
    let camera = Ran::of(&mut footage.quick("none", address, &[])).exits_with(2);
    camera.stderr_contains("--fov");
    run("rgb", address, &["--rgb"]).stderr_contains("tracking points");
    assert!(footage.is_tidy());
}

#[test]
fn poses_are_written_while_frames_come() {
    let footage = Footage::new("stream-poses");
    let (video, flow) = walk(&footage);
    let flags = [&FLAGS[..], &["--poses", "-"]].concat();
    let due = Ran::of(&mut footage.quick("file", &video, &flags)).exits_with(0);
    let poses = |text: &str| text.lines().filter(|line| !line.starts_with('#')).count();
    assert!(due.out.starts_with("# world_from_camera") && poses(&due.out) > 4, "{}", due.out);
    let eight_numbers = |line: &str| {
        line.split(' ')
            .filter_map(|number| number.parse().ok())
            .filter(|v: &f64| v.is_finite())
            .count()
            == 8
    };
    assert!(due.out.lines().all(|line| line.starts_with('#') || eight_numbers(line)));
    due.stderr_contains("report.html");
    // Poses come before the stream has ended.
    let file = footage.scratch.join("poses.txt");
    fs::write(flow.with_extension("endless"), "").expect("room");
    let flags = [&FLAGS[..], &["--poses", file.to_str().expect("a name")]].concat();
    let live = |out: &str| footage.quick(out, Path::new("http://host/flow"), &flags);
    let child = live("live").stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts");
    let begun = Instant::now();
    let written = || fs::read_to_string(&file).map_or(0, |text| poses(&text));
    while written() < 4 && begun.elapsed() < Duration::from_secs(60) {
        sleep(Duration::from_millis(20));
    }
    assert!(written() >= 4);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(sent.expect("kill").success());
    Ran::from(child.wait_with_output().expect("an end")).exits_with(0);
    let online = footage.scratch.join("live/trajectory_online.txt");
    let read = |path: &Path| fs::read_to_string(path).expect("poses");
    assert_eq!(read(&file).lines().count(), read(&online).lines().count());
    // An earlier file is not lost.
    let kept = read(&file);
    let mut again = footage.quick("other", Path::new("http://host/flow"), &flags);
    Ran::of(&mut again).exits_with(2).stderr_contains("FILE.previous with --overwrite");
    assert_eq!(read(&file), kept);
    fs::write(&file, "of somebody else\n").expect("room");
    let again = [&flags[..], &["--overwrite"]].concat();
    let mut again = footage.quick("live", Path::new("http://host/flow"), &again);
    Ran::of(&mut again).exits_with(2).stderr_contains("the file exists");
    assert_eq!(read(&file), "of somebody else\n");
    let inside = footage.scratch.join("live/poses.txt");
    let flags = [&FLAGS[..], &["--poses", inside.to_str().expect("a name")]].concat();
    let mut inside = footage.quick("live", Path::new("http://host/flow"), &flags);
    Ran::of(&mut inside).exits_with(2).stderr_contains("among the results");
    let flags = [&FLAGS[..], &["--poses", footage.scratch.0.to_str().expect("a name")]].concat();
    let mut folder = footage.quick("folder", Path::new("http://host/flow"), &flags);
    Ran::of(&mut folder).exits_with(2).stderr_contains("it is a folder");
    let files = ["--keyframes", "poses.txt", "--poses", "-"];
    footage.run(&video, &files).exits_with(2).stderr_contains("whose poses are known");
}

#[test]
fn ctrl_c_ends_a_live_stream_and_not_the_run() {
    let footage = Footage::new("stream-live");
    let (_, flow) = walk(&footage);
    fs::write(flow.with_extension("endless"), "").expect("room");
    let mut command = footage.quick("live", Path::new("http://host/flow"), &FLAGS);
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts");
    std::thread::sleep(Duration::from_millis(1500));
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(sent.expect("kill").success());
    let ran = Ran::from(child.wait_with_output().expect("an end")).exits_with(0);
    assert!(ran.err.contains("reconstructing what was recorded"), "{}", ran.err);
    assert!(ran.out.contains("of 12 frames"), "{}", ran.out);
    assert!(!path(&footage, "live").is_empty() && footage.is_tidy());
}

#[test]
fn streams_that_cannot_be_used_are_told_and_leave_nothing() {
    let footage = Footage::new("stream-bad");
    let (_, flow) = walk(&footage);
    fs::write(footage.scratch.join("silence"), "").expect("room");
    let silent = Path::new("http://host/silence");
    footage.run(silent, &[]).exits_with(1).stderr_contains("no frame of it can be decoded");
    footage.run(Path::new("rtsp://host/nowhere"), &[]).exits_with(1).stderr_contains("nowhere");
    let address = Path::new("http://host/flow");
    footage.i2slam("info", address, &[]).exits_with(1).stderr_contains("record it first");
    let files = ["--rgb", "--keyframes", "poses.txt"];
    footage.run(address, &files).exits_with(2).stderr_contains("goes with a file or a folder");
    let list = footage.scratch.join("list.txt");
    fs::write(&list, "3\n").expect("room");
    let list = ["--hold-out", list.to_str().expect("UTF-8")];
    footage.run(address, &list).exits_with(2).stderr_contains("frames are not known yet");
    // What lies in the way is said before a stream is read that may have no end.
    fs::write(flow.with_extension("endless"), "").expect("room");
    let out = footage.scratch.join("out");
    fs::create_dir_all(&out).expect("room");
    fs::write(out.join("mine.txt"), "mine").expect("room");
    footage.run(address, &[]).exits_with(2).stderr_contains("--overwrite");
    assert!(footage.is_tidy());
}

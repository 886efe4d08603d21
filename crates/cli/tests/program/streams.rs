//! Streams: what is no file and flows once.

use crate::footage::{Footage, View};
use crate::tools::Ran;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// A video of a walk, and the file of what flows when it is streamed.
fn walk(footage: &Footage) -> (PathBuf, PathBuf) {
    let views: Vec<(u32, View)> =
        (0..12).map(|i| (20 * i, View::moved(0.06 * f64::from(i)))).collect();
    let video = footage.video("walk.mp4", &views);
    let flow = footage.scratch.join("flow");
    fs::write(&flow, video.to_str().expect("a name")).expect("room");
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
        Ran::of(command.stdin(stdin).output().expect("starts")).ended_with(0)
    };
    from("file", &video, Stdio::null());
    let due = path(&footage, "file");
    let address = Path::new("http://host/flow");
    from("address", address, Stdio::null()).complaining("reading the stream http://host/flow");
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
    let ran = Ran::of(child.wait_with_output().expect("an end")).ended_with(0);
    assert!(ran.err.contains("going on with what came"), "{}", ran.err);
    assert!(ran.out.contains("of 12 frames"), "{}", ran.out);
    assert!(!path(&footage, "live").is_empty() && footage.is_tidy());
}

#[test]
fn streams_that_cannot_be_used_are_told_and_leave_nothing() {
    let footage = Footage::new("stream-bad");
    let (_, flow) = walk(&footage);
    fs::write(footage.scratch.join("silence"), "").expect("room");
    let silent = Path::new("http://host/silence");
    footage.run(silent, &[]).ended_with(1).complaining("no frame of it can be decoded");
    footage.run(Path::new("rtsp://host/nowhere"), &[]).ended_with(1).complaining("nowhere");
    let address = Path::new("http://host/flow");
    footage.i2slam("info", address, &[]).ended_with(1).complaining("record it first");
    let files = ["--rgb", "--keyframes", "poses.txt"];
    footage.run(address, &files).ended_with(2).complaining("goes with a file or a folder");
    // What lies in the way is said before a stream is read that may have no end.
    fs::write(flow.with_extension("endless"), "").expect("room");
    let out = footage.scratch.join("out");
    fs::create_dir_all(&out).expect("room");
    fs::write(out.join("mine.txt"), "mine").expect("room");
    footage.run(address, &[]).ended_with(2).complaining("--overwrite");
    assert!(footage.is_tidy());
}

//! Ctrl-C.

#![cfg(unix)]

use crate::footage::{Footage, View};
use crate::scene::Scene;
use crate::tools::{Ran, Running, Scratch, number, program, rows, run};
use std::fs;
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
    let scratch = Scratch::new(&format!("interrupt{signal}"));
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    let frames = 400;
    Scene { frames, step: 0.001, ..Scene::default() }.write(&data);
    let arguments = ["run".as_ref(), data.as_os_str(), "--out".as_ref(), out.as_os_str()];
    let child = program(arguments)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    // The program listens before it makes its folder.
    let begun = Instant::now();
    while !out.is_dir() && begun.elapsed() < Duration::from_secs(20) {
        sleep(Duration::from_millis(10));
    }
    sleep(Duration::from_millis(500));
    let sent = Command::new("kill").args([signal, &child.id().to_string()]).status();
    assert!(sent.expect("kill").success());
    let ran = Ran::of(child.wait_with_output().expect("an end")).ended_with(130);
    assert!(ran.err.contains("writing what there is"), "{}", ran.err);
    assert!(ran.out.contains("ended early"), "{}", ran.out);
    let poses = rows(&out.join("trajectory.txt"));
    assert!((1..frames).contains(&poses), "{poses}");
    assert_eq!(number(&out.join("metrics.json"), "frames"), Some(poses as f64));
    assert!(out.join("report.html").is_file());
    run(["render".as_ref(), out.as_os_str(), "--frames".as_ref(), "0..1".as_ref()]).ended_with(0);
}

/// Steps to the right through the made-up scene.
fn walk(frames: u32) -> Vec<(u32, View)> {
    (0..frames).map(|i| (20 * i, View::moved(0.03 * f64::from(i)))).collect()
}

#[test]
fn ctrl_c_during_the_search_leaves_no_folder() {
    let footage = Footage::new("interrupt-search");
    let video = footage.video("walk.mp4", &walk(300));
    let mut running = Running::start(&mut footage.quick("out", &video, &["--threads", "1"]));
    running.until("following points");
    running.interrupted().ended_with(130).complaining("ended before the path");
    assert!(!footage.scratch.join("out").exists());
}

/// An earlier result that is complete stays where it is; the path that was found goes beside it.
#[test]
fn ctrl_c_keeps_the_path_and_the_earlier_result() {
    let footage = Footage::new("interrupt-path");
    let video = footage.video("walk.mp4", &walk(24));
    let focal = ["--fov", "63.2", "--threads", "1"];
    footage.run(&video, &focal).ended_with(0);
    let (out, beside) = (footage.scratch.join("out"), footage.scratch.join("out-partial"));
    let earlier = fs::read(out.join("report.html")).expect("a report");
    let slow = [
        "--config",
        "slow.toml",
        "--map",
        "gaussian",
        "--overwrite",
        "--out",
        "out",
        "--fov",
        "63.2",
    ];
    let settings = "[mapping]\nfirst_iterations = 100000\n";
    fs::write(footage.scratch.join("slow.toml"), settings).expect("room");
    let interrupted = || {
        let mut command = footage.command("run", &video, &slow);
        let mut running = Running::start(command.current_dir(footage.scratch.join("")));
        running.until("keyframes");
        running.interrupted().ended_with(130)
    };
    for _ in 0..2 {
        let ran = interrupted().complaining("stays").complaining("out-partial");
        ran.complaining("those of the front end");
        assert_eq!(fs::read(out.join("report.html")).ok(), Some(earlier.clone()));
        assert_eq!(rows(&beside.join("trajectory.txt")), 24, "the whole path");
        let metrics = fs::read_to_string(beside.join("metrics.json")).expect("figures");
        let metrics: serde_json::Value = serde_json::from_str(&metrics).expect("JSON");
        assert_eq!((&metrics["complete"], &metrics["frames"]), (&false.into(), &24.into()));
        assert!(metrics["warnings"].to_string().contains("those of the front end"));
        assert!(!footage.scratch.join("out-partial-2").exists(), "a part is replaced");
    }
}

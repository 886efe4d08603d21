//! Ctrl-C.

#![cfg(unix)]

use crate::scene::Scene;
use crate::tools::{Ran, Scratch, number, program, rows, run};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

#[test]
fn ctrl_c_leaves_a_result_that_can_be_read() {
    let scratch = Scratch::new("interrupt");
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
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
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

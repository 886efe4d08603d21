//! Folders that hold something: refused, replaced on request, and only what was written before.

use crate::scene::Scene;
use crate::tools::{Ran, Scratch, reconstruct, run};
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

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

/// What every such command does: `work` writes into the folder `out`, whose file `made` it makes.
fn keeps_the_rule(work: impl Fn(&[&str]) -> Ran, out: &Path, made: &str, stale: &str) {
    let mine = out.join("notes.txt");
    fs::create_dir_all(out).expect("a folder");
    fs::write(&mine, "mine").expect("room");
    work(&[]).ended_with(2).complaining("is not empty").complaining("--overwrite");
    fs::write(out.join(made), "mine").expect("room");
    work(&["--overwrite"]).ended_with(2).complaining(made).complaining("another folder");
    assert_eq!(fs::read_to_string(out.join(made)).ok().as_deref(), Some("mine"));
    fs::remove_file(out.join(made)).expect("a file");
    work(&["--overwrite"]).ended_with(0);
    let whole = files(out).len();
    let stale = out.join(stale);
    fs::copy(files(stale.parent().expect("a folder")).remove(0), &stale).expect("room");
    work(&[]).ended_with(2).complaining("wrote before").complaining("--overwrite");
    assert!(stale.is_file());
    work(&["--overwrite"]).ended_with(0);
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
    let refused = call(&["synth"], [&wrong, &scratch.join("none")], &[]).ended_with(2);
    refused.complaining("wrong.toml, line 3: camera.frames = 0");
    let data = scratch.join("data");
    Scene { frames: 2, ..Scene::default() }.write(&data);
    let worse = scratch.join("worse");
    let degrade = |more: &[&str]| call(&["degrade"], [&data, &worse], more);
    keeps_the_rule(degrade, &worse, "camera.json", "rgb/000777.png");
    let beyond = |flags: &[&str]| {
        degrade(flags).ended_with(2).complaining("frames 0 to 1");
    };
    beyond(&["--drop-frames", "0..90", "--overwrite"]);
    beyond(&["--cover", "1..3", "--overwrite"]);
    beyond(&["--exposure-step", "2:-1", "--overwrite"]);
    let all = degrade(&["--drop-frames", "0..2", "--overwrite"]).ended_with(2);
    all.complaining("a frame must be left");
}

#[test]
fn pictures_and_lists_replace_their_own_only() {
    let scratch = Scratch::new("over-render");
    let (data, result, out) = (scratch.join("room"), scratch.join("result"), scratch.join("out"));
    Scene { frames: 3, ..Scene::default() }.write(&data);
    reconstruct(&data, &result, &["--render", "none"]).ended_with(0);
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
    write(&["--overwrite"]).ended_with(2).complaining("no list of this program");
    fs::remove_file(&list).expect("a file");
    write(&[]).ended_with(0);
    write(&[]).ended_with(2).complaining("--overwrite");
    write(&["--overwrite"]).ended_with(0);
}

#[test]
fn views_are_numbered_on() {
    let scratch = Scratch::new("views");
    let (data, out) = (scratch.join("room"), scratch.join("result"));
    Scene { frames: 2, ..Scene::default() }.write(&data);
    reconstruct(&data, &out, &["--render", "none"]).ended_with(0);
    let view = |x: &str| {
        let pose = format!("{x} 0 0 0 0 0 1");
        let result = out.to_str().expect("a name");
        run(["render", result, "--pose", &pose, "--kinds", "sharp"]).ended_with(0);
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

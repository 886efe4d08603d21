//! Nothing of the user's is lost: links, files of others, two runs at once, kills, full disks.

use crate::program::{Ran, Room, Running, Scene, TemporaryFolder, i2slam, program};
use i2slam_check::names;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

fn frames(frames: usize) -> Scene {
    Scene { frames, ..Scene::default() }
}

/// Every file below a folder with its bytes, hidden ones and links left out.
fn contents(folder: &Path) -> Vec<(PathBuf, Vec<u8>)> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let (path, kind) = (entry.path(), entry.file_type().expect("a kind"));
        if entry.file_name().to_string_lossy().starts_with('.') || kind.is_symlink() {
            continue;
        }
        match kind.is_dir() {
            true => found.extend(contents(&path)),
            false => found.push((path.clone(), fs::read(&path).expect("a file"))),
        }
    }
    found.sort();
    found
}

/// Asserts that a result is complete, and that its files are those of its manifest.
#[track_caller]
fn assert_whole(out: &Path, case: &str) {
    let manifest = i2slam_storage::Manifest::of(out).unwrap_or_else(|| panic!("{case}: no list"));
    for (name, record) in &manifest.files {
        let bytes = fs::read(out.join(name)).unwrap_or_else(|e| panic!("{case}: {name}: {e}"));
        assert_eq!(bytes.len() as u64, record.bytes, "{case}: {name}");
        let sum = format!("{:08x}", crc32fast::hash(&bytes));
        assert_eq!(sum, record.crc32, "{case}: {name}");
    }
    if manifest.command == "i2slam run" {
        let metrics = fs::read_to_string(out.join("metrics.json")).expect("metrics");
        assert!(metrics.contains("\"complete\": true"), "{case}: {metrics}");
    }
}

#[test]
#[cfg(unix)]
fn a_demo_replaces_demos_alone() {
    let room = Room::new("demo-in-result", frames(2));
    room.run(&["--render", "keyframes"]).exits_with(0);
    let (result, mine) = (contents(&room.out), room.scratch.join("mine"));
    fs::create_dir(&mine).expect("room");
    fs::write(mine.join("a.rs"), "mine").expect("room");
    for folder in [&room.out, &mine] {
        i2slam!("demo", "--out", folder).exits_with(2).stderr_contains("and no earlier demo");
    }
    assert_eq!(contents(&room.out), result);
    assert_eq!(contents(&mine).len(), 1);
    let demo = room.scratch.join("demo");
    let begins = || {
        let mut running = Running::start(
            program([OsStr::new("demo"), "--out".as_ref(), demo.as_ref()]).env("NO_COLOR", "1"),
        );
        running.until("this will take about");
        running
    };
    for _ in 0..2 {
        drop(begins().interrupted());
        assert!(demo.join("clip/rgb.txt").is_file());
    }
}

#[test]
#[cfg(target_os = "linux")]
fn what_cannot_be_printed_is_a_failure() {
    let full = fs::OpenOptions::new().write(true).open("/dev/full").expect("a full disk");
    let ran = Ran::from(
        program(["presets", "default"]).stdout(full).stderr(Stdio::piped()).output().expect("runs"),
    );
    ran.exits_with(1).stderr_contains("cannot write to standard output");
}

#[test]
#[cfg(unix)]
fn no_file_is_written_or_removed_through_a_link() {
    use std::os::unix::fs::symlink;
    let room = Room::new("links", frames(2));
    let mine = room.scratch.join("mine.txt");
    fs::write(&mine, "mine").expect("room");
    fs::create_dir(&room.out).expect("room");
    for name in [".i2slam-probe", ".map.ply.partial", "map.ply.partial"] {
        symlink(&mine, room.out.join(name)).expect("a link");
    }
    fs::remove_file(room.out.join("map.ply.partial")).expect("a link");
    room.run(&["--render", "keyframes"]).exits_with(0);
    assert_eq!(fs::read_to_string(&mine).ok().as_deref(), Some("mine"));
    assert!(room.out.join(".i2slam-probe").is_symlink(), "links of the user stay");
    fs::remove_file(room.out.join(".i2slam-probe")).expect("a link");
    fs::write(room.out.join(".i2slam-probe"), "mine").expect("room");
    let photos = room.scratch.join("photos");
    fs::rename(room.out.join("renders"), &photos).expect("moved by the user");
    symlink("../photos", room.out.join("renders")).expect("a link");
    let before = contents(&photos);
    room.run(&["--overwrite"]).exits_with(2).stderr_contains("renders");
    i2slam!("render", room.out, "--frames", "0..1").exits_with(2).stderr_contains("renders");
    assert_eq!(contents(&photos), before);
    assert_eq!(fs::read_to_string(room.out.join(".i2slam-probe")).ok().as_deref(), Some("mine"));
}

#[test]
fn a_folder_is_replaced_only_by_its_list() {
    let scratch = TemporaryFolder::new("no-list");
    // The output of --print-spec is no proof that synth wrote the folder.
    let specified = scratch.join("specified");
    fs::create_dir_all(specified.join("rgb")).expect("room");
    let spec = i2slam!("synth", "--print-spec").exits_with(0).out;
    fs::write(specified.join("spec.toml"), spec).expect("room");
    for name in ["rgb/000099.png", "camera.json", "groundtruth.txt", "README.md"] {
        fs::write(specified.join(name), "mine").expect("room");
    }
    let synth = |spec: &Path| i2slam!("synth", spec, "--out", specified, "--overwrite");
    let before = contents(&specified);
    synth(&specified.join("spec.toml")).exits_with(2).stderr_contains("another folder");
    assert_eq!(contents(&specified), before);
    // Nor is a table of frames, or a README that names the program.
    let data = scratch.join("data");
    frames(2).write(&data);
    for (name, text) in [("frames.csv", "x"), ("README.md", "Made by `i2slam degrade`")] {
        let copied = scratch.join(name);
        frames(2).write(&copied);
        fs::write(copied.join(name), text).expect("room");
        let before = contents(&copied);
        let run = i2slam!("run", data, "--out", copied, "--overwrite").exits_with(2);
        run.stderr_contains("another folder");
        i2slam!("degrade", data, "--out", copied, "--overwrite").exits_with(2);
        assert_eq!(contents(&copied), before);
    }
}

#[test]
fn a_result_that_was_changed_is_not_replaced() {
    let room = Room::reconstructed("changed", frames(2), &["--render", "none"]);
    fs::write(room.out.join("trajectory.txt"), "smoothed by hand").expect("room");
    let before = contents(&room.out);
    room.run(&["--overwrite"]).exits_with(2).stderr_contains("trajectory.txt");
    assert_eq!(contents(&room.out), before);
    // Pictures are added all the same.
    i2slam!("render", room.out, "--frames", "0..1", "--kinds", "sharp").exits_with(0);
    assert_eq!(room.text("trajectory.txt"), "smoothed by hand");
}

#[test]
fn a_second_run_into_a_folder_is_refused_until_the_first_is_dead() {
    let room = Room::new("two-runs", Scene { frames: 400, step: 0.001, ..Scene::default() });
    let arguments = ["run".as_ref(), room.data.as_os_str(), "--out".as_ref(), room.out.as_os_str()];
    let mut first = program(arguments);
    let mut first = first.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts");
    while !room.out.join(".i2slam-lock").exists() {
        sleep(Duration::from_millis(5));
    }
    let quick = ["--frames", "0..2", "--render", "none"];
    let second = room.run(&quick).exits_with(1);
    second.stderr_contains("is being written by process").stderr_contains("another folder");
    first.kill().expect("it runs");
    first.wait().expect("its end");
    room.run(&quick).exits_with(0);
    assert_whole(&room.out, "after a kill");
    assert_eq!(names(&room.scratch.0), ["out", "out.quick.toml", "room"], "dead work is removed");
    assert!(!names(&room.out).iter().any(|name| name.starts_with('.')));
}

#[test]
fn the_current_folder_can_be_the_output() {
    let room = Room::new("current", frames(2));
    fs::create_dir_all(room.out.join("deep")).expect("room");
    let run = |folder: &Path, out: &str, more: &[&str]| {
        let flags = ["--out", out, "--render", "none", "--quiet"];
        let mut command = program(["run"]);
        command.arg(&room.data).args(flags).args(more).args(["--frames", "0..2"]);
        Ran::of(command.current_dir(folder)).exits_with(0)
    };
    run(&room.out, ".", &["--overwrite"]);
    assert_whole(&room.out, "first");
    fs::write(room.out.join("deep/notes.txt"), "mine").expect("room");
    run(&room.out.join("deep"), "..", &["--overwrite", "--seed", "3"]);
    assert_whole(&room.out, "second");
    assert_eq!(fs::read_to_string(room.out.join("deep/notes.txt")).ok().as_deref(), Some("mine"));
    assert!(!names(&room.out).iter().any(|name| name.starts_with('.')));
}

/// A command that replaces or extends the result in `out`.
struct Work {
    name: &'static str,
    arguments: Vec<String>,
}

fn works(room: &Room) -> [Work; 3] {
    let text = |path: &Path| path.display().to_string();
    let (data, out) = (text(&room.data), text(&room.out));
    let run = ["run", &data, "--out", &out, "--overwrite", "--quiet"];
    let quick = room.out.with_extension("quick.toml").display().to_string();
    let run = run.iter().map(|&word| word.to_owned()).chain(["--config".to_owned(), quick]);
    let words = |words: &[&str]| words.iter().map(|&word| word.to_owned()).collect();
    [
        Work { name: "run", arguments: run.collect() },
        Work { name: "render", arguments: words(&["render", &out, "--pose", "0 0 0 0 0 0 1"]) },
        Work { name: "eval", arguments: words(&["eval", &out]) },
    ]
}

/// Whether a result is being prepared: a hidden folder beside it, or inside, with files.
fn is_writing(room: &Room) -> bool {
    let hidden = |folder: &Path| -> Vec<PathBuf> {
        let hidden =
            names(folder).into_iter().filter(|n| n.starts_with('.') && n.contains("i2slam-"));
        hidden.map(|name| folder.join(name)).filter(|path| path.is_dir()).collect()
    };
    let staged = hidden(&room.scratch.0).into_iter().chain(hidden(&room.out));
    staged.into_iter().any(|folder| names(&folder).iter().any(|name| name != ".i2slam-lock"))
}

/// Kills each command at `count` moments while it writes, and before; asserts that the earlier or
/// the new result is whole each time. Returns how many kills struck while files were written.
fn kill_at_random(room: &Room, count: u64) -> u64 {
    let mut struck = 0;
    for work in works(room) {
        let start = || {
            let mut command = program(&work.arguments);
            command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("it starts")
        };
        let wait_for_files = |child: &mut Child| {
            while !is_writing(room) && child.try_wait().expect("a state").is_none() {
                std::thread::yield_now();
            }
        };
        let mut whole = start();
        wait_for_files(&mut whole);
        let begun = Instant::now();
        assert!(whole.wait().expect("its end").success(), "{}", work.name);
        // The end of the process takes part of it.
        let window = begun.elapsed().as_micros() as u64 * 6 / 10 + 1;
        for kill in 0..count {
            let mut child = start();
            // Every eighth kill comes at any time, the others while files are written.
            if kill % 8 == 0 {
                sleep(Duration::from_millis(kill * 37 % 300));
            } else {
                wait_for_files(&mut child);
                sleep(Duration::from_micros(kill * 7_919_993 % window));
            }
            struck += u64::from(is_writing(room));
            child.kill().ok();
            child.wait().expect("its end");
            let case = format!("{}, kill {kill}", work.name);
            assert_whole(&room.out, &case);
            assert_eq!(room.text("notes.txt"), "mine", "{case}");
            i2slam_storage::recover(&room.out);
            assert_whole(&room.out, &case);
            // What was found is kept although its pictures were not drawn.
            for name in names(&room.scratch.0).iter().filter(|name| name.contains("-partial")) {
                assert!(!names(&room.scratch.join(name)).is_empty(), "{case}");
                fs::remove_dir_all(room.scratch.join(name)).expect("a folder");
            }
            assert_eq!(room.text("notes.txt"), "mine", "{case}");
        }
    }
    struck
}

fn room_to_be_killed(name: &str) -> Room {
    let room = Room::reconstructed(name, frames(4), &[]);
    fs::write(room.out.join("notes.txt"), "mine").expect("room");
    room
}

#[test]
fn a_kill_leaves_the_earlier_or_the_new_result() {
    let room = room_to_be_killed("kills");
    kill_at_random(&room, 6);
    room.eval(&[]).exits_with(0);
    assert_whole(&room.out, "at the end");
    assert_eq!(names(&room.scratch.0), ["out", "out.quick.toml", "room"], "dead work is removed");
}

#[test]
#[ignore = "minutes: `just lose-nothing`"]
fn a_hundred_kills_leave_a_whole_result() {
    let room = room_to_be_killed("hundred-kills");
    let struck = kill_at_random(&room, 100);
    println!("300 kills, {struck} of them while files were written: 300 whole results");
    assert!(struck >= 150, "only {struck} of 300 while files were written");
}

/// A file system of a given size.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn new(folder: PathBuf, kilobytes: u64) -> Self {
        fs::create_dir_all(&folder).expect("a folder");
        let size = format!("size={kilobytes}k");
        let mut mount = std::process::Command::new("mount");
        mount.args(["-t", "tmpfs", "-o", &size, "tmpfs"]).arg(&folder);
        assert!(mount.status().is_ok_and(|status| status.success()), "needs the right to mount");
        Self(folder)
    }

    fn resize(&self, kilobytes: u64) {
        let size = format!("remount,size={kilobytes}k");
        let mut mount = std::process::Command::new("mount");
        mount.args(["-o", &size]).arg(&self.0);
        assert!(mount.status().is_ok_and(|status| status.success()), "a new size");
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        std::process::Command::new("umount").arg(&self.0).status().ok();
    }
}

#[test]
#[ignore = "needs the right to mount: `just lose-nothing`"]
fn a_full_disk_leaves_the_earlier_result() {
    let mut room = Room::new("full-disk", frames(4));
    let disk = SmallDisk::new(room.scratch.join("disk"), 65_536);
    room.out = disk.0.join("out");
    room.run(&[]).exits_with(0);
    let (mut kept, mut replaced) = (0, 0);
    for step in 0..20 {
        for work in works(&room) {
            let before = contents(&room.out);
            let pages = before.iter().map(|(_, bytes)| bytes.len().div_ceil(4096) as u64);
            let used = 4 * (pages.sum::<u64>() + 4);
            // A run needs room for a whole result, the others for what they add.
            let unit = if work.name == "run" { used / 14 } else { 12 };
            disk.resize(used + step * unit);
            let ran = Ran::of(&mut program(&work.arguments));
            assert_whole(&room.out, &format!("{}, size {step}", work.name));
            match ran.err.contains("no space left") {
                true => {
                    assert_eq!(contents(&room.out), before, "{}, size {step}", work.name);
                    kept += 1;
                }
                false => {
                    ran.exits_with(0);
                    replaced += 1;
                }
            }
            // What was saved of the run goes, so that the next has as much room.
            for name in names(&disk.0).iter().filter(|name| name.starts_with("out-")) {
                fs::remove_dir_all(disk.0.join(name)).expect("a folder");
            }
        }
    }
    println!(
        "60 commands at 20 sizes: {kept} kept the earlier result, {replaced} hold the new one"
    );
    assert!(kept >= 10 && replaced >= 10, "{kept} {replaced}");
}

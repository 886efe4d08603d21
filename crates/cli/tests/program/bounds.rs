//! Files that never end and pictures that claim to be huge, given to every command.

use crate::program::{Ran, Room, Scene, i2slam, program, write_colour};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// A named pipe without a writer, in place of whatever is there.
fn pipe(path: PathBuf) -> PathBuf {
    fs::remove_file(&path).ok();
    let made = Command::new("mkfifo").arg(&path).status();
    assert!(made.is_ok_and(|status| status.success()), "mkfifo");
    path
}

/// Refused with a message that names the file; a pipe that is opened would wait for ever.
#[track_caller]
fn refused(ran: Ran, code: i32, file: &str) {
    ran.exits_with(code).stderr_contains(file).stderr_contains("no regular file");
}

#[test]
fn pipes_in_place_of_files_are_refused_by_every_command() {
    let room = Room::reconstructed("bounds-pipes", Scene::default(), &[]);
    let fifo = pipe(room.scratch.join("fifo"));
    let new = room.scratch.join("new");
    refused(i2slam!("eval", fifo, "--groundtruth", fifo), 1, "fifo");
    let truth = room.data.join("groundtruth.txt");
    refused(i2slam!("eval", "/dev/zero", "--groundtruth", truth), 1, "/dev/zero");
    refused(i2slam!("eval", room.out, "--reference", room.data, "--list", fifo), 1, "fifo");
    refused(i2slam!("render", room.out, "--poses", fifo), 1, "fifo");
    refused(i2slam!("run", room.data, "--config", fifo, "--out", new), 1, "fifo");
    refused(i2slam!("run", room.data, "--rgb", "--keyframes", fifo, "--out", new), 1, "fifo");
    refused(i2slam!("synth", fifo, "--out", new), 1, "fifo");
    refused(i2slam!("info", "/dev/zero"), 1, "/dev/zero");
    pipe(room.data.join("rgb.txt"));
    refused(i2slam!("info", room.data), 1, "rgb.txt");
    refused(i2slam!("run", room.data, "--out", new), 1, "rgb.txt");
    refused(i2slam!("degrade", room.data, "--out", new, "--drop", "0.2"), 1, "rgb.txt");
    pipe(room.out.join("map.i2slam"));
    i2slam!("render", room.out).exits_with(2);
}

/// Colour pictures of a folder, in order.
fn pictures(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).expect("pictures").flatten();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    files.sort();
    files
}

/// Address space [kB]: five times what a run of tiny pictures needs, and less than the 1 GB that
/// decoding the picture below takes.
const ADDRESS_SPACE: &str = "700000";

#[test]
#[cfg(target_os = "linux")]
fn an_oversize_picture_takes_no_memory_and_ends_no_run() {
    let room = Room::new("bounds-oversize", Scene::default());
    let files = pictures(&room.data.join("rgb"));
    // Black, so that it compresses to little.
    write_colour(&files[2], (8000, 8000), &vec![0; 3 * 8000 * 8000]);
    let limited = |arguments: &[&Path]| {
        let inner = program(arguments);
        let mut command = Command::new("sh");
        command.args(["-c", "ulimit -v \"$0\" && exec \"$@\"", ADDRESS_SPACE]);
        command.arg(inner.get_program()).args(inner.get_args());
        // Every thread reserves address space of its own.
        command.env("RAYON_NUM_THREADS", "2").env("MALLOC_ARENA_MAX", "1");
        Ran::of(&mut command)
    };
    let [info, run, out, threads, two] = ["info", "run", "--out", "--threads", "2"].map(Path::new);
    let told = limited(&[info, &room.data]).exits_with(0);
    assert!(told.out.contains("is 8000x8000 px, expected 48x36"), "{}", told.out);
    let ran = limited(&[run, &room.data, out, &room.out, threads, two]).exits_with(0);
    ran.stderr_contains("frame left out").stderr_contains("is 8000x8000 px, expected 48x36");
}

//! Names that would steer the terminal, or pretend to be lines of the program.

use crate::program::{TemporaryFolder, i2slam, run};
use std::ffi::{OsStr, OsString};
use std::fs;
use std::os::unix::ffi::OsStringExt;

/// A name that clears the screen, turns the text and begins a line.
const NAME: &str = "a\u{1b}[2J\u{202e}\u{9b}31m\r\nerror: all is well";

#[track_caller]
fn assert_harmless(text: &str) {
    for steering in ['\u{1b}', '\u{202e}', '\u{9b}', '\r'] {
        assert!(!text.contains(steering), "{text:?}");
    }
    assert!(!text.contains("\nerror: all is well"), "{text:?}");
    assert!(text.contains("a\\u001b[2J\\u202e\\u009b31m\\u000d\\nerror: all is well"), "{text:?}");
}

#[test]
fn names_of_files_are_escaped() {
    let scratch = TemporaryFolder::new("terminal");
    let folder = scratch.join(NAME);
    assert_harmless(&i2slam!("info", folder).exits_with(2).err);
    fs::create_dir(&folder).expect("a folder");
    fs::write(folder.join("notes.md"), "").expect("room");
    // A message of several lines.
    let message = i2slam!("info", folder).exits_with(2).err;
    assert_harmless(&message);
    assert!(message.contains("\n  TUM RGB-D"), "{message}");
    fs::write(folder.join("settings.toml"), "\"k\u{9b}31m\" = 1\n").expect("room");
    let toml = folder.join("settings.toml");
    let refusal = i2slam!("run", folder, "--out", scratch.join("out"), "--config", toml);
    assert_harmless(&refusal.exits_with(2).err);
}

#[test]
fn wrong_arguments_are_escaped() {
    assert_harmless(&run(["info", "room", &format!("--{NAME}")]).exits_with(2).err);
    assert_harmless(&run(["run", "room", "--out", "o", "--seed", NAME]).exits_with(2).err);
    let bytes = [NAME.as_bytes(), &[0xff]].concat();
    let refused = run([OsStr::new("presets"), OsStr::new("a"), &OsString::from_vec(bytes)]);
    assert_harmless(&refused.exits_with(2).err);
}

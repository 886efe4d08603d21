//! A recording of a short run, read back.

use i2slam_check::{Ran, TemporaryFolder};
use re_chunk::Chunk;
use re_log_encoding::DecoderApp;
use re_log_types::LogMsg;
use re_sdk_types::archetypes::TextLog;
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn i2slam(arguments: &[&dyn AsRef<OsStr>]) -> Ran {
    let arguments = arguments.iter().map(AsRef::as_ref);
    Ran::of(Command::new(env!("CARGO_BIN_EXE_i2slam")).args(arguments))
}

fn chunks(recording: &Path) -> Vec<Chunk> {
    let bytes = fs::read(recording).expect("a recording");
    let messages = DecoderApp::decode_lazy(bytes.as_slice());
    let chunk = |message| match message {
        LogMsg::ArrowMsg(_, message) => Some(Chunk::from_arrow_msg(&message).expect("a chunk")),
        _ => None,
    };
    messages.filter_map(|message| chunk(message.expect("a message"))).collect()
}

/// Rows of every entity, and the timelines of its last chunk.
fn entities(chunks: &[Chunk]) -> BTreeMap<String, (usize, Vec<String>)> {
    let mut found = BTreeMap::<String, (usize, Vec<String>)>::new();
    for chunk in chunks {
        let entry = found.entry(chunk.entity_path().to_string()).or_default();
        entry.0 += chunk.num_rows();
        entry.1 = chunk.timelines().keys().map(ToString::to_string).collect();
        entry.1.sort();
    }
    found
}

/// Texts of the marks of keyframes.
fn marks(chunks: &[Chunk]) -> Vec<String> {
    let text = TextLog::descriptor_text().component;
    let marked = chunks.iter().filter(|chunk| chunk.entity_path().to_string() == "/keyframes");
    marked
        .flat_map(|chunk| chunk.iter_slices::<String>(text))
        .flat_map(|texts| texts.iter().map(ToString::to_string).collect::<Vec<_>>())
        .collect()
}

/// A rendered sequence of twelve frames.
fn room(scratch: &TemporaryFolder) -> PathBuf {
    let (spec, data) = (scratch.join("spec.toml"), scratch.join("room"));
    fs::write(&spec, "[camera]\nframes = 12\nwidth = 96\nheight = 72\nsub_frames = 4\n")
        .expect("room");
    i2slam(&[&"synth", &spec, &"--out", &data]).exits_with(0);
    data
}

#[test]
fn a_run_is_recorded() {
    let scratch = TemporaryFolder::new("rerun");
    let (data, out, recording) = (room(&scratch), scratch.join("out"), scratch.join("run.rrd"));
    let run = |flags: &[&dyn AsRef<OsStr>]| {
        let all: [&dyn AsRef<OsStr>; 8] =
            [&"run", &data, &"--out", &out, &"--rerun", &recording, &"--render", &"none"];
        i2slam(&[all.as_slice(), flags].concat())
    };
    run(&[]).exits_with(0);
    let recorded = chunks(&recording);
    let found = entities(&recorded);
    let rows = |entity: &str| found.get(entity).map(|(rows, _)| *rows);
    for entity in ["camera", "camera/picture"].map(|name| format!("/world/{name}")) {
        assert_eq!(rows(&entity), Some(12), "{entity} of {found:?}");
        assert_eq!(found[&entity].1, ["frame", "time"]);
    }
    for entity in ["/exposure_stops", "/blur_length_px", "/world/path/0", "/file"] {
        assert_eq!(rows(entity), Some(12), "{entity} of {found:?}");
    }
    assert_eq!(rows("/white_balance"), Some(13), "gains of 12 frames, and names of the channels");
    for entity in ["map", "trajectory", "keyframes"].map(|name| format!("/world/{name}")) {
        assert_eq!(rows(&entity), Some(1), "{entity} of {found:?}");
        assert!(found[&entity].1.is_empty(), "{entity} holds at all times");
    }
    let keyframes = rows("/keyframes").expect("keyframes");
    assert!((1..=12).contains(&keyframes), "{keyframes} keyframes");
    let marks = marks(&recorded);
    assert!(marks[0].starts_with("keyframe 0, rgb/"), "{marks:?}");
    fs::remove_dir_all(&out).expect("a result");
    run(&[]).exits_with(2).stderr_contains("the recording exists");
    run(&[&"--overwrite"]).exits_with(0);
    assert!(chunks(&recording) == recorded, "the same run, other rows");
}

#[test]
fn pictures_without_time_stamps_have_files_and_no_times() {
    let scratch = TemporaryFolder::new("rerun-pictures");
    let (pictures, out, recording) =
        (room(&scratch).join("rgb"), scratch.join("out"), scratch.join("run.rrd"));
    let all: [&dyn AsRef<OsStr>; 10] = [
        &"run",
        &pictures,
        &"--out",
        &out,
        &"--rerun",
        &recording,
        &"--render",
        &"none",
        &"--fov",
        &"60",
    ];
    i2slam(&all).exits_with(0);
    let recorded = chunks(&recording);
    assert_eq!(marks(&recorded)[0], "keyframe 0, 000000.png");
    assert_eq!(entities(&recorded)["/world/camera/picture"].1, ["frame"]);
}

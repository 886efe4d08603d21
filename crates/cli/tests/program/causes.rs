//! `i2slam eval` names the cause, and which truth it used.

use crate::scene::Scene;
use crate::tools::{Ran, Scratch, reconstruct, run};
use std::ffi::OsStr;
use std::fs;
use std::path::Path;

fn eval(estimate: &Path, flags: &[&str]) -> Ran {
    let flags = flags.iter().map(OsStr::new);
    run(["eval".as_ref(), estimate.as_os_str()].into_iter().chain(flags))
}

#[test]
fn what_is_no_result_is_told_apart() {
    let scratch = Scratch::new("no-result");
    eval(&scratch.join("nowhere"), &[]).ended_with(1).complaining("no such file or folder");
    let folder = scratch.join("folder");
    fs::create_dir(&folder).expect("a folder");
    eval(&folder, &[]).ended_with(1).complaining("the folder is empty");
    fs::write(folder.join("notes.txt"), "mine").expect("room");
    eval(&folder, &[]).ended_with(1).complaining("neither trajectory.txt nor pictures");
    fs::write(folder.join("frames.csv"), "index\n").expect("room");
    eval(&folder, &[]).ended_with(1).complaining("without its trajectory.txt");
    let data = scratch.join("room");
    Scene { frames: 2, ..Scene::default() }.write(&data);
    eval(&data, &[])
        .ended_with(1)
        .complaining("a dataset, and no result")
        .complaining("i2slam run");
    let list = scratch.join("list.txt");
    let list = list.to_str().expect("a name");
    let nowhere = eval(&scratch.join("nowhere"), &["--write-list", list]).ended_with(1);
    nowhere.complaining("no such folder");
}

#[test]
fn frames_that_nobody_names_are_told() {
    let scratch = Scratch::new("no-frames");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 7, ..Scene::default() }.write(&data);
    reconstruct(&data, &out, &[]).ended_with(0);
    // Frames that are equally sharp: none stands out.
    let ran = eval(&out, &["--protocol", "i2slam"]).ended_with(1);
    assert!(ran.out.contains("ATE RMSE"), "{}", ran.out);
    ran.complaining("stands out as sharp").complaining("--protocol all-frames");
    let list = scratch.join("list.txt");
    fs::write(&list, "77\n88\n").expect("room");
    let ran = eval(&out, &["--list", list.to_str().expect("a name")]).ended_with(1);
    ran.complaining("2 frames (000077, 000088)").complaining("none of the 7 frames of this run");
    let table = fs::read_to_string(out.join("frames.csv")).expect("frames");
    let names: Vec<&str> = table.lines().next().expect("names").split(',').collect();
    let keyframe = names.iter().position(|name| *name == "keyframe").expect("a column");
    let mut changed = vec![names.join(",")];
    for (row, line) in table.lines().skip(1).enumerate() {
        let mut cells: Vec<&str> = line.split(',').collect();
        cells[keyframe] = if matches!(row, 0 | 4) { "1" } else { "0" };
        changed.push(cells.join(","));
    }
    fs::write(out.join("frames.csv"), changed.join("\n") + "\n").expect("room");
    let ran = eval(&out, &["--protocol", "monogs"]).ended_with(0);
    assert!(ran.out.contains("PSNR as MonoGS") && !ran.out.contains("ATE"), "{}", ran.out);
    ran.complaining("this run has 2 keyframes").complaining("three are needed");
    let truth = data.join("groundtruth.txt");
    let alone = ["--protocol", "monogs", "--groundtruth", truth.to_str().expect("a name")];
    eval(&out, &alone).ended_with(1).complaining("this run has 2 keyframes");
}

#[test]
fn a_run_too_short_for_a_trajectory_has_pictures_still() {
    let scratch = Scratch::new("short");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 2, ..Scene::default() }.write(&data);
    reconstruct(&data, &out, &[]).ended_with(0);
    let ran = eval(&out, &[]).ended_with(0);
    assert!(ran.out.contains("sharp PSNR") && !ran.out.contains("ATE"), "{}", ran.out);
    ran.complaining("note: trajectory: too few pairs of poses: 2, at least 3 needed");
    let truth = data.join("groundtruth.txt");
    let asked = ["--groundtruth", truth.to_str().expect("a name")];
    eval(&out, &asked).ended_with(1).complaining("too few pairs");
}

#[test]
fn the_truth_is_on_record_and_another_one_is_pointed_out() {
    let scratch = Scratch::new("record");
    let (data, out, other) = (scratch.join("room"), scratch.join("out"), scratch.join("other"));
    Scene { frames: 4, ..Scene::default() }.write(&data);
    Scene { frames: 4, step: 0.011, ..Scene::default() }.write(&other);
    reconstruct(&data, &out, &[]).ended_with(0);
    let own = eval(&out, &[]).ended_with(0);
    assert!(!own.err.contains("the run read"), "{}", own.err);
    let given = eval(&out, &["--reference", other.to_str().expect("a name")]).ended_with(0);
    given.complaining("warning: the run read").complaining("is judged against");
    let text = fs::read_to_string(out.join("evaluation.json")).expect("evaluations");
    let sections: serde_json::Value = serde_json::from_str(&text).expect("JSON");
    let sections = sections.as_array().expect("sections");
    assert_eq!(sections.len(), 2, "another truth is another evaluation");
    let source = |place: usize| &sections[place]["source"];
    assert_eq!(source(0)["protocol"].as_str(), Some("all-frames"));
    assert_eq!(source(0)["frames"], serde_json::json!([0, 1, 2, 3]));
    for truth in ["trajectory", "pictures"] {
        assert_eq!(source(0)[truth]["path"].as_str(), data.to_str());
        assert_eq!(source(0)[truth]["count"].as_u64(), Some(4));
        assert_eq!(source(1)[truth]["path"].as_str(), other.to_str());
        assert!(source(0)[truth]["crc32"].as_str().is_some_and(|sum| sum.len() == 8));
        assert_ne!(source(0)[truth]["crc32"], source(1)[truth]["crc32"]);
    }
    let page = fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(page.contains("4 true poses of") && page.contains("4 true pictures of"));
}

#[test]
fn pictures_alone_are_judged_against_a_dataset_with_poses() {
    let scratch = Scratch::new("pictures-alone");
    let data = scratch.join("room");
    Scene { frames: 2, ..Scene::default() }.write(&data);
    let ours = scratch.join("ours");
    fs::create_dir(&ours).expect("a folder");
    let mut taken: Vec<_> = fs::read_dir(data.join("rgb")).expect("pictures").flatten().collect();
    taken.sort_by_key(fs::DirEntry::file_name);
    for (place, entry) in taken.iter().enumerate() {
        fs::copy(entry.path(), ours.join(format!("{place:06}.png"))).expect("room");
    }
    let ran = eval(&ours, &["--reference", data.to_str().expect("a name")]).ended_with(0);
    assert!(ran.out.contains("frames judged"), "{}", ran.out);
    ran.complaining("2 renders equal their truth");
}

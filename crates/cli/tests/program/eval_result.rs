//! `i2slam eval` on result folders: protocols, recorded ground truth, causes of errors.

use crate::program::{Scene, Scratch, eval, reconstruct, run};
use std::fs;
use std::path::{Path, PathBuf};

/// A sequence with its sharp pictures, and a run of it.
fn result(name: &str, flags: &[&str]) -> (Scratch, PathBuf, PathBuf) {
    let scratch = Scratch::new(name);
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene::default().write(&data);
    fs::create_dir(data.join("sharp")).expect("a folder");
    for entry in fs::read_dir(data.join("rgb")).expect("pictures").flatten() {
        fs::copy(entry.path(), data.join("sharp").join(entry.file_name())).expect("room");
    }
    reconstruct(&data, &out, flags).exits_with(0);
    (scratch, data, out)
}

fn json(out: &Path, flags: &[&str]) -> serde_json::Value {
    let flags: Vec<&str> = flags.iter().copied().chain(["--json"]).collect();
    serde_json::from_str(&eval(out, &flags).exits_with(0).out).expect("JSON")
}

fn indices(figures: &serde_json::Value) -> Vec<u64> {
    let frames = figures["frames"].as_array().expect("frames");
    frames.iter().filter_map(|f| f["index"].as_u64()).collect()
}

#[test]
fn frames_that_are_held_out_are_tracked_and_never_mapped() {
    let (scratch, data, out) = result("held-out", &["--hold-out", "2"]);
    let table = fs::read_to_string(out.join("frames.csv")).expect("frames");
    let names: Vec<&str> = table.lines().next().expect("names").split(',').collect();
    let column = |name: &str| -> Vec<f64> {
        let place = names.iter().position(|n| *n == name).expect("a column");
        let cell = |row: &str| row.split(',').nth(place).and_then(|c| c.parse().ok());
        table.lines().skip(1).map(|row| cell(row).expect("a number")).collect()
    };
    assert_eq!(column("held_out"), [0.0, 0.0, 1.0, 0.0, 1.0, 0.0]);
    let (gaussians, keyframes) = (column("gaussians"), column("keyframe"));
    assert_eq!(column("tracked"), [1.0; 6]);
    for frame in [2, 4] {
        assert_eq!((gaussians[frame], keyframes[frame]), (gaussians[frame - 1], 0.0));
    }
    let figures = json(&out, &["--protocol", "held-out"]);
    assert_eq!((indices(&figures), figures["protocol"].as_str()), (vec![2, 4], Some("held-out")));
    assert!(figures["psnr_sharp_db"].as_f64().is_some_and(|v| v > 15.0), "{figures}");
    let all = scratch.join("all");
    reconstruct(&data, &all, &[]).exits_with(0);
    eval(&all, &["--protocol", "held-out"]).exits_with(2).stderr_contains("--hold-out");
    eval(&out, &["--protocol", "held-out", "--list", "auto"])
        .exits_with(2)
        .stderr_contains("--list");
    reconstruct(&data, &scratch.join("x"), &["--hold-out", "1"])
        .exits_with(2)
        .stderr_contains("hold_out");
}

#[test]
fn a_result_knows_its_dataset() {
    let (scratch, data, out) = result("recorded", &["--frames", "1..6", "--scale", "0.5"]);
    let figures = json(&out, &[]);
    assert_eq!(indices(&figures), [1, 2, 3, 4, 5]);
    assert!(figures["ate_rmse_m"].as_f64().is_some_and(|v| v < 0.02), "{figures}");
    let given = ["--reference", data.to_str().expect("a name")];
    assert_eq!(json(&out, &given), figures);
    assert_eq!(figures["against_pictures_taken"].as_bool(), Some(false));
    fs::remove_dir_all(data.join("sharp")).expect("a folder");
    eval(&out, &[]).exits_with(0).stderr_contains("compared with the pictures taken");
    fs::rename(&data, scratch.join("elsewhere")).expect("room");
    eval(&out, &[])
        .exits_with(1)
        .stderr_contains("not there any more")
        .stderr_contains("--reference");
}

#[test]
fn the_report_has_a_section_for_every_protocol() {
    let (_scratch, data, out) = result("section", &["--hold-out", "3"]);
    let page = || fs::read_to_string(out.join("report.html")).expect("a report");
    let before = page();
    assert!(!before.contains("Protocol"));
    eval(&out, &[]).exits_with(0);
    eval(&out, &["--protocol", "held-out"]).exits_with(0);
    eval(&out, &["--protocol", "held-out"]).exits_with(0);
    let truth = data.join("groundtruth.txt");
    eval(&out, &["--groundtruth", truth.to_str().expect("a name")]).exits_with(0);
    let after = page();
    assert!(after.contains("Protocol all-frames</h3>") && after.contains("sharp PSNR"), "{after}");
    assert_eq!(after.matches("Protocol held-out</h3>").count(), 1);
    assert!(after.contains("data:image/jpeg") && after.len() > before.len());
    let kept = fs::read_to_string(out.join("evaluation.json")).expect("evaluations");
    assert_eq!(kept.matches("\"title\"").count(), 3);
    assert!(kept.contains("Protocol all-frames, trajectory alone"), "{kept}");
}

#[test]
fn without_renders_the_trajectory_is_judged() {
    let (_scratch, _, out) = result("no-renders", &["--render", "none"]);
    let ran = eval(&out, &[]).exits_with(0);
    assert!(ran.out.contains("ATE RMSE") && !ran.out.contains("PSNR"), "{}", ran.out);
    ran.stderr_contains("has no renders/sharp").stderr_contains("i2slam render");
    assert!(json(&out, &[])["not_judged"][0].as_str().is_some_and(|n| n.contains("renders")));
    run(["render", out.to_str().expect("a name"), "--kinds", "sharp", "--frames", "0..2"])
        .exits_with(0);
    let ran = eval(&out, &[]).exits_with(1);
    assert!(ran.out.contains("ATE RMSE"), "{}", ran.out);
    ran.stderr_contains("000002").stderr_contains("--partial");
}

#[test]
fn poses_are_optimised_on_request_and_it_is_said() {
    let (_scratch, _, out) = result("optimised", &["--render", "none"]);
    run(["render", out.to_str().expect("a name"), "--kinds", "sharp"]).exits_with(0);
    let at_estimate = json(&out, &[]);
    let optimised = json(&out, &["--optimise-poses"]);
    let psnr = |figures: &serde_json::Value| figures["psnr_sharp_db"].as_f64().expect("a number");
    // Pictures of eight bits.
    assert!(psnr(&optimised) > psnr(&at_estimate) - 0.01, "{optimised}");
    assert_eq!(optimised["poses_optimised"].as_bool(), Some(true));
    assert_eq!(at_estimate["poses_optimised"].as_bool(), Some(false));
    assert!(optimised["pose_correction_m"].as_f64().is_some_and(|v| v < 0.05), "{optimised}");
    assert!(out.join("renders/optimised/sharp/000003.png").is_file());
    assert!(out.join("trajectory_optimised.txt").is_file());
    let page = fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(page.contains("Protocol all-frames, poses optimised</h3>"));
    let table = eval(&out, &["--optimise-poses"]).exits_with(0).out;
    let error = table.lines().find(|line| line.starts_with("ATE RMSE")).expect("an error");
    assert!(error.ends_with("cm, poses as tracked"), "{error}");
    let refused = |flags: &[&str], word: &str| {
        eval(&out, flags).exits_with(2).stderr_contains(word);
    };
    refused(&["--optimise-poses", "--protocol", "splatam"], "no part of this protocol");
    fs::remove_file(out.join("map.i2slam")).expect("a map");
    refused(&["--optimise-poses"], "with its map");
}

#[test]
fn what_is_no_result_is_told_apart() {
    let scratch = Scratch::new("no-result");
    eval(&scratch.join("nowhere"), &[]).exits_with(1).stderr_contains("no such file or folder");
    let folder = scratch.join("folder");
    fs::create_dir(&folder).expect("a folder");
    eval(&folder, &[]).exits_with(1).stderr_contains("the folder is empty");
    fs::write(folder.join("notes.txt"), "mine").expect("room");
    eval(&folder, &[]).exits_with(1).stderr_contains("neither trajectory.txt nor pictures");
    fs::write(folder.join("frames.csv"), "index\n").expect("room");
    eval(&folder, &[]).exits_with(1).stderr_contains("without its trajectory.txt");
    let data = scratch.join("room");
    Scene { frames: 2, ..Scene::default() }.write(&data);
    eval(&data, &[])
        .exits_with(1)
        .stderr_contains("a dataset, and no result")
        .stderr_contains("i2slam run");
    let list = scratch.join("list.txt");
    let list = list.to_str().expect("a name");
    let nowhere = eval(&scratch.join("nowhere"), &["--write-list", list]).exits_with(1);
    nowhere.stderr_contains("no such folder");
}

#[test]
fn frames_that_nobody_names_are_told() {
    let scratch = Scratch::new("no-frames");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 7, ..Scene::default() }.write(&data);
    reconstruct(&data, &out, &[]).exits_with(0);
    // Frames that are equally sharp: none stands out.
    let ran = eval(&out, &["--protocol", "i2slam"]).exits_with(1);
    assert!(ran.out.contains("ATE RMSE"), "{}", ran.out);
    ran.stderr_contains("stands out as sharp").stderr_contains("--protocol all-frames");
    let list = scratch.join("list.txt");
    fs::write(&list, "77\n88\n").expect("room");
    let ran = eval(&out, &["--list", list.to_str().expect("a name")]).exits_with(1);
    ran.stderr_contains("2 frames (000077, 000088)")
        .stderr_contains("none of the 7 frames of this run");
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
    let ran = eval(&out, &["--protocol", "monogs"]).exits_with(0);
    assert!(ran.out.contains("PSNR as MonoGS") && !ran.out.contains("ATE"), "{}", ran.out);
    ran.stderr_contains("this run has 2 keyframes").stderr_contains("three are needed");
    let truth = data.join("groundtruth.txt");
    let alone = ["--protocol", "monogs", "--groundtruth", truth.to_str().expect("a name")];
    eval(&out, &alone).exits_with(1).stderr_contains("this run has 2 keyframes");
}

#[test]
fn a_run_too_short_for_a_trajectory_has_pictures_still() {
    let scratch = Scratch::new("short");
    let (data, out) = (scratch.join("room"), scratch.join("out"));
    Scene { frames: 2, ..Scene::default() }.write(&data);
    reconstruct(&data, &out, &[]).exits_with(0);
    let ran = eval(&out, &[]).exits_with(0);
    assert!(ran.out.contains("sharp PSNR") && !ran.out.contains("ATE"), "{}", ran.out);
    ran.stderr_contains("note: trajectory: too few pairs of poses: 2, at least 3 needed");
    let truth = data.join("groundtruth.txt");
    let asked = ["--groundtruth", truth.to_str().expect("a name")];
    eval(&out, &asked).exits_with(1).stderr_contains("too few pairs");
}

#[test]
fn the_truth_is_on_record_and_another_one_is_pointed_out() {
    let scratch = Scratch::new("record");
    let (data, out, other) = (scratch.join("room"), scratch.join("out"), scratch.join("other"));
    Scene { frames: 4, ..Scene::default() }.write(&data);
    Scene { frames: 4, step: 0.011, ..Scene::default() }.write(&other);
    reconstruct(&data, &out, &[]).exits_with(0);
    let own = eval(&out, &[]).exits_with(0);
    assert!(!own.err.contains("the run read"), "{}", own.err);
    let given = eval(&out, &["--reference", other.to_str().expect("a name")]).exits_with(0);
    given.stderr_contains("warning: the run read").stderr_contains("is evaluated against");
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
    let ran = eval(&ours, &["--reference", data.to_str().expect("a name")]).exits_with(0);
    assert!(ran.out.contains("frames evaluated"), "{}", ran.out);
    ran.stderr_contains("2 renders equal their truth");
}

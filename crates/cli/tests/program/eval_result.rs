//! `i2slam eval` on result folders: protocols, recorded ground truth, causes of errors.

use crate::program::{Room, Scene, TemporaryFolder, i2slam, reconstruct};
use serde_json::Value;
use std::fs;

fn frames(frames: usize) -> Scene {
    Scene { frames, ..Scene::default() }
}

fn indices(figures: &Value) -> Vec<u64> {
    let frames = figures["frames"].as_array().expect("frames");
    frames.iter().filter_map(|f| f["index"].as_u64()).collect()
}

#[test]
fn frames_that_are_held_out_are_tracked_and_never_mapped() {
    let room = Room::with_sharp("held-out");
    room.run(&["--hold-out", "2"]).exits_with(0);
    assert_eq!(room.column("held_out"), [0.0, 0.0, 1.0, 0.0, 1.0, 0.0]);
    let (gaussians, keyframes) = (room.column("gaussians"), room.column("keyframe"));
    assert_eq!(room.column("tracked"), [1.0; 6]);
    for frame in [2, 4] {
        assert_eq!((gaussians[frame], keyframes[frame]), (gaussians[frame - 1], 0.0));
    }
    let figures = room.eval_json(&["--protocol", "held-out"]);
    assert_eq!((indices(&figures), figures["protocol"].as_str()), (vec![2, 4], Some("held-out")));
    assert!(figures["psnr_sharp_db"].as_f64().is_some_and(|v| v > 15.0), "{figures}");
    let list = ["--protocol", "held-out", "--list", "auto"];
    room.eval(&list).exits_with(2).stderr_contains("--list");
    let refused = reconstruct(&room.data, &room.scratch.join("x"), &["--hold-out", "1"]);
    refused.exits_with(2).stderr_contains("hold_out");
    // The report has one section for every protocol and truth.
    let before = room.text("report.html");
    assert_eq!(before.matches("Protocol held-out</h3>").count(), 1);
    let truth = room.data.join("groundtruth.txt");
    room.eval(&[]).exits_with(0);
    room.eval(&["--protocol", "held-out"]).exits_with(0);
    i2slam!("eval", room.out, "--groundtruth", truth).exits_with(0);
    let after = room.text("report.html");
    assert!(after.contains("Protocol all-frames</h3>") && after.contains("sharp PSNR"), "{after}");
    assert_eq!(after.matches("Protocol held-out</h3>").count(), 1);
    assert!(after.contains("data:image/jpeg") && after.len() > before.len());
    let kept = room.text("evaluation.json");
    assert_eq!(kept.matches("\"title\"").count(), 3);
    assert!(kept.contains("Protocol all-frames, trajectory alone"), "{kept}");
}

#[test]
fn a_list_names_the_frames_that_are_held_out() {
    let room = Room::with_sharp("held-out-list");
    let list = room.scratch.join("test-views.txt");
    let fourth = fs::read_to_string(room.data.join("rgb.txt")).expect("pictures");
    let fourth = fourth.lines().filter(|line| !line.starts_with('#')).nth(3).expect("a picture");
    let name = fourth.split_whitespace().nth(1).expect("its file");
    fs::write(&list, format!("# two views\n1\n{name}\n")).expect("room");
    let flags = ["--hold-out", list.to_str().expect("a name"), "--render", "none"];
    room.run(&flags).exits_with(0);
    assert_eq!(room.column("held_out"), [0.0, 1.0, 0.0, 1.0, 0.0, 0.0]);
    let gaussians = room.column("gaussians");
    assert_eq!([gaussians[1], gaussians[3]], [gaussians[0], gaussians[2]]);
    fs::write(&list, "1\nnone.png\n").expect("room");
    let refused = reconstruct(&room.data, &room.scratch.join("x"), &flags);
    refused.exits_with(1).stderr_contains("test-views.txt: line 2: `none.png`");
}

#[test]
fn a_result_knows_its_dataset() {
    let room = Room::with_sharp("recorded");
    room.run(&["--frames", "1..6", "--scale", "0.5"]).exits_with(0);
    let figures = room.eval_json(&[]);
    assert_eq!(indices(&figures), [1, 2, 3, 4, 5]);
    assert!(figures["ate_rmse_m"].as_f64().is_some_and(|v| v < 0.02), "{figures}");
    let given = ["--reference", room.data.to_str().expect("a name")];
    assert_eq!(room.eval_json(&given), figures);
    assert_eq!(figures["against_pictures_taken"].as_bool(), Some(false));
    let metrics = room.text("metrics.json");
    assert!(metrics.contains("\"ate_frames_without_pose\": 0"), "{metrics}");
    assert_eq!(figures["frames_without_pose"].as_u64(), Some(0));
    let (path, poses) = (room.out.join("trajectory.txt"), room.text("trajectory.txt"));
    let some: Vec<&str> = poses.lines().take(5).collect();
    fs::write(&path, some.join("\n")).expect("room");
    assert_eq!(room.eval_json(&[])["frames_without_pose"].as_u64(), Some(2));
    fs::write(&path, poses).expect("room");
    fs::remove_dir_all(room.data.join("sharp")).expect("a folder");
    room.eval(&[]).exits_with(0).stderr_contains("compared with the pictures taken");
    let held_out = room.eval(&["--protocol", "held-out"]).exits_with(2);
    held_out.stderr_contains("--hold-out");
    fs::rename(&room.data, room.scratch.join("elsewhere")).expect("room");
    let gone = room.eval(&[]).exits_with(1);
    gone.stderr_contains("not there any more").stderr_contains("--reference");
}

#[test]
fn poses_are_optimised_on_request_and_it_is_said() {
    let room = Room::with_sharp("optimised");
    room.run(&["--render", "none"]).exits_with(0);
    // Without renders the trajectory is judged.
    let ran = room.eval(&[]).exits_with(0);
    assert!(ran.out.contains("ATE RMSE") && !ran.out.contains("PSNR"), "{}", ran.out);
    ran.stderr_contains("has no renders/sharp").stderr_contains("i2slam render");
    let reason = &room.eval_json(&[])["not_judged"][0];
    assert!(reason.as_str().is_some_and(|reason| reason.contains("renders")), "{reason}");
    i2slam!("render", room.out, "--kinds", "sharp", "--frames", "0..2").exits_with(0);
    let ran = room.eval(&[]).exits_with(1);
    assert!(ran.out.contains("ATE RMSE"), "{}", ran.out);
    ran.stderr_contains("000002").stderr_contains("--partial");

    i2slam!("render", room.out, "--kinds", "sharp").exits_with(0);
    let at_estimate = room.eval_json(&[]);
    let optimised = room.eval_json(&["--optimise-poses"]);
    let psnr = |figures: &Value| figures["psnr_sharp_db"].as_f64().expect("a number");
    // Pictures of eight bits.
    assert!(psnr(&optimised) > psnr(&at_estimate) - 0.01, "{optimised}");
    assert_eq!(optimised["poses_optimised"].as_bool(), Some(true));
    assert_eq!(at_estimate["poses_optimised"].as_bool(), Some(false));
    assert!(optimised["pose_correction_m"].as_f64().is_some_and(|v| v < 0.05), "{optimised}");
    assert!(room.has("renders/optimised/sharp/000003.png"));
    assert!(room.has("trajectory_optimised.txt"));
    let page = room.text("report.html");
    assert!(page.contains("Protocol all-frames, poses optimised</h3>"));
    let table = room.eval(&["--optimise-poses"]).exits_with(0).out;
    let error = table.lines().find(|line| line.starts_with("ATE RMSE")).expect("an error");
    assert!(error.ends_with("cm, poses as tracked"), "{error}");
    let splatam = room.eval(&["--optimise-poses", "--protocol", "splatam"]).exits_with(2);
    splatam.stderr_contains("no part of this protocol");
    fs::remove_file(room.out.join("map.i2slam")).expect("a map");
    room.eval(&["--optimise-poses"]).exits_with(2).stderr_contains("with its map");
}

#[test]
fn what_is_no_result_is_told_apart() {
    let scratch = TemporaryFolder::new("no-result");
    let (nowhere, folder, data) =
        (scratch.join("nowhere"), scratch.join("folder"), scratch.join("room"));
    i2slam!("eval", nowhere).exits_with(2).stderr_contains("no such file or folder");
    let list = i2slam!("eval", nowhere, "--write-list", scratch.join("list.txt"));
    list.exits_with(2).stderr_contains("no such folder");
    fs::create_dir(&folder).expect("a folder");
    let refused = |text: &str| i2slam!("eval", folder).exits_with(2).stderr_contains(text);
    refused("the folder is empty");
    fs::write(folder.join("notes.txt"), "mine").expect("room");
    refused("neither trajectory.txt nor pictures");
    fs::write(folder.join("frames.csv"), "index\n").expect("room");
    refused("without its trajectory.txt");
    frames(2).write(&data);
    let dataset = i2slam!("eval", data).exits_with(2);
    dataset.stderr_contains("a dataset, and no result").stderr_contains("i2slam run");
}

#[test]
fn frames_that_nobody_names_are_told() {
    let room = Room::reconstructed("no-frames", frames(7), &[]);
    // Frames that are equally sharp: none stands out.
    let ran = room.eval(&["--protocol", "i2slam"]).exits_with(1);
    assert!(ran.out.contains("ATE RMSE"), "{}", ran.out);
    ran.stderr_contains("stands out as sharp").stderr_contains("--protocol all-frames");
    let list = room.scratch.join("list.txt");
    fs::write(&list, "77\n88\n").expect("room");
    let ran = i2slam!("eval", room.out, "--list", list).exits_with(1);
    ran.stderr_contains("2 frames (000077, 000088)")
        .stderr_contains("none of the 7 frames of this run");
    let table = room.text("frames.csv");
    let names: Vec<&str> = table.lines().next().expect("names").split(',').collect();
    let keyframe = names.iter().position(|name| *name == "keyframe").expect("a column");
    let mut changed = vec![names.join(",")];
    for (row, line) in table.lines().skip(1).enumerate() {
        let mut cells: Vec<&str> = line.split(',').collect();
        cells[keyframe] = if matches!(row, 0 | 4) { "1" } else { "0" };
        changed.push(cells.join(","));
    }
    fs::write(room.out.join("frames.csv"), changed.join("\n") + "\n").expect("room");
    let ran = room.eval(&["--protocol", "monogs"]).exits_with(0);
    assert!(ran.out.contains("PSNR as MonoGS") && !ran.out.contains("ATE"), "{}", ran.out);
    ran.stderr_contains("this run has 2 keyframes").stderr_contains("three are needed");
    let truth = room.data.join("groundtruth.txt");
    i2slam!("eval", room.out, "--protocol", "monogs", "--groundtruth", truth)
        .exits_with(1)
        .stderr_contains("this run has 2 keyframes");
}

#[test]
fn a_run_too_short_for_a_trajectory_has_pictures_still() {
    let room = Room::reconstructed("short", frames(2), &[]);
    let ran = room.eval(&[]).exits_with(0);
    // Against the pictures taken, which are blurred as well.
    assert!(ran.out.contains("PSNR") && !ran.out.contains("sharp"), "{}", ran.out);
    assert!(!ran.out.contains("ATE"), "{}", ran.out);
    ran.stderr_contains("note: trajectory: too few pairs of poses: 2, at least 3 needed");
    let truth = room.data.join("groundtruth.txt");
    let asked = i2slam!("eval", room.out, "--groundtruth", truth).exits_with(1);
    asked.stderr_contains("too few pairs");
    // Pictures alone are judged against a dataset with poses.
    let ours = room.scratch.join("ours");
    fs::create_dir(&ours).expect("a folder");
    let mut taken: Vec<_> =
        fs::read_dir(room.data.join("rgb")).expect("pictures").flatten().collect();
    taken.sort_by_key(fs::DirEntry::file_name);
    for (place, entry) in taken.iter().enumerate() {
        fs::copy(entry.path(), ours.join(format!("{place:06}.png"))).expect("room");
    }
    let ran = i2slam!("eval", ours, "--reference", room.data).exits_with(0);
    assert!(ran.out.contains("frames evaluated"), "{}", ran.out);
    ran.stderr_contains("2 renders equal their truth");
}

#[test]
fn the_truth_is_on_record_and_another_one_is_pointed_out() {
    let room = Room::reconstructed("record", frames(4), &[]);
    let other = room.scratch.join("other");
    Scene { step: 0.011, ..frames(4) }.write(&other);
    let own = room.eval(&[]).exits_with(0);
    assert!(!own.err.contains("the run read"), "{}", own.err);
    let given = i2slam!("eval", room.out, "--reference", other).exits_with(0);
    given.stderr_contains("note: the run read").stderr_contains("is evaluated against");
    let sections: Value = serde_json::from_str(&room.text("evaluation.json")).expect("JSON");
    let sections = sections.as_array().expect("sections");
    assert_eq!(sections.len(), 2, "another truth is another evaluation");
    let source = |place: usize| &sections[place]["source"];
    assert_eq!(source(0)["protocol"].as_str(), Some("all-frames"));
    assert_eq!(source(0)["frames"], serde_json::json!([0, 1, 2, 3]));
    for truth in ["trajectory", "pictures"] {
        assert_eq!(source(0)[truth]["path"].as_str(), room.data.to_str());
        assert_eq!(source(0)[truth]["count"].as_u64(), Some(4));
        assert_eq!(source(1)[truth]["path"].as_str(), other.to_str());
        assert!(source(0)[truth]["crc32"].as_str().is_some_and(|sum| sum.len() == 8));
        assert_ne!(source(0)[truth]["crc32"], source(1)[truth]["crc32"]);
    }
    let page = room.text("report.html");
    assert!(page.contains("4 true poses of") && page.contains("4 taken pictures of"));
}

/// Names of Linux are bytes; `input.json` and `evaluation.json` hold them all.
#[test]
#[cfg(unix)]
fn a_dataset_whose_name_is_no_unicode_is_found_again() {
    use std::os::unix::ffi::OsStringExt;
    let room = Room::new("latin", Scene::default());
    let odd = |name: &[u8]| room.scratch.0.join(std::ffi::OsString::from_vec(name.to_vec()));
    let (data, camera) = (odd(b"caf\xe9"), odd(b"cam\xe9ra.json"));
    fs::rename(&room.data, &data).expect("a folder");
    fs::rename(data.join("camera.json"), &camera).expect("a file");
    let quick = room.scratch.join("quick.toml");
    fs::write(&quick, "[mapping]\nfinal_iterations = 3\niterations = 12\n").expect("room");
    let out = odd(b"out-\xe9");
    i2slam!("run", data, "--out", out, "--camera", camera, "--config", quick).exits_with(0);
    let judged = i2slam!("eval", out).exits_with(0);
    assert!(judged.out.contains("ATE"), "{}", judged.out);
    let text = fs::read_to_string(out.join("evaluation.json")).expect("an evaluation");
    assert!(text.contains("\"bytes\""), "{text}");
}

//! `i2slam eval` on result folders: which frames, from where, and what the folder keeps of it.

use crate::scene::Scene;
use crate::tools::{Ran, Scratch, reconstruct, run};
use std::ffi::OsStr;
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
    reconstruct(&data, &out, flags).ended_with(0);
    (scratch, data, out)
}

fn eval(out: &Path, flags: &[&str]) -> Ran {
    let flags = flags.iter().map(OsStr::new);
    run(["eval".as_ref(), out.as_os_str()].into_iter().chain(flags))
}

fn json(out: &Path, flags: &[&str]) -> serde_json::Value {
    let flags: Vec<&str> = flags.iter().copied().chain(["--json"]).collect();
    serde_json::from_str(&eval(out, &flags).ended_with(0).out).expect("JSON")
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
    reconstruct(&data, &all, &[]).ended_with(0);
    eval(&all, &["--protocol", "held-out"]).ended_with(2).complaining("--hold-out");
    eval(&out, &["--protocol", "held-out", "--list", "auto"]).ended_with(2).complaining("--list");
    reconstruct(&data, &scratch.join("x"), &["--hold-out", "1"])
        .ended_with(2)
        .complaining("hold_out");
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
    eval(&out, &[]).ended_with(0).complaining("compared with the pictures taken");
    fs::rename(&data, scratch.join("elsewhere")).expect("room");
    eval(&out, &[]).ended_with(1).complaining("not there any more").complaining("--reference");
}

#[test]
fn the_report_has_a_section_for_every_protocol() {
    let (_scratch, data, out) = result("section", &["--hold-out", "3"]);
    let page = || fs::read_to_string(out.join("report.html")).expect("a report");
    let before = page();
    assert!(!before.contains("Protocol"));
    eval(&out, &[]).ended_with(0);
    eval(&out, &["--protocol", "held-out"]).ended_with(0);
    eval(&out, &["--protocol", "held-out"]).ended_with(0);
    let truth = data.join("groundtruth.txt");
    eval(&out, &["--groundtruth", truth.to_str().expect("a name")]).ended_with(0);
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
    let ran = eval(&out, &[]).ended_with(0);
    assert!(ran.out.contains("ATE RMSE") && !ran.out.contains("PSNR"), "{}", ran.out);
    ran.complaining("has no renders/sharp").complaining("i2slam render");
    assert!(json(&out, &[])["not_judged"][0].as_str().is_some_and(|n| n.contains("renders")));
    run(["render", out.to_str().expect("a name"), "--kinds", "sharp", "--frames", "0..2"])
        .ended_with(0);
    let ran = eval(&out, &[]).ended_with(1);
    assert!(ran.out.contains("ATE RMSE"), "{}", ran.out);
    ran.complaining("000002").complaining("--partial");
}

#[test]
fn poses_are_optimised_on_request_and_it_is_said() {
    let (_scratch, _, out) = result("optimised", &["--render", "none"]);
    run(["render", out.to_str().expect("a name"), "--kinds", "sharp"]).ended_with(0);
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
    let table = eval(&out, &["--optimise-poses"]).ended_with(0).out;
    let error = table.lines().find(|line| line.starts_with("ATE RMSE")).expect("an error");
    assert!(error.ends_with("cm, poses as tracked"), "{error}");
    let refused = |flags: &[&str], word: &str| {
        eval(&out, flags).ended_with(2).complaining(word);
    };
    refused(&["--optimise-poses", "--protocol", "splatam"], "no part of this protocol");
    fs::remove_file(out.join("map.i2slam")).expect("a map");
    refused(&["--optimise-poses"], "with its map");
}

//! `i2slam info`: the table, the JSON object, and what it says to folders that are no sequence.

use crate::program::{
    Scene, TemporaryFolder, i2slam, json, number, reconstruct, stamp, write_colour,
};
use std::fs;

fn scene(name: &str) -> TemporaryFolder {
    let scratch = TemporaryFolder::new(name);
    Scene::default().write(&scratch.join(""));
    scratch
}

#[test]
fn the_table_tells_what_was_recognised() {
    let scratch = scene("info-table");
    let out = i2slam!("info", scratch.0).exits_with(0).out;
    let row = |label: &str| {
        let found = out.lines().find(|line| line.starts_with(label));
        found.unwrap_or_else(|| panic!("no row {label} in\n{out}")).to_owned()
    };
    for (label, part) in [
        ("layout", "TUM RGB-D"),
        ("frames", "6"),
        ("times", "0.20 s from 100.000, 25.00 frames a second"),
        ("gaps", "none"),
        ("camera   ", "48x36, fx 45.00, fy 45.00, cx 24.00, cy 18.00 px"),
        ("depth scale", "5000"),
        ("truth", "poses (6 poses, 0.05 m)"),
        ("depth   ", "100.0 % of pixels"),
        ("brightness", "stops"),
        ("sharpness", "sharp frames"),
    ] {
        assert!(row(label).contains(part), "{part} is not in: {}", row(label));
    }
}

#[test]
fn json_has_the_numbers() {
    let scratch = scene("info-json");
    let folder = scratch.join("");
    // Frame 2 black, frame 4 damaged, and a gap where it was.
    write_colour(&folder.join("rgb/100.080000.png"), (48, 36), &[0; 3 * 48 * 36]);
    fs::write(folder.join("rgb/100.160000.png"), "damaged").expect("room");
    fs::write(folder.join("exposure.csv"), "dt\n1\n2\n1\n8\n1\n1\n").expect("room");
    let told = json(&i2slam!("info", folder, "--json"));
    assert_eq!(told["frames"], 6);
    assert_eq!(told["layout"], "TUM RGB-D");
    assert_eq!(told["camera"]["width"], 48);
    assert_eq!(told["truth"]["kinds"], serde_json::json!(["poses", "exposures"]));
    assert_eq!(told["paper_frames"], serde_json::Value::Null);
    let pictures = &told["pictures"];
    assert_eq!(pictures["measured_frames"], 5);
    assert!(
        pictures["unreadable"][0]
            .as_str()
            .expect("words")
            .contains("frame 4, rgb/100.160000.png: ")
    );
    assert_eq!(pictures["odd"][0], "frame 2, rgb/100.080000.png: the colour image is black");
    assert_eq!(pictures["true_exposure_range_stops"], 3.0);
    let number = |value: &serde_json::Value| value.as_f64().expect("a number");
    assert_eq!(number(&pictures["brightness"]["lowest"]), 0.0);
    assert!(number(&pictures["brightness"]["range_stops"]) > 5.0);
    assert_eq!(number(&pictures["sharpness"]["lowest"]), 0.0);
    // The fixture: floor 0.35 m below the camera, back wall at 1.6 m.
    let depth = &pictures["depth"];
    assert!(number(&depth["low_m"]) > 0.3 && number(&depth["high_m"]) < 1.7, "{depth}");
    assert!(number(&depth["low_m"]) < number(&depth["median_m"]));
    let flags = ["--quick", "--json", "--frames", "1..6", "--stride", "2"];
    let quick = json(&i2slam!("info", folder; flags));
    assert_eq!((&quick["frames"], &quick["pictures"]), (&3.into(), &serde_json::Value::Null));
}

#[test]
fn an_unknown_folder_is_answered_with_the_layouts() {
    let scratch = TemporaryFolder::new("info-unknown");
    fs::write(scratch.join("notes.md"), "").expect("room");
    let err = i2slam!("info", scratch.0).exits_with(2).err;
    for word in
        ["no RGB-D sequence", "notes.md", "TUM RGB-D", ".sens", "transforms.json", "Replica"]
    {
        assert!(err.contains(word), "{word} is not in: {err}");
    }
    fs::write(scratch.join("b.mp4"), "").expect("room");
    let err = i2slam!("info", scratch.0).exits_with(2).err;
    assert!(err.contains("name the video") && err.contains("b.mp4"), "{err}");
    let err = i2slam!("info", scratch.join("none")).exits_with(2).err;
    assert!(err.contains("no file or folder"), "{err}");
}

/// The scene in the layout of Replica: poses are lines of a file, one for every frame.
#[test]
fn poses_beside_the_frames_judge_a_run() {
    let scratch = scene("info-replica");
    let (source, scene) = (scratch.join(""), scratch.join("room0"));
    fs::create_dir_all(scene.join("results")).expect("a folder");
    let mut poses = String::new();
    for frame in 0..6 {
        let time = stamp(frame);
        for (kind, name) in [("rgb", "frame"), ("depth", "depth")] {
            let file = source.join(format!("{kind}/{time}.png"));
            let to = scene.join(format!("results/{name}{frame:06}.png"));
            fs::copy(file, to).expect("a copy");
        }
        let x = 0.01 * frame as f64;
        poses += &format!("1 0 0 {x} 0 1 0 0 0 0 1 {} 0 0 0 1\n", 0.3 * x);
    }
    fs::write(scene.join("traj.txt"), poses).expect("room");
    let camera = r#"{"camera":{"w":48,"h":36,"fx":45,"fy":45,"cx":23.5,"cy":17.5,"scale":5000}}"#;
    fs::write(scratch.join("cam_params.json"), camera).expect("room");
    let out = scratch.join("out");
    reconstruct(&scene, &out, &["--render", "none"]).exits_with(0);
    let error = number(&out.join("metrics.json"), "ate_rmse_m").expect("judged");
    assert!(error < 0.005, "{error}");
}

#[test]
fn keyframes_of_another_program_are_told_too() {
    let scratch = scene("info-keyframes");
    let file = scratch.join("groundtruth.txt");
    let out = i2slam!("info", file).exits_with(0).out;
    for (label, part) in [
        ("keyframes of", "TUM trajectory"),
        ("poses", "groundtruth.txt: world_from_camera, quaternion x y z w"),
        ("keyframes   ", "6 (0 poses without a picture, 0 pictures without a pose)"),
        ("camera", "48x36, fx 45.00"),
        ("depth", "none"),
    ] {
        let found = out.lines().find(|line| line.starts_with(label));
        assert!(found.is_some_and(|row| row.contains(part)), "no {label} with {part} in\n{out}");
    }
    let told = json(&i2slam!("info", file, "--json"));
    assert_eq!((&told["keyframes"], &told["has_depth"]), (&6.into(), &false.into()));
    fs::write(&file, "100.0 0 0 0 0 0 0 2\n").expect("room");
    let err = i2slam!("info", file).exits_with(1).err;
    assert!(err.contains("line 1") && err.contains("length 2.000"), "{err}");
}

/// Nothing but pictures: what they are is said, and a run goes by colour alone.
#[test]
fn a_folder_of_pictures_is_run_by_colour_alone() {
    let scratch = TemporaryFolder::new("pictures-only");
    let (data, ours) = (scratch.join("room"), scratch.join("ours"));
    Scene { frames: 3, ..Scene::default() }.write(&data);
    fs::rename(data.join("rgb"), &ours).expect("room");
    let told = i2slam!("info", ours).exits_with(0);
    assert!(told.out.contains("folder of pictures"), "{}", told.out);
    let out = scratch.join("out");
    let ran = i2slam!("run", ours, "--out", out).exits_with(1);
    let ran = ran.stderr_contains("run by colour alone");
    ran.stderr_contains("camera not given").stderr_contains("3 pictures could not be used");
    assert!(!out.exists());
    let depth = i2slam!("run", ours, "--out", out, "--preset", "paper-tum").exits_with(2);
    depth.stderr_contains("is for RGB-D");
}

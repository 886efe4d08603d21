//! Sequences made worse: what is asked for happens, and nothing else.

mod support;

use i2slam_dataset::{OpenOptions, Sequence};
use i2slam_synthetic::{
    Degradation, ExposureStep, KinectNoise, NoiseSpec, SyntheticError, degrade,
};
use support::{Scratch, files, render, small_spec};

fn open(folder: &std::path::Path) -> Sequence {
    let options = OpenOptions { minimum_gap: 0.0, ..OpenOptions::default() };
    Sequence::open(folder, &options).expect("a sequence")
}

#[test]
fn a_sequence_is_made_worse_in_the_ways_asked_for() {
    let scratch = Scratch::new("degrade");
    let source = scratch.0.join("source");
    render(&small_spec(), &source);
    nothing_asked_changes_nothing(&source, &scratch.0.join("same"));
    let what = Degradation {
        seed: 3,
        depth_noise: Some(KinectNoise::default()),
        sensor_noise: Some(NoiseSpec { read: 0.002, shot: 0.0005 }),
        exposure_steps: vec![ExposureStep { frame: 4, stops: -1.0 }],
        dropped: Vec::from([1..2, 1..2]),
        covered: Vec::from([3..4, 4..4]),
        ..Degradation::default()
    };
    let (one, two) = (scratch.0.join("a/out"), scratch.0.join("b/out"));
    let done = degrade(&source, &one, true, &what, &mut |_, _| true).expect("a sequence");
    assert_eq!((done.frames, done.dropped, done.covered), (6, 1, 1));
    degrade(&source, &two, true, &what, &mut |_, _| true).expect("a sequence");
    assert!(files(&one) == files(&two), "the same seed gives the same bytes");
    let (before, after) = (open(&source), open(&one));
    let mean = |s: &Sequence, i: usize| {
        let frame = s.load(i).expect("a frame");
        frame.colour.data.iter().sum::<f32>() / frame.colour.data.len() as f32
    };
    let close = |a: f32, b: f32| (a - b).abs() < 0.01;
    assert!(close(mean(&after, 1), mean(&before, 2)), "frame 1 is gone");
    assert!(mean(&after, 2) < 0.03, "covered");
    let covered = after.load(2).expect("a frame");
    assert!(covered.depth_image().expect("depth").data.iter().all(|&z| z == 0.0));
    assert!(mean(&after, 4) < 0.8 * mean(&before, 5), "one stop darker");
    let (exact, noisy) = (before.load(0).expect("a frame"), after.load(0).expect("a frame"));
    assert!(exact.depth != noisy.depth && exact.colour.data != noisy.colour.data);
    assert!((after.entries[1].timestamp - before.entries[2].timestamp).abs() < 1e-9);
    let same = |name: &str, number: usize, was: usize| {
        let read = |folder: &std::path::Path, i: usize| {
            let kind = if name == "hdr" { "exr" } else { "png" };
            std::fs::read(folder.join(format!("{name}/{i:06}.{kind}"))).expect("a file")
        };
        assert!(read(&one, number) == read(&source, was), "{name}");
    };
    same("sharp", 5, 6);
    same("hdr", 5, 6);
}

fn nothing_asked_changes_nothing(source: &std::path::Path, out: &std::path::Path) {
    degrade(source, out, true, &Degradation::default(), &mut |_, _| true).expect("a sequence");
    let (from, to) = (open(source), open(out));
    assert_eq!(from.camera, to.camera);
    for i in 0..from.len() {
        let (a, b) = (from.load(i).expect("a frame"), to.load(i).expect("a frame"));
        assert!(a.colour == b.colour && a.depth == b.depth, "frame {i}");
    }
}

#[test]
fn frames_left_out_by_chance_come_near_their_share() {
    let scratch = Scratch::new("drop");
    let mut spec = small_spec();
    spec.camera.frames = 60;
    (spec.camera.width, spec.camera.height) = (16, 16);
    (spec.camera.sub_frames, spec.camera.sharp_samples) = (1, 1);
    let source = scratch.0.join("source");
    render(&spec, &source);
    let what = Degradation { drop_share: 0.3, seed: 9, ..Degradation::default() };
    let done =
        degrade(&source, &scratch.0.join("out"), true, &what, &mut |_, _| true).expect("frames");
    assert!((9..=27).contains(&done.dropped), "{done:?}");
    assert_eq!(done.frames + done.dropped, 60);
}

#[test]
fn what_cannot_be_meant_is_refused() {
    let scratch = Scratch::new("refused");
    let out = scratch.0.join("out");
    let all = Degradation { drop_share: 1.0, ..Degradation::default() };
    let error = degrade(&out, &out, true, &all, &mut |_, _| true).expect_err("all frames");
    assert!(error.to_string().contains("share of dropped frames"), "{error}");
    std::fs::create_dir_all(&out).expect("a folder");
    let error = degrade(&out, &out, true, &Degradation::default(), &mut |_, _| true);
    assert!(matches!(error, Err(SyntheticError::OutOfRange { .. })), "over itself");
    let error =
        degrade(&scratch.0.join("none"), &out, true, &Degradation::default(), &mut |_, _| true);
    assert!(matches!(error, Err(SyntheticError::Dataset(_))));
}

/// The rendered sequence in the layout of Replica, whose poses stand in `traj.txt`.
fn as_replica(source: &std::path::Path, out: &std::path::Path) {
    let sequence = open(source);
    std::fs::create_dir_all(out.join("results")).expect("a folder");
    let mut poses = String::new();
    for (i, pose) in sequence.true_trajectory().expect("poses").iter().enumerate() {
        let rows = pose.world_from_camera.rotation.matrix().rows;
        for (row, t) in rows.iter().zip(pose.world_from_camera.translation.to_array()) {
            poses += &format!("{} {} {} {t} ", row[0], row[1], row[2]);
        }
        poses += "0 0 0 1\n";
        for (kind, name) in [("rgb", "frame"), ("depth", "depth")] {
            let to = out.join(format!("results/{name}{i:06}.png"));
            std::fs::copy(source.join(format!("{kind}/{i:06}.png")), to).expect("room");
        }
    }
    std::fs::write(out.join("traj.txt"), poses).expect("room");
    let c = sequence.camera;
    let (cx, cy) = (c.cx - 0.5, c.cy - 0.5);
    let camera = format!(
        r#"{{"camera":{{"w":{},"h":{},"fx":{},"fy":{},"cx":{cx},"cy":{cy},"scale":5000}}}}"#,
        c.width, c.height, c.fx, c.fy
    );
    std::fs::write(out.join("cam_params.json"), camera).expect("room");
}

#[test]
fn poses_come_along_whatever_the_layout_keeps_them_in() {
    let scratch = Scratch::new("poses");
    let (source, other) = (scratch.0.join("source"), scratch.0.join("replica"));
    let mut spec = small_spec();
    spec.camera.frames = 4;
    render(&spec, &source);
    as_replica(&source, &other);
    let out = scratch.0.join("out");
    let what = Degradation { dropped: Vec::from([1..2, 1..1]), ..Degradation::default() };
    degrade(&other, &out, true, &what, &mut |_, _| true).expect("a sequence");
    let (before, after) = (open(&source), open(&out));
    let truth = after.true_trajectory().expect("poses");
    for (entry, was) in after.entries.iter().zip([0, 2, 3]) {
        let due = before.true_trajectory().expect("poses")[was].world_from_camera;
        let known = truth.iter().find(|p| (p.timestamp - entry.timestamp).abs() < 1e-4);
        let step = due.local(known.expect("a pose of its time").world_from_camera);
        assert!(step.translation.norm() < 1e-5 && step.rotation.norm() < 1e-5, "frame {was}");
    }
}

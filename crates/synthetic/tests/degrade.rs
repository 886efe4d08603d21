//! Sequences made worse: what is asked for happens, and nothing else.

mod support;

use i2slam_dataset::{FrameEntry, OpenOptions, Sequence, read_colour};
use i2slam_synthetic::Spec;
use i2slam_synthetic::{
    Degradation, DegradationCounts, DepthDegradation, ExposureStep, KinectNoise, NoiseSpec,
    SyntheticError, degrade,
};
use std::path::Path;
use std::sync::Arc;
use support::{Scratch, files, render, small_spec};

/// Frames whose light and blur hardly matter.
fn coarse_spec() -> Spec {
    let mut spec = small_spec();
    (spec.camera.sub_frames, spec.camera.sharp_samples) = (1, 1);
    spec.light.texel = 0.4;
    spec
}

fn open(folder: &Path) -> Sequence {
    let options = OpenOptions { minimum_gap: 0.0, ..OpenOptions::default() };
    Sequence::open(folder, &options).expect("a sequence")
}

#[test]
fn a_sequence_is_made_worse_in_the_ways_asked_for() {
    let scratch = Scratch::new("degrade");
    let source = scratch.0.join("source");
    render(&coarse_spec(), &source);
    nothing_asked_changes_nothing(&source, &scratch.0.join("same"));
    let what = Degradation {
        seed: 3,
        depth: DepthDegradation {
            noise: Some(KinectNoise::default()),
            ..DepthDegradation::default()
        },
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
        let read = |folder: &Path, i: usize| {
            let kind = if name == "hdr" { "exr" } else { "png" };
            std::fs::read(folder.join(format!("{name}/{i:06}.{kind}"))).expect("a file")
        };
        assert!(read(&one, number) == read(&source, was), "{name}");
    };
    same("sharp", 1, 2);
    same("hdr", 5, 6);
    // The sharp picture has the exposure of the one taken.
    let sharp = |folder: &Path, i: usize| {
        let picture = read_colour(&folder.join(format!("sharp/{i:06}.png"))).expect("a picture");
        picture.data.iter().sum::<f32>() / picture.data.len() as f32
    };
    let [sharp_ratio, taken_ratio] =
        [sharp(&one, 4) / sharp(&source, 5), mean(&after, 4) / mean(&before, 5)];
    assert!((sharp_ratio / taken_ratio - 1.0).abs() < 0.03, "{sharp_ratio} {taken_ratio}");
}

fn nothing_asked_changes_nothing(source: &Path, out: &Path) {
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
    let mut spec = coarse_spec();
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

fn what_does_not_fit_the_sequence_is_named(source: &Path, folder: &Path) {
    let out = folder.join("refused");
    let message = |change: &dyn Fn(&mut Degradation)| {
        let mut what = Degradation::default();
        change(&mut what);
        let error = degrade(source, &out, true, &what, &mut |_, _| true).expect_err("refused");
        error.to_string()
    };
    let range = |frames: std::ops::Range<usize>| vec![frames];
    for (error, words) in [
        (message(&|w| w.grey = range(5..9)), "grey frames = 5..9 is out of range: the sequence"),
        (message(&|w| w.frozen = range(6..8)), "frozen frames = 6..8"),
        (message(&|w| w.frozen = range(0..2)), "a frame before the range"),
        (message(&|w| w.shuffled = range(3..4)), "at least two frames"),
        (message(&|w| w.moving_object = Some(0.9)), "share of the moving object = 0.9"),
        (message(&|w| w.depth.shift = [80, 0]), "less than the picture's 80 px"),
        (message(&|w| w.depth.outliers = 2.0), "share of outliers"),
        (message(&|w| w.scale = 1.5), "scale"),
    ] {
        assert!(error.contains(words), "{error}");
    }
}

fn degraded(source: &Path, out: &Path, what: &Degradation) -> Sequence {
    degrade(source, out, true, what, &mut |_, _| true).expect("a sequence");
    open(out)
}

fn depth(sequence: &Sequence, frame: usize) -> Arc<i2slam_geometry::Image<f32>> {
    sequence.load(frame).expect("a frame").depth.expect("depth").image
}

#[test]
fn every_kind_of_fault_is_the_one_asked_for() {
    let scratch = Scratch::new("kinds");
    let source = scratch.0.join("source");
    // Few frames a second: depth that is late by 20 ms stays with its frame.
    let mut spec = coarse_spec();
    spec.camera.frame_rate = 15.0;
    render(&spec, &source);
    for check in [
        late_depth_has_later_stamps,
        frozen_grey_and_shuffled_frames_keep_their_truth,
        a_moving_object_hides_its_share_of_every_picture,
        all_kinds_combine_and_pictures_may_be_smaller,
        what_does_not_fit_the_sequence_is_named,
    ] {
        check(&source, &scratch.0);
    }
}

fn late_depth_has_later_stamps(source: &Path, folder: &Path) {
    let before = open(source);
    for delay in [0.02, -0.02] {
        let depth = DepthDegradation { delay, ..DepthDegradation::default() };
        let what = Degradation { depth, ..Degradation::default() };
        let after = degraded(source, &folder.join("late"), &what);
        assert_eq!(after.len(), before.len());
        for (frame, (a, b)) in after.entries.iter().zip(&before.entries).enumerate() {
            let stamp = |entry: &FrameEntry| entry.depth.as_ref().expect("depth").timestamp;
            assert_eq!(a.timestamp, b.timestamp);
            assert!((stamp(a) - stamp(b) - delay).abs() < 2e-6, "{frame}");
            assert_eq!(self::depth(&after, frame), self::depth(&before, frame));
        }
    }
}

fn frozen_grey_and_shuffled_frames_keep_their_truth(source: &Path, folder: &Path) {
    let out = folder.join("out");
    let what = Degradation {
        seed: 2,
        frozen: Vec::from([2..4, 2..2]),
        grey: Vec::from([1..2, 1..1]),
        shuffled: std::iter::once(4..7).collect(),
        sensor_noise: Some(NoiseSpec { read: 0.01, shot: 0.0 }),
        ..Degradation::default()
    };
    let done = degrade(source, &out, true, &what, &mut |_, _| true).expect("a sequence");
    assert_eq!(done, DegradationCounts { frames: 7, grey: 3, displaced: done.displaced, ..done });
    assert!(done.displaced >= 4, "{done:?}");
    let (before, after) = (open(source), open(&out));
    let grey = after.load(1).expect("a frame");
    assert!(grey.colour.data.iter().all(|&v| (v - 0.5).abs() < 0.01), "grey");
    assert_eq!(depth(&after, 1), depth(&before, 1));
    let bytes = |name: &str| std::fs::read(out.join(name)).expect("a file");
    for kind in ["rgb", "depth"] {
        for frame in [2, 3] {
            let frozen = bytes(&format!("{kind}/{frame:06}.png"));
            assert!(frozen == bytes(&format!("{kind}/000001.png")), "{kind} {frame}");
        }
    }
    let (truth, source_truth) =
        (after.true_trajectory().expect("poses"), before.true_trajectory().expect("poses"));
    let table = std::fs::read_to_string(out.join("source.csv")).expect("a table");
    let rows: Vec<usize> = table
        .lines()
        .skip(1)
        .map(|line| line.split(',').nth(1).and_then(|cell| cell.parse().ok()).expect("a number"))
        .collect();
    for (frame, &shown) in rows.iter().enumerate() {
        // Where a shuffled picture was taken; where the camera is while a frozen one stays.
        let due = if (2..4).contains(&frame) { frame } else { shown };
        let step = source_truth[due].world_from_camera.local(truth[frame].world_from_camera);
        assert!(step.translation.norm() < 1e-5 && step.rotation.norm() < 1e-5, "frame {frame}");
        assert_eq!(depth(&after, frame), depth(&before, shown), "frame {frame}");
        let sharp = bytes(&format!("sharp/{frame:06}.png"));
        assert!(sharp == std::fs::read(source.join(format!("sharp/{due:06}.png"))).expect("one"));
        assert!((after.entries[frame].timestamp - before.entries[frame].timestamp).abs() < 1e-9);
    }
    assert!(rows[4..] != [4, 5, 6]);
    let ends = |file: &Path| {
        let text = std::fs::read_to_string(file.join("groundtruth_shutter.txt")).expect("poses");
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        lines.map(|line| line.split_once(' ').expect("numbers").1.to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(ends(&out)[5], ends(source)[rows[5]]);
}

fn a_moving_object_hides_its_share_of_every_picture(source: &Path, folder: &Path) {
    let what = Degradation { moving_object: Some(0.2), ..Degradation::default() };
    let (before, after) = (open(source), degraded(source, &folder.join("out"), &what));
    for frame in 0..7 {
        let [a, b] = [&before, &after].map(|sequence| sequence.load(frame).expect("a frame"));
        let (far, with_ball) = (depth(&before, frame), depth(&after, frame));
        let near = far.data.iter().zip(&with_ball.data).filter(|(a, b)| *b < *a).count();
        let share = near as f64 / 4800.0;
        assert!((share - 0.2).abs() < 0.05, "{frame}: {share}");
        let changed = a.colour.plane(0).iter().zip(b.colour.plane(0)).filter(|(a, b)| a != b);
        let changed = changed.count() as f64 / 4800.0;
        assert!((changed - share).abs() < 0.06, "{frame}: {changed} in colour, {share} in depth");
    }
}

fn all_kinds_combine_and_pictures_may_be_smaller(source: &Path, folder: &Path) {
    let what = Degradation {
        seed: 5,
        scale: 0.5,
        vignetting: Some(0.6),
        depth: DepthDegradation {
            delay: 0.02,
            noise: Some(KinectNoise::times(3.0)),
            block: 2,
            smoothing: 1.0,
            factor: 1.03,
            shift: [4, 0],
            outliers: 0.05,
        },
        sensor_noise: Some(NoiseSpec { read: 0.002, shot: 0.0005 }),
        exposure_steps: vec![ExposureStep { frame: 4, stops: -1.0 }],
        drop_share: 0.1,
        dropped: Vec::from([1..2, 1..2]),
        covered: Vec::from([2..3, 2..3]),
        grey: Vec::from([3..4, 3..4]),
        frozen: Vec::from([6..7, 6..7]),
        shuffled: std::iter::once(4..6).collect(),
        moving_object: Some(0.1),
        response: i2slam_synthetic::Response::Reinhard,
    };
    let (one, two) = (folder.join("a/out"), folder.join("b/out"));
    let after = degraded(source, &one, &what);
    degraded(source, &two, &what);
    assert!(files(&one) == files(&two), "the same seed gives the same bytes");
    assert_eq!((after.camera.width, after.camera.height), (40, 30));
    assert!((after.camera.fx / open(source).camera.fx - 0.5).abs() < 1e-9);
    assert!(!one.join("sharp").exists(), "sharp pictures of another size stay behind");
    let other = Degradation { seed: 6, ..what };
    degraded(source, &two, &other);
    assert!(files(&one) != files(&two), "seeds differ");
}

/// The rendered sequence in the layout of Replica, whose poses stand in `traj.txt`.
fn as_replica(source: &Path, out: &Path) {
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
    let mut spec = coarse_spec();
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

//! Poses in a wrong convention are noticed, and the right one is named.

use super::droid::{folder, members, npy, with};
use super::nerfstudio::transforms;
use super::scene::{HEIGHT, WIDTH, grey16_png, line, pose, sequence, stamp, trajectory};
use crate::support::{Folder, assert_warns, import, shared_data};
use i2slam_dataset::import::{ImportDepth, ImportOptions, ImportedKeyframes};
use i2slam_dataset::{OpenOptions, Sequence};
use i2slam_geometry::{Pose, Rotation, Vec3};
use std::path::Path;

fn warnings_of(folder: &Folder, options: ImportOptions) -> Vec<String> {
    let options = ImportOptions { depth: ImportDepth::Pictures, ..options };
    let files =
        ImportedKeyframes::open(&folder.join("keyframes.txt"), None, &options).expect("opens");
    files.warnings
}

fn written(other: impl Fn(Pose<f64>) -> Pose<f64>) -> String {
    (0..6).map(|i| line(stamp(i), other(pose(i)))).collect()
}

fn opengl(pose: Pose<f64>) -> Pose<f64> {
    let half_turn = Rotation { w: 0.0, v: Vec3::new(1.0, 0.0, 0.0) };
    Pose { rotation: pose.rotation * half_turn, ..pose }
}

#[test]
fn trajectories_written_otherwise_are_noticed() {
    let folder = sequence(6);
    folder.write("keyframes.txt", trajectory(0..6));
    assert_eq!(warnings_of(&folder, ImportOptions::default()), [""; 0]);
    folder.write("keyframes.txt", written(Pose::inverse));
    let parts = ["wrong convention", "if the poses are camera_from_world:", "keyframes.txt"];
    assert_warns(&warnings_of(&folder, ImportOptions::default()), &parts);
    let off = ImportOptions { check_conventions: false, ..ImportOptions::default() };
    assert_eq!(warnings_of(&folder, off), [""; 0]);
    folder.write("keyframes.txt", written(opengl));
    assert_warns(&warnings_of(&folder, ImportOptions::default()), &["camera axes of OpenGL (y up"]);
    folder.write("keyframes.txt", written(|pose| opengl(pose).inverse()));
    let parts = ["camera_from_world with camera axes of OpenGL"];
    assert_warns(&warnings_of(&folder, ImportOptions::default()), &parts);
    let reordered = (0..6).map(|i| {
        let (t, q) = (pose(i).translation, pose(i).rotation);
        let (x, y, z) = (q.v.x, q.v.y, q.v.z);
        format!("{:.6} {} {} {} {} {x} {y} {z}\n", stamp(i), t.x, t.y, t.z, q.w)
    });
    folder.write("keyframes.txt", reordered.collect::<String>());
    assert_warns(&warnings_of(&folder, ImportOptions::default()), &["in the order w x y z"]);
}

#[test]
fn another_unit_of_depth_is_noticed() {
    let folder = sequence(6);
    folder.write("keyframes.txt", trajectory(0..6));
    for (depth_scale, factor) in [(500.0, "by about 8"), (25000.0, "by about 0.25")] {
        let open = OpenOptions { depth_scale: Some(depth_scale), ..OpenOptions::default() };
        let found = warnings_of(&folder, ImportOptions { open, ..ImportOptions::default() });
        assert_warns(&found, &["different units", factor]);
        assert!(found.iter().all(|warning| !warning.contains("is not given")), "{found:?}");
    }
}

#[test]
fn poses_of_another_sequence_fit_by_no_convention() {
    let folder = sequence(6);
    let written = |turn: Vec3<f64>, step: Vec3<f64>| {
        let pose = |i: usize| Pose::new(Rotation::exp(turn * i as f64), step * i as f64);
        let poses: String = (0..6).map(|i| line(stamp(i), pose(i))).collect();
        folder.write("keyframes.txt", poses);
        warnings_of(&folder, ImportOptions::default())
    };
    // Keyframes that see nothing of each other tell nothing.
    let far = written(Vec3::new(0.3, 2.2, -0.4), Vec3::new(0.0, 7.0, 0.0));
    assert_eq!(far, [""; 0]);
    // A camera that rolls where every other picture is of somewhere nearer.
    for i in [1, 3, 5] {
        folder.write(&format!("depth/{i:03}.png"), grey16_png(&[2000; WIDTH * HEIGHT]));
    }
    let near = written(Vec3::new(0.0, 0.0, 2.2), Vec3::new(0.0, 0.0, 0.0));
    assert_warns(&near, &["disagree", "of 1", "no other convention"]);
}

#[test]
fn arrays_with_poses_of_the_camera_are_noticed() {
    let frames = [0, 1, 2, 3, 4, 5];
    let poses: Vec<f64> = frames
        .iter()
        .flat_map(|&i| {
            let (t, q) = (pose(i).translation, pose(i).rotation);
            [t.x, t.y, t.z, q.v.x, q.v.y, q.v.z, q.w]
        })
        .collect();
    let folder = folder(&with(members(&frames), "poses", npy("<f8", &[6, 7], &poses)));
    let files = import(&folder).expect("opens");
    let parts = ["if the poses are world_from_camera:", "hold camera_from_world"];
    assert_warns(&files.warnings, &parts);
}

#[test]
fn one_pair_of_keyframes_tells_nothing() {
    let folder = sequence(6);
    folder.write("keyframes.txt", [0, 3].map(|i| line(stamp(i), pose(i).inverse())).concat());
    assert_eq!(warnings_of(&folder, ImportOptions::default()), [""; 0]);
    folder.write("keyframes.txt", [0, 3, 5].map(|i| line(stamp(i), pose(i).inverse())).concat());
    assert_warns(&warnings_of(&folder, ImportOptions::default()), &["camera_from_world", "of 1"]);
}

#[test]
fn nerfstudio_with_axes_of_opencv_is_noticed() {
    let folder = sequence(6);
    let file = folder.write("transforms.json", transforms(&[0, 1, 2, 3, 4, 5], true, false));
    let files = import(&file).expect("opens");
    assert_warns(&files.warnings, &["wrong convention", "camera axes of OpenCV (y down"]);
}

/// The poses of every tenth frame of a sequence, read with its depth pictures.
fn keyframes(path: &Path, written: impl Fn(Pose<f64>) -> Pose<f64>) -> ImportedKeyframes {
    let open = OpenOptions { scale: 0.5, ..OpenOptions::default() };
    let sequence = Sequence::open(path, &open).expect("opens");
    let truth = sequence.true_trajectory().expect("poses");
    let nearest = |time: f64| {
        let apart = |pose: &&i2slam_geometry::StampedPose| (pose.timestamp - time).abs();
        truth.iter().min_by(|a, b| apart(a).total_cmp(&apart(b))).expect("a pose")
    };
    let chosen = sequence.entries.iter().step_by(10).map(|entry| nearest(entry.timestamp));
    let text = chosen.map(|pose| line(pose.timestamp, written(pose.world_from_camera)));
    let folder = Folder::new();
    let file = folder.write("keyframes.txt", text.collect::<String>());
    let options = ImportOptions { open, depth: ImportDepth::Pictures, ..ImportOptions::default() };
    ImportedKeyframes::open(&file, Some(path), &options).expect("opens")
}

#[test]
#[ignore = "needs the sequences of ../shared/data"]
fn true_poses_fit_and_their_inverses_do_not() {
    for name in ["classroom", "dining-room", "tum_fr1_rpy_clip"] {
        let path = shared_data(name);
        let files = keyframes(&path, |pose| pose);
        let odd = |warning: &&String| {
            ["convention", "unit", "disagree", "poses left out"].iter().any(|w| warning.contains(w))
        };
        let odd: Vec<&String> = files.warnings.iter().filter(odd).collect();
        assert!(odd.is_empty(), "{name}: {odd:?}");
        let inverse = keyframes(&path, Pose::inverse);
        assert_warns(&inverse.warnings, &["if the poses are camera_from_world:"]);
    }
}

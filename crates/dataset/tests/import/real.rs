//! True trajectories of real and path-traced sequences, as keyframes.

use crate::assert_warns;
use crate::scene::line;
use crate::support::{Folder, shared_data};
use i2slam_dataset::import::{ImportDepth, ImportOptions, ImportedKeyframes};
use i2slam_dataset::{OpenOptions, Sequence};
use i2slam_geometry::Pose;
use std::path::Path;

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
fn true_poses_fit_and_their_inverses_do_not() {
    for name in ["classroom", "dining-room", "tum_fr1_rpy_clip"] {
        let Some(path) = shared_data(name) else { continue };
        let files = keyframes(&path, |pose| pose);
        let odd = |warning: &&String| {
            ["convention", "unit", "disagree", "poses left out"].iter().any(|w| warning.contains(w))
        };
        let odd: Vec<&String> = files.warnings.iter().filter(odd).collect();
        assert!(odd.is_empty(), "{name}: {odd:?}");
        let inverse = keyframes(&path, Pose::inverse);
        println!("{name}, inverse poses: {:?}", inverse.warnings);
        assert_warns(&inverse.warnings, &["if the poses are camera_from_world:"]);
    }
}

//! A trajectory in the TUM format with pictures.

use super::assert_same;
use super::scene::{
    HEIGHT, WIDTH, colour_sequence, line, pose, render, sequence, stamp, trajectory,
};
use crate::support::{Folder, assert_says, assert_warns, import, import_with};
use i2slam_dataset::import::{ImportDepth, ImportFormat, ImportOptions, ImportedKeyframes};
use i2slam_dataset::{DatasetError, DepthPairing, OpenOptions, Sequence};

fn open(poses: &Folder, pictures: &Folder) -> Result<ImportedKeyframes, DatasetError> {
    let file = poses.join("keyframes.txt");
    import_with(&file, pictures)
}

#[test]
fn keyframes_get_their_pictures() {
    let folder = colour_sequence(7);
    folder.write("keyframes.txt", trajectory([1, 3, 6]));
    let files = open(&folder, &folder).expect("opens");
    assert_eq!((files.format, files.len(), files.has_depth), (ImportFormat::Trajectory, 3, false));
    assert_eq!(files.unmatched.images_without_pose, 4);
    assert_eq!(files.unmatched.poses_without_image, 0);
    assert!(files.warnings.is_empty(), "{:?}", files.warnings);
    assert_eq!((files.camera.width, files.camera.cx), (WIDTH, 24.0));
    for (place, i) in [1, 3, 6].into_iter().enumerate() {
        let keyframe = files.load(place).expect("loads");
        assert_eq!((keyframe.index, keyframe.timestamp), (i, stamp(i)));
        assert_same(keyframe.world_from_camera, pose(i));
        let due = f32::from(render(i).1[3 * (5 * WIDTH + 9) + 1]) / 255.0;
        assert_eq!(keyframe.colour.at(1, 9, 5), due);
        assert!(keyframe.depth.is_none() && keyframe.variance.is_none());
    }
    assert_says(files.load(3), &["frame 3", "3 frames"]);
}

#[test]
fn without_a_folder_of_pictures_those_beside_the_poses_are_taken() {
    let folder = colour_sequence(3);
    let file = folder.write("trajectory.txt", trajectory([0, 2]));
    let by_file = import(&file).expect("opens");
    let by_folder = import(&folder).expect("opens");
    assert_eq!(by_file.keyframes, by_folder.keyframes);
    assert_eq!(by_file.len(), 2);
}

#[test]
fn depth_pictures_come_when_asked_for() {
    let folder = sequence(4);
    let file = folder.write("keyframes.txt", trajectory([0, 2]));
    let options = ImportOptions { depth: ImportDepth::Pictures, ..ImportOptions::default() };
    let files = ImportedKeyframes::open(&file, None, &options).expect("opens");
    let depth = files.load(1).expect("loads").depth.expect("depth");
    let due = render(2).0[4 * WIDTH + 7];
    assert!((f64::from(depth.at(0, 7, 4)) - due).abs() < 2e-4);
    let without = import(&file).expect("opens");
    assert!(without.load(1).expect("loads").depth.is_none());
    let alone = colour_sequence(4);
    assert_says(
        ImportedKeyframes::open(&file, Some(&alone.0), &options),
        &["pictures but no depth", "rgb.txt"],
    );
}

#[test]
fn range_stride_and_scale_hold_for_the_pictures() {
    let folder = colour_sequence(9);
    let file = folder.write("keyframes.txt", trajectory(0..9));
    let open = OpenOptions { frames: Some(2..9), stride: 3, scale: 0.5, ..OpenOptions::default() };
    let options = ImportOptions { open, ..ImportOptions::default() };
    let files = ImportedKeyframes::open(&file, None, &options).expect("opens");
    let indices: Vec<usize> = files.keyframes.iter().map(|keyframe| keyframe.index).collect();
    assert_eq!(indices, [2, 5, 8]);
    let colour = files.load(1).expect("loads").colour;
    assert_eq!((colour.width, colour.height), (WIDTH / 2, HEIGHT / 2));
    assert_eq!(files.unmatched.poses_without_image, 0);
    let open = OpenOptions { frames: Some(8..9), ..OpenOptions::default() };
    let options = ImportOptions { open, ..ImportOptions::default() };
    assert_says(
        ImportedKeyframes::open(&file, None, &options),
        &["1 of 9 poses", "9 have a picture", "choose 1"],
    );
}

#[test]
fn poses_without_images_are_counted_and_told() {
    let folder = colour_sequence(5);
    let gone = [line(stamp(7), pose(7)), line(stamp(9), pose(9))].concat();
    folder.write("keyframes.txt", trajectory([0, 2, 4]) + &gone);
    let files = open(&folder, &folder).expect("opens");
    assert_eq!((files.len(), files.unmatched.poses_without_image), (3, 2));
    assert_warns(&files.warnings, &["2 of 5 poses left out", "no picture within 0.08 s"]);
}

#[test]
fn a_missing_frame_does_not_pass_its_pose_on_quietly() {
    let folder = colour_sequence(5);
    folder.write("keyframes.txt", line(stamp(0), pose(0)) + &line(stamp(2) + 0.06, pose(2)));
    let files = open(&folder, &folder).expect("opens");
    assert_warns(&files.warnings, &["up to 0.040 s", "0.100 s apart", "missing"]);
}

#[test]
fn other_clocks_and_single_keyframes_are_refused() {
    let folder = colour_sequence(4);
    folder.write("keyframes.txt", line(5.0, pose(0)) + &line(6.0, pose(1)));
    let says = ["keyframes.txt", "0 of 2 poses", "at least 2", "94.000 s apart", "one clock"];
    assert_says(open(&folder, &folder), &says);
    folder.write("keyframes.txt", trajectory([1]));
    assert_says(open(&folder, &folder), &["1 of 1 poses", "at least 2"]);
}

#[test]
fn unusable_lines_are_named() {
    let folder = colour_sequence(3);
    let good = trajectory([0]);
    folder.write("keyframes.txt", good.clone() + "100.1 0 0 0 0 0 0 1.3\n");
    assert_says(open(&folder, &folder), &["line 2", "length 1.300", "expected 1"]);
    folder.write("keyframes.txt", good + "100.1 0 0 0 0 0 0 1.003\n");
    assert_eq!(open(&folder, &folder).expect("rounded").len(), 2);
}

#[test]
fn what_holds_no_keyframes_is_refused() {
    let folder = colour_sequence(2);
    let open = |name: &str| import(&folder.join(name));
    assert_says(open("nothing"), &["no keyframes", "found nothing", "timestamp tx ty tz"]);
    assert_says(open("rgb"), &["found 000.png, 001.png"]);
    folder.write("notes.md", "hello");
    assert_says(open("notes.md"), &["notes.md holds no keyframes", "another kind"]);
}

#[test]
fn frames_have_the_same_number_with_and_without_depth() {
    let folder = sequence(5);
    let list = std::fs::read_to_string(folder.join("depth.txt")).expect("reads");
    let last = list.lines().count() - 1;
    folder.write("depth.txt", list.lines().take(last).collect::<Vec<_>>().join("\n"));
    let indices = |colour_only, depth_pairing| {
        let options = OpenOptions { colour_only, depth_pairing, ..OpenOptions::default() };
        let sequence = Sequence::open(&folder.0, &options).expect("opens");
        let frame = sequence.load(0).expect("loads");
        assert_eq!(frame.depth.is_some(), !colour_only);
        sequence.entries.iter().map(|entry| (entry.index, entry.timestamp)).collect::<Vec<_>>()
    };
    for (pairing, frames) in [(DepthPairing::OneToOne, 5), (DepthPairing::Nearest, 4)] {
        assert_eq!(indices(true, pairing), indices(false, pairing));
        assert_eq!(indices(true, pairing).len(), frames);
    }
}

//! Matching of frame numbers and times with images, and options without effect.

use super::colmap::{text_model, write_binary};
use super::droid::{folder, members, npy, with};
use super::scene::{colour_sequence, line, pose, sequence, stamp, trajectory};
use crate::support::{Folder, assert_says, assert_warns, import, import_with};
use i2slam_dataset::import::{ImportDepth, ImportOptions, ImportedKeyframes};
use i2slam_dataset::{OpenOptions, Sequence};

fn arrays(frames: &[usize], stamps: &[f64]) -> Folder {
    folder(&with(members(frames), "tstamps", npy("<i8", &[stamps.len()], stamps)))
}

/// Time stamps of the pictures that the keyframes get.
fn times(files: &ImportedKeyframes) -> Vec<f64> {
    files.keyframes.iter().map(|keyframe| keyframe.timestamp).collect()
}

#[test]
fn frame_numbers_count_pictures_that_are_no_frames_too() {
    let pictures = sequence(7);
    let list = std::fs::read_to_string(pictures.join("depth.txt")).expect("reads");
    // Pictures 0 and 3 have no depth.
    let kept = |(i, line): (usize, &str)| (i != 0 && i != 3).then(|| line.to_owned());
    let kept: Vec<String> = list.lines().enumerate().filter_map(kept).collect();
    pictures.write("depth.txt", kept.join("\n"));
    let frames = [1, 4, 6];
    let stamps = frames.map(|i| i as f64);
    let arrays = arrays(&frames, &stamps);
    let files = import_with(&arrays.0, &pictures).expect("opens");
    assert_eq!(times(&files), frames.map(stamp));
}

#[test]
fn frame_numbers_of_another_stride_are_noticed() {
    let pictures = colour_sequence(9);
    let open = |frames_per_stamp: usize| {
        let options = ImportOptions { frames_per_stamp, ..ImportOptions::default() };
        let arrays = arrays(&[0, 3, 6], &[0.0, 1.0, 2.0]);
        ImportedKeyframes::open(&arrays.0, Some(&pictures.0), &options).expect("opens")
    };
    let parts = ["reach picture 3 of 9", "frames_per_stamp", "stride"];
    assert_warns(&open(1).warnings, &parts);
    assert!(open(3).warnings.is_empty(), "{:?}", open(3).warnings);
    assert_eq!(times(&open(3)), [0, 3, 6].map(stamp));
}

#[test]
fn steps_of_any_size_are_counted() {
    let pictures = colour_sequence(3);
    let options = ImportOptions { frames_per_stamp: usize::MAX, ..ImportOptions::default() };
    let arrays = arrays(&[0, 1], &[0.0, 2.0]);
    assert_says(
        ImportedKeyframes::open(&arrays.0, Some(&pictures.0), &options),
        &["1 of 2 poses", "stride"],
    );
}

#[test]
fn pictures_are_thinned_only_where_asked_for() {
    let pictures = colour_sequence(8);
    let time = |i: usize| i as f64 / 60.0;
    let list: String = (0..8).map(|i| format!("{:.6} rgb/{i:03}.png\n", time(i))).collect();
    pictures.write("rgb.txt", list);
    let poses: String = [1, 3, 5].map(|i| line(time(i), pose(i))).concat();
    let file = pictures.write("keyframes.txt", poses);
    let files = import(&file).expect("opens");
    let apart = times(&files).into_iter().zip([1, 3, 5]).map(|(t, i)| (t - time(i)).abs());
    assert!(files.len() == 3 && apart.fold(0.0, f64::max) < 1e-5, "{:?}", times(&files));
    assert!(files.warnings.is_empty(), "{:?}", files.warnings);
    assert_eq!(files.keyframes[2].index, 5);
    // With a gap frames have the numbers of the dataset, and no pose gets a neighbour's picture.
    let open = OpenOptions { colour_only: true, ..OpenOptions::default() };
    let sequence = Sequence::open(&pictures.0, &open).expect("opens");
    pictures.write("keyframes.txt", [1, 2, 3, 6].map(|i| line(time(i), pose(i))).concat());
    let options = ImportOptions { open, ..ImportOptions::default() };
    let files = ImportedKeyframes::open(&file, None, &options).expect("opens");
    let found = files.keyframes.iter().map(|keyframe| (keyframe.index, keyframe.timestamp));
    let entries = sequence.entries.iter().map(|entry| (entry.index, entry.timestamp));
    let entries: Vec<(usize, f64)> = entries.filter(|(_, t)| *t == 0.033333 || *t == 0.1).collect();
    assert_eq!(found.collect::<Vec<_>>(), entries);
    assert_warns(&files.warnings, &["2 of 4 poses left out", "minimum_gap"]);
}

#[test]
fn a_camera_that_does_not_count_is_told() {
    let intrinsics = Some([99.0, 99.0, 23.5, 15.5]);
    let open = OpenOptions { intrinsics, ..OpenOptions::default() };
    let options = ImportOptions { open, check_conventions: false, ..ImportOptions::default() };
    let (arrays, model) = (folder(&members(&[0, 1])), text_model(3, &[0, 1]));
    for path in [&arrays.0, &model.0] {
        let files = ImportedKeyframes::open(path, None, &options).expect("opens");
        assert_eq!(files.camera.fx, 40.0);
        assert_warns(&files.warnings, &["the given camera ignored"]);
    }
    let pictures = sequence(2);
    let files = ImportedKeyframes::open(&arrays.0, Some(&pictures.0), &options).expect("opens");
    assert_eq!(files.camera.fx, 99.0);
    assert!(!files.warnings.iter().any(|warning| warning.contains("ignored")));
}

#[test]
fn depth_pictures_that_are_not_read_are_told() {
    let pictures = sequence(3);
    let file = pictures.write("keyframes.txt", trajectory(0..3));
    let open = |depth: ImportDepth| {
        let options = ImportOptions { depth, ..ImportOptions::default() };
        ImportedKeyframes::open(&file, None, &options).expect("opens").warnings
    };
    assert_warns(&open(ImportDepth::Imported), &["no depth of its own", "not read"]);
    for depth in [ImportDepth::None, ImportDepth::Pictures] {
        assert_eq!(open(depth), [""; 0]);
    }
}

#[test]
fn the_text_of_a_model_is_read_where_it_is_named() {
    let folder = text_model(5, &[0, 2, 3]);
    write_binary(&folder, &[1, 4]);
    let len = |path: &str| {
        let files = import(&folder.join(path));
        files.expect("opens").len()
    };
    assert_eq!(["sparse/0/images.txt", "sparse/0/images.bin", ""].map(len), [3, 2, 2]);
}

#[test]
fn a_file_of_torch_is_told_how_to_convert() {
    let folder = sequence(1);
    for (name, start) in [("run.pth", "PK"), ("run.pt", "PK"), ("run", "PK run/data.pkl")] {
        let file = folder.write(name, start);
        assert_says(import(&file), &["torch.save", "np.savez", "docs/import.md"]);
    }
}

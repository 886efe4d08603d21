//! Pictures of the variance of depth pictures.

use crate::arrays::npy;
use crate::scene::{HEIGHT, WIDTH, grey16_png, sequence, trajectory};
use crate::{assert_says, assert_warns};
use i2slam_dataset::import::{ImportDepth, ImportOptions, ImportedKeyframes};

fn options(folder: &crate::support::Folder) -> ImportOptions {
    let variance = Some(folder.join("variance"));
    ImportOptions { depth: ImportDepth::Pictures, variance, ..ImportOptions::default() }
}

#[test]
fn variance_comes_from_arrays_and_from_pictures_of_deviation() {
    let folder = sequence(3);
    let file = folder.write("keyframes.txt", trajectory([0, 2]));
    let mut numbers = vec![0.01; WIDTH * HEIGHT];
    (numbers[3], numbers[4]) = (0.0, f64::NAN);
    folder.write("variance/000.npy", npy("<f4", &[HEIGHT, WIDTH], &numbers));
    folder.write("variance/sigma_2.png", grey16_png(&[500; WIDTH * HEIGHT]));
    let files = ImportedKeyframes::open(&file, None, &options(&folder)).expect("opens");
    assert!(files.has_variance);
    for place in 0..2 {
        let keyframe = files.load(place).expect("loads");
        let variance = keyframe.variance.expect("variance");
        assert!((variance.data[7] - 0.01).abs() < 1e-6, "{}", variance.data[7]);
        let depth = keyframe.depth.expect("depth");
        // Nothing is known of two pixels of the array: their depth does not count.
        let unknown = [depth.data[3], depth.data[4], variance.data[3], variance.data[4]];
        assert_eq!(unknown == [0.0; 4], place == 0);
    }
}

#[test]
fn variance_without_depth_pictures_is_told() {
    let folder = sequence(3);
    let file = folder.write("keyframes.txt", trajectory([0, 2]));
    let options = ImportOptions { depth: ImportDepth::Imported, ..options(&folder) };
    let files = ImportedKeyframes::open(&file, None, &options).expect("opens");
    assert_warns(&files.warnings, &["variance ignored"]);
}

#[test]
fn unusable_variances_are_named() {
    let folder = sequence(3);
    let file = folder.write("keyframes.txt", trajectory([0, 2]));
    let open = || ImportedKeyframes::open(&file, None, &options(&folder));
    assert_says(open(), &["cannot read", "variance"]);
    std::fs::create_dir_all(folder.join("variance")).expect("a folder");
    assert_says(open(), &["variance is empty", ".npy"]);
    folder.write("variance/000.npy", npy("<f4", &[4, 4], &[0.1; 16]));
    let load = |place: usize| open().expect("opens").load(place);
    assert_says(load(0), &["000.npy is 4x4", "expected 48x32", "depth pictures"]);
    assert_says(load(1), &["variance", "no variance with the name or number", "002.png"]);
    folder.write("variance/000.npy", npy("<f4", &[16], &[0.1; 16]));
    assert_says(load(0), &["000.npy", "[16]", "[height, width]"]);
    assert!(load(0).expect_err("an error").concerns_one_frame());
    for broken in [&b"no array"[..], &npy("<f4", &[HEIGHT, WIDTH], &[0.1; 16])] {
        folder.write("variance/000.npy", broken);
        assert!(load(0).expect_err("an error").concerns_one_frame());
    }
}

#[test]
fn names_and_numbers_that_repeat_are_not_guessed_at() {
    let folder = sequence(3);
    let file = folder.write("keyframes.txt", trajectory([0, 2]));
    let open = || ImportedKeyframes::open(&file, None, &options(&folder));
    let array = |value: f64| npy("<f4", &[HEIGHT, WIDTH], &[value; WIDTH * HEIGHT]);
    folder.write("variance/000.npy", array(0.01));
    folder.write("variance/sigma_2.png", grey16_png(&[500; WIDTH * HEIGHT]));
    folder.write("variance/2.npy", array(0.04));
    let files = open().expect("opens");
    assert!(files.load(0).is_ok());
    assert_says(files.load(1), &["002.png", "2.npy", "sigma_2.png", "share one"]);
    folder.write("variance/000.png", grey16_png(&[500; WIDTH * HEIGHT]));
    assert_says(open(), &["000.png", "000.npy", "same name"]);
}

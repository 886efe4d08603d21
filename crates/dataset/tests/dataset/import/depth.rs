//! Depth and variance of keyframes, from arrays and from images.

use super::droid::{folder, intrinsics, members, npy, with};
use super::scene::{HEIGHT, WIDTH, grey16_png, sequence, trajectory};
use crate::support::{Folder, assert_says, assert_warns, import, import_with};
use i2slam_dataset::import::{ImportDepth, ImportOptions, ImportedKeyframes, Keyframe};
use i2slam_geometry::Camera;

/// Size of the maps of an eighth.
const SMALL: (usize, usize) = (WIDTH / 8, HEIGHT / 8);

/// A map of an eighth of the size for two keyframes, `[2, height, width]`.
fn small(value: impl Fn(usize, usize) -> f64) -> Vec<u8> {
    let (width, height) = SMALL;
    let values = (0..2 * width * height).map(|at| value(at % width, at / width % height));
    npy("<f8", &[2, height, width], &values.collect::<Vec<f64>>())
}

/// The second keyframe with maps of an eighth, inverse depth and perhaps its variance.
fn keyframe(disps: Vec<u8>, variance: Option<Vec<u8>>) -> Keyframe {
    let mut arrays = with(members(&[0, 1]), "disps", disps);
    if let Some(variance) = variance {
        arrays = with(arrays, "disps_cov", variance);
    }
    let folder = folder(&arrays);
    import(&folder).expect("opens").load(1).expect("loads")
}

/// The place in a map of an eighth that a column of the picture looks at, `0` the first centre.
fn column_of_map(column: usize) -> f64 {
    let [fx, _, cx, _] = intrinsics();
    let (u, _) = Camera::<f64>::pixel_centre(column, 0);
    fx * (u - 24.0) / 40.0 + cx
}

#[test]
fn between_two_surfaces_there_is_nothing() {
    let found = keyframe(small(|x, _| if x < 3 { 1.0 } else { 0.5 }), None);
    let depth = found.depth.expect("depth");
    assert!(depth.data.iter().all(|&z| z == 1.0 || z == 2.0));
    assert_eq!((depth.at(0, 0, 5), depth.at(0, WIDTH - 1, 5)), (1.0, 2.0));
}

#[test]
fn variance_of_an_eighth_is_interpolated_as_that_of_inverse_depth() {
    let disps = small(|x, _| 0.5 + 0.01 * x as f64);
    let variance = small(|x, _| 1e-4 * (1.0 + x as f64));
    let found = keyframe(disps, Some(variance));
    let (depth, variance) = (found.depth.expect("depth"), found.variance.expect("variance"));
    for column in 0..WIDTH {
        let x = column_of_map(column);
        if !(0.0..=(SMALL.0 - 1) as f64).contains(&x) {
            continue;
        }
        let z = (0.5 + 0.01 * x).recip();
        let due = 1e-4 * (1.0 + x) * z.powi(4);
        assert!((f64::from(depth.at(0, column, 9)) / z - 1.0).abs() < 1e-6);
        assert!((f64::from(variance.at(0, column, 9)) / due - 1.0).abs() < 1e-6, "{column}");
    }
}

#[test]
fn numbers_out_of_single_precision_are_no_depth() {
    let count = 2 * WIDTH * HEIGHT;
    let mut disps = vec![0.5; count];
    // The depth of the first, and the variances of the next two, have no single precision.
    disps[0] = 1e-40;
    // Numbers that are no inverse depth.
    (disps[3], disps[4], disps[5]) = (f64::NAN, -1.0, f64::INFINITY);
    let mut variance = vec![1e-4; count];
    (variance[1], variance[2]) = (1e60, 1e-60);
    let arrays = with(members(&[0, 1]), "disps", npy("<f8", &[2, HEIGHT, WIDTH], &disps));
    let arrays = with(arrays, "disps_cov", npy("<f8", &[2, HEIGHT, WIDTH], &variance));
    let folder = folder(&arrays);
    let found = import(&folder).expect("opens").load(0).expect("loads");
    let (depth, variance) = (found.depth.expect("depth"), found.variance.expect("variance"));
    assert_eq!((&depth.data[..6], &variance.data[..6]), (&[0.0; 6][..], &[0.0; 6][..]));
    assert!(depth.data[7..].iter().all(|&z| z == 2.0));
}

#[test]
fn beyond_the_recorded_picture_there_is_no_depth() {
    let pictures = sequence(2);
    let camera = r#"{"fx":40,"fy":40,"cx":24,"cy":16,"pixel_centre":0.5,
        "distortion":[0.3,0,0,0]}"#;
    pictures.write("camera.json", camera);
    let arrays = folder(&members(&[0, 1]));
    let files = import_with(&arrays.0, &pictures).expect("opens");
    let valid_mask =
        files.sequence().and_then(|sequence| sequence.valid_mask.clone()).expect("edges");
    assert!(!valid_mask.data[0] && valid_mask.data[16 * WIDTH + 24]);
    let depth = files.load(1).expect("loads").depth.expect("depth");
    for (z, valid_mask) in depth.data.iter().zip(&valid_mask.data) {
        assert_eq!(*z > 0.0, *valid_mask);
    }
}

fn options(folder: &Folder) -> ImportOptions {
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

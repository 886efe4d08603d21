//! Depth and variance of maps, in the pixels of pictures.

use crate::arrays::npy;
use crate::droid::{folder, intrinsics, members, open, with};
use crate::scene::{HEIGHT, WIDTH, sequence};
use i2slam_dataset::import::{ImportOptions, ImportedKeyframes, Keyframe};
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
    open(&folder).expect("opens").load(1).expect("loads")
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
    let mut variance = vec![1e-4; count];
    (variance[1], variance[2]) = (1e60, 1e-60);
    let arrays = with(members(&[0, 1]), "disps", npy("<f8", &[2, HEIGHT, WIDTH], &disps));
    let arrays = with(arrays, "disps_cov", npy("<f8", &[2, HEIGHT, WIDTH], &variance));
    let folder = folder(&arrays);
    let found = open(&folder).expect("opens").load(0).expect("loads");
    let (depth, variance) = (found.depth.expect("depth"), found.variance.expect("variance"));
    assert_eq!((&depth.data[..3], &variance.data[..3]), (&[0.0; 3][..], &[0.0; 3][..]));
    assert!(depth.data[4..].iter().all(|&z| z == 2.0));
}

#[test]
fn beyond_the_recorded_picture_there_is_no_depth() {
    let pictures = sequence(2);
    let camera = r#"{"fx":40,"fy":40,"cx":24,"cy":16,"pixel_centre":0.5,
        "distortion":[0.3,0,0,0]}"#;
    pictures.write("camera.json", camera);
    let arrays = folder(&members(&[0, 1]));
    let files = ImportedKeyframes::open(&arrays.0, Some(&pictures.0), &ImportOptions::default())
        .expect("opens");
    let valid_mask =
        files.sequence().and_then(|sequence| sequence.valid_mask.clone()).expect("edges");
    assert!(!valid_mask.data[0] && valid_mask.data[16 * WIDTH + 24]);
    let depth = files.load(1).expect("loads").depth.expect("depth");
    for (z, valid_mask) in depth.data.iter().zip(&valid_mask.data) {
        assert_eq!(*z > 0.0, *valid_mask);
    }
}

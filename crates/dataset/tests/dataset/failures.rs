//! Errors and warnings name file, line or frame, and what was expected.

use crate::support::{
    Folder, HEIGHT, WIDTH, assert_says, assert_warns, depth_png, jpeg, open, png, rgb_png,
};
use i2slam_dataset::{DatasetError, OpenOptions, Sequence};
use std::path::Path;

#[test]
fn missing_folder() {
    let result = Sequence::open(Path::new("/no/such/folder"), &OpenOptions::default());
    assert_says(result, &["no file or folder /no/such/folder", "rgb.txt"]);
}

#[test]
fn empty_and_foreign_folders() {
    let folder = Folder::new();
    assert_says(open(&folder), &["no RGB-D sequence", "an empty folder"]);
    folder.write("notes.md", "");
    assert_says(open(&folder), &["found notes.md", "depth"]);
}

#[test]
fn empty_list_and_empty_image_folder() {
    let folder = Folder::tum(1);
    folder.write("depth.txt", "# nothing\n");
    assert_says(open(&folder), &["depth.txt is empty", "time stamp"]);
    let folder = Folder::new();
    folder.write("colour/readme.txt", "");
    folder.write("depth/000.png", "");
    assert_says(open(&folder), &["colour is empty", "PNG"]);
}

#[test]
fn no_camera() {
    let folder = Folder::tum(1);
    std::fs::remove_file(folder.join("camera.json")).expect("removes");
    assert_says(open(&folder), &["no camera", "camera.json", "fx"]);
}

#[test]
fn unusable_cameras() {
    let folder = Folder::tum(1);
    for (text, parts) in [
        ("{", &["camera.json", "expected JSON"][..]),
        (r#"{"fx":1,"fy":1,"cx":1}"#, &["missing field `cy`"][..]),
        (r#"{"fx":-1,"fy":1,"cx":1,"cy":1}"#, &["fx is -1", "positive"][..]),
        (r#"{"fx":1,"fy":1,"cx":1,"cy":1,"distortion":[1,2]}"#, &["k1 k2 p1 p2"][..]),
        (r#"{"fx":1,"fy":1,"cx":1,"cy":1,"pixel_centre":1}"#, &["0 or 0.5"][..]),
        (r#"{"fx":1,"fy":1,"cx":1,"cy":1,"width":5}"#, &["both width and height"][..]),
        (
            r#"{"fx":1,"fy":1,"cx":1,"cy":1,"distortion_model":"fisheye"}"#,
            &["'fisheye' is not supported"][..],
        ),
    ] {
        folder.write("camera.json", text);
        assert_says(open(&folder), parts);
    }
}

#[test]
fn cut_off_images_are_errors_of_their_frame() {
    let folder = Folder::tum(4);
    let noise: Vec<u8> = (0..3 * WIDTH * HEIGHT).map(|i| (i * i * 31 % 251) as u8).collect();
    let jpeg = jpeg(WIDTH, HEIGHT, &noise);
    let colour = std::fs::read(folder.join("rgb/001.png")).expect("reads");
    let depth = std::fs::read(folder.join("depth/003.png")).expect("reads");
    folder.write("rgb/001.png", &colour[..colour.len() - 20]);
    folder.write("rgb/002.png", &jpeg[..jpeg.len() - 30]);
    folder.write("depth/003.png", &depth[..depth.len() - 20]);
    let sequence = open(&folder).expect("opens");
    let frames: Vec<_> = sequence.stream().collect();
    assert_eq!(frames.iter().filter(|f| f.is_ok()).count(), 1);
    for (frame, (name, kind)) in frames.into_iter().skip(1).zip([
        ("rgb/001.png", "PNG"),
        ("rgb/002.png", "JPEG"),
        ("depth/003.png", "PNG"),
    ]) {
        assert!(frame.as_ref().is_err_and(DatasetError::concerns_one_frame));
        assert_says(frame, &[name, "cut-off", kind]);
    }
}

#[test]
fn files_that_are_no_images_or_missing() {
    let folder = Folder::tum(3);
    folder.write("rgb/000.png", "GIF89a");
    folder.write("rgb/001.png", "");
    std::fs::remove_file(folder.join("depth/002.png")).expect("removes");
    let sequence = open(&folder).expect("opens by the first readable frame");
    assert_says(sequence.load(0), &["000.png", "neither PNG nor JPEG"]);
    assert_says(sequence.load(1), &["001.png", "empty"]);
    assert_says(sequence.load(2), &["cannot read", "002.png"]);
    assert_says(sequence.load(3), &["frame 3", "3 frames"]);
}

#[test]
fn depth_of_a_wrong_kind() {
    let folder = Folder::tum(1);
    folder.write("depth/000.png", rgb_png(WIDTH, HEIGHT, 7));
    let sequence = open(&folder).expect("opens");
    assert_says(sequence.load(0), &["depth is Rgb of 8 bits", "16-bit grey PNG"]);
}

#[test]
fn sizes_that_differ() {
    let folder = Folder::tum(3);
    folder.write("rgb/001.png", rgb_png(WIDTH, HEIGHT + 1, 7));
    folder.write("depth/002.png", depth_png(WIDTH / 2, HEIGHT, 7));
    let sequence = open(&folder).expect("opens");
    assert_says(sequence.load(1), &["001.png is 16x13", "expected 16x12"]);
    assert_says(sequence.load(2), &["002.png is 8x12", "expected 16x12"]);
}

#[test]
fn frames_without_a_depth_partner() {
    let folder = Folder::tum(3);
    folder.write("depth.txt", "0.01 depth/000.png\n0.15 depth/002.png\n");
    let sequence = open(&folder).expect("opens");
    assert_eq!(sequence.dropped.without_depth, 0);
    folder.write("depth.txt", "-0.02 depth/000.png\n");
    let sequence = open(&folder).expect("opens");
    assert_eq!((sequence.len(), sequence.dropped.without_depth), (2, 1));
    assert_warns(&sequence.warnings, &["1 colour image left out"]);
    folder.write("depth.txt", "3.066667 depth/000.png\n");
    assert_says(open(&folder), &["none of 3", "0.08 s", "3.000 s away"]);
}

#[test]
fn plain_folders_without_common_names() {
    let folder = Folder::new();
    for name in ["colour/a.png", "colour/b.png", "depth/c.png"] {
        folder.write(name, "");
    }
    assert_says(open(&folder), &["2 colour and 1 depth", "same number"]);
}

#[test]
fn nan_in_a_list() {
    let folder = Folder::tum(2);
    folder.write("rgb.txt", "# c\n0.0 rgb/000.png\nNaN rgb/001.png\n");
    assert_says(open(&folder), &["rgb.txt, line 3", "NaN"]);
    folder.write("rgb.txt", "0.0\n");
    assert_says(open(&folder), &["rgb.txt, line 1", "a time stamp and a file name"]);
}

#[test]
fn options_outside_their_range() {
    let folder = Folder::tum(2);
    let good = OpenOptions::default();
    for (options, part) in [
        (OpenOptions { stride: 0, ..good.clone() }, "stride"),
        (OpenOptions { scale: 0.0, ..good.clone() }, "scale"),
        (OpenOptions { scale: f64::NAN, ..good.clone() }, "scale"),
        (OpenOptions { depth_scale: Some(-1.0), ..good.clone() }, "depth_scale"),
        (OpenOptions { max_depth: Some(f64::NAN), ..good.clone() }, "max_depth"),
        (OpenOptions { intrinsics: Some([1.0, f64::NAN, 0.0, 0.0]), ..good.clone() }, "intrinsics"),
        (OpenOptions { association_tolerance: 0.0, ..good.clone() }, "association_tolerance"),
        (OpenOptions { minimum_gap: -1.0, ..good.clone() }, "minimum_gap"),
        (OpenOptions { frames: Some(2..5), ..good.clone() }, "holds no frame"),
        (OpenOptions { crop_border: 5, ..good.clone() }, "crop_border"),
    ] {
        assert_says(Sequence::open(&folder.0, &options), &["option", part]);
    }
}

#[test]
fn odd_frames_carry_warnings() {
    let folder = Folder::tum(3);
    folder.write("depth/000.png", depth_png(WIDTH, HEIGHT, 0));
    folder.write("rgb/001.png", rgb_png(WIDTH, HEIGHT, 0));
    let n = WIDTH * HEIGHT;
    let (rgb, eight) = (png::ColorType::Rgb, png::BitDepth::Eight);
    folder.write("rgb/002.png", png((WIDTH, HEIGHT), rgb, eight, None, &vec![255; 3 * n]));
    let sequence = open(&folder).expect("opens");
    for (i, part) in ["no pixel has a valid depth", "black", "white"].iter().enumerate() {
        let warnings = sequence.load(i).expect("loads").warnings;
        assert_eq!(warnings.len(), 1);
        assert!(warnings[0].contains(part), "{warnings:?}");
    }
}

#[test]
fn a_wrong_depth_scale_is_noticed() {
    let folder = Folder::tum(3);
    let options = OpenOptions { depth_scale: Some(1.0), ..OpenOptions::default() };
    let sequence = Sequence::open(&folder.0, &options).expect("opens");
    assert_warns(&sequence.warnings, &["wrong depth scale?"]);
}

#[test]
fn unusable_ground_truth_is_left_aside() {
    let folder = Folder::tum(3);
    folder.write("groundtruth.txt", "0 0 0 0 0 0 0 0\n");
    let sequence = open(&folder).expect("opens");
    assert_eq!(sequence.len(), 3);
    assert_warns(&sequence.warnings, &["groundtruth.txt, line 1"]);
    folder.write("groundtruth.txt", "900 0 0 0 0 0 0 1\n");
    let sequence = open(&folder).expect("opens");
    assert_eq!(sequence.len(), 3);
    assert_warns(&sequence.warnings, &["ground truth ignored"]);
    folder.write("groundtruth.txt", "0 0 0 0 0 0 0 1\n");
    folder.write("rgb.txt", "0.0 rgb/000.png\n0.05 rgb/001.png\n0.1 rgb/002.png\n");
    let sequence = open(&folder).expect("opens");
    assert_eq!((sequence.len(), sequence.dropped.without_pose), (2, 1));
}

//! Errors and warnings name file, line or frame, and what was expected.

use crate::support::{
    Folder, HEIGHT, WIDTH, assert_says, assert_warns, depth_png, jpeg, jpeg_header, open, png,
    png_header, rgb_png,
};
use i2slam_dataset::{DepthPairing, Layout, OpenOptions, Sequence};
use std::path::Path;

#[test]
fn missing_empty_and_foreign_folders() {
    let missing = Sequence::open(Path::new("/no/such/folder"), &OpenOptions::default());
    assert_says(missing, &["no file or folder /no/such/folder", "rgb.txt"]);
    let folder = Folder::new();
    assert_says(open(&folder), &["no RGB-D sequence", "an empty folder"]);
    folder.write("notes.md", "");
    let message = open(&folder).expect_err("no sequence").to_string();
    assert!(message.contains("found notes.md"), "{message}");
    for layout in Layout::ALL {
        assert!(message.contains(layout.name()) && message.contains(layout.recognised_by()));
    }
    folder.write("colour/readme.txt", "");
    folder.write("depth/c.png", "");
    assert_says(open(&folder), &["colour is empty", "PNG"]);
    for name in ["colour/a.png", "colour/b.png"] {
        folder.write(name, "");
    }
    assert_says(open(&folder), &["2 colour and 1 depth", "same number"]);
}

#[test]
fn unusable_files_are_named() {
    let camera = |more: &str| format!(r#"{{"fx":1,"fy":1,"cx":1,"cy":1,{more}}}"#);
    for (name, text, parts) in [
        ("camera.json", "{".into(), &["camera.json", "expected JSON"][..]),
        ("camera.json", r#"{"fx":1,"fy":1,"cx":1}"#.into(), &["missing field `cy`"]),
        ("camera.json", r#"{"fps":24}"#.into(), &["camera.json", "has no fx, fy, cx, cy"]),
        ("camera.json", r#"{"fx":-1,"fy":1,"cx":1,"cy":1}"#.into(), &["fx is -1", "positive"]),
        ("camera.json", camera(r#""fps":"24""#), &["fps: invalid type: string \"24\"", "line 1"]),
        ("camera.json", camera(r#""distortion":[0,"a"]"#), &["distortion[1]: invalid type"]),
        ("camera.json", camera(r#""distortion":[1,2]"#), &["k1 k2 p1 p2"]),
        ("camera.json", camera(r#""pixel_centre":1"#), &["0 or 0.5"]),
        ("camera.json", camera(r#""width":5"#), &["both width and height"]),
        ("camera.json", camera(r#""distortion_model":"fisheye""#), &["'fisheye' is not supported"]),
        ("calibration.txt", String::new(), &["calibration.txt", "is empty"]),
        ("calibration.txt", "1 2 3".into(), &["calibration.txt", "3 numbers"]),
        ("calibration.txt", "1 2 3 x".into(), &["calibration.txt", "cy is 'x'"]),
        ("calibration.txt", "0 1 2 3".into(), &["calibration.txt", "positive"]),
        ("depth.txt", "# nothing\n".into(), &["depth.txt is empty", "time stamp"]),
        ("depth.txt", "3.05 depth/000.png\n".into(), &["none of 2", "0.08 s", "3.017 s away"]),
        (
            "depth.txt",
            "0.0 elsewhere/0.png\n0.1 elsewhere/1.png\n".into(),
            &["depth.txt: none of the 2 files that it names is there", "elsewhere/0.png"],
        ),
        ("rgb.txt", "# c\n0.0 a.png\nNaN b.png\n".into(), &["rgb.txt, line 3", "NaN"]),
        ("rgb.txt", "0.0\n".into(), &["rgb.txt, line 1", "a time stamp and a file name"]),
    ] {
        let folder = Folder::tum(2);
        if name == "calibration.txt" {
            std::fs::remove_file(folder.join("camera.json")).expect("removes");
            assert_says(open(&folder), &["no camera", "camera.json", "fx"]);
        }
        folder.write(name, text);
        assert_says(open(&folder), parts);
    }
}

/// Colour and depth folders without a camera, where another layout's files cannot be used.
#[test]
fn a_missing_camera_is_told_with_its_cause() {
    let folder = || {
        let folder = Folder::new();
        for i in 0..2 {
            folder.write(&format!("rgb/{i}.png"), rgb_png(WIDTH, HEIGHT, 9));
            folder.write(&format!("depth/{i}.png"), depth_png(WIDTH, HEIGHT, 5500));
        }
        folder
    };
    assert_says(open(&folder()), &["no camera for", ": put a camera.json there"]);
    let nested = format!("{{\"x\":{}{}}}", "[".repeat(500), "]".repeat(500));
    for (name, text, parts) in [
        ("transforms.json", "{}", &["no camera", "transforms.json", "missing field `frames`"][..]),
        ("transforms.json", &nested, &["no camera", "transforms.json", "recursion limit"]),
        ("transforms.json", r#"{"frames":[]}"#, &["no camera", "transforms.json is empty"]),
        ("camera.json", &nested, &["camera.json", "expected JSON"]),
        ("calibration.txt", "1 1 1 1", &["calibration.txt is there without rgb.txt and depth.txt"]),
    ] {
        let folder = folder();
        folder.write(name, text);
        assert_says(open(&folder), parts);
    }
    let eth3d = folder();
    eth3d.write("calibration.txt", "14 14 7.5 5.5");
    eth3d.write("depth.txt", "0.0 depth/0.png\n0.1 depth/1.png\n");
    let missing = "depth.txt and calibration.txt is there without rgb.txt, which";
    assert_says(open(&eth3d), &["no camera", missing]);
    eth3d.write("rgb.txt", "0.0 rgb/0.png\n0.1 rgb/1.png\n");
    assert_eq!(open(&eth3d).expect("ETH3D").layout, Layout::Eth3d);
}

#[test]
#[cfg(unix)]
fn links_to_nothing_are_named() {
    for name in ["camera.json", "transforms.json", "rgb.txt", "depth.txt", "calibration.txt"] {
        let folder = Folder::tum(2);
        for file in ["camera.json", name] {
            std::fs::remove_file(folder.join(file)).ok();
        }
        std::os::unix::fs::symlink("/no/such/file", folder.join(name)).expect("a link");
        assert_says(open(&folder), &["cannot read", name, "/no/such/file"]);
    }
}

#[test]
fn unusable_images_are_errors_of_their_frame() {
    let folder = Folder::tum(2);
    let noise: Vec<u8> = (0..3 * WIDTH * HEIGHT).map(|i| (i * i * 31 % 251) as u8).collect();
    let jpeg = jpeg(WIDTH, HEIGHT, &noise);
    let (colour, depth) = (rgb_png(WIDTH, HEIGHT, 61), depth_png(WIDTH, HEIGHT, 5500));
    let high = rgb_png(WIDTH, HEIGHT + 1, 7);
    let narrow = depth_png(WIDTH / 2, HEIGHT, 7);
    let claims = png_header(32000, 32000);
    for (name, bytes, parts) in [
        ("rgb/001.png", &colour[..colour.len() - 20], &["cut-off", "PNG"][..]),
        ("rgb/001.png", &jpeg[..jpeg.len() - 30], &["cut-off", "JPEG"]),
        ("rgb/001.png", b"GIF89a", &["neither PNG nor JPEG"]),
        ("rgb/001.png", b"", &["empty"]),
        ("rgb/001.png", &high, &["is 16x13", "expected 16x12", "the other colour images"]),
        ("rgb/001.png", &claims, &["is 32000x32000", "expected 16x12"]),
        ("rgb/001.png", &jpeg_header(jpeg.clone(), 65000, 65000), &["is 65000x65000"]),
        ("depth/001.png", &claims, &["is 32000x32000", "expected 16x12"]),
        ("depth/001.png", &depth[..depth.len() - 20], &["cut-off", "PNG"]),
        ("depth/001.png", &colour, &["depth is Rgb of 8 bits", "16-bit grey PNG"]),
        ("depth/001.png", &narrow, &["is 8x12", "expected 16x12"]),
    ] {
        let whole = std::fs::read(folder.join(name)).expect("reads");
        folder.write(name, bytes);
        let frames: Vec<_> = open(&folder).expect("opens").stream().collect();
        let [Ok(_), Err(error)] = &frames[..] else { panic!("{name} {parts:?}") };
        assert!(error.concerns_one_frame(), "{error}");
        let message = error.to_string();
        assert!([name].iter().chain(parts).all(|part| message.contains(part)), "{message}");
        folder.write(name, whole);
    }
    std::fs::remove_file(folder.join("depth/001.png")).expect("removes");
    let sequence = open(&folder).expect("opens");
    assert_says(sequence.load(1), &["cannot read", "001.png"]);
    assert_says(sequence.load(2), &["frame 2", "2 frames"]);
    // The size of the frames is that of the first readable one.
    folder.write("rgb/000.png", "GIF89a");
    assert!(open(&folder).is_ok());
}

#[test]
fn frames_without_a_depth_partner() {
    let folder = Folder::tum(3);
    let counts = |options: &OpenOptions| {
        let sequence = Sequence::open(&folder.0, options).expect("opens");
        let frames = (sequence.len(), sequence.dropped.without_depth);
        let depths: Vec<bool> =
            (0..sequence.len()).map(|i| sequence.load(i).expect("loads").depth.is_some()).collect();
        (frames, depths, sequence.warnings.join("; "))
    };
    let one_to_one = OpenOptions::default();
    let nearest = OpenOptions { depth_pairing: DepthPairing::Nearest, ..one_to_one.clone() };
    let alone = OpenOptions { colour_only: true, ..one_to_one.clone() };
    folder.write("depth.txt", "0.01 depth/000.png\n0.15 depth/002.png\n");
    assert_eq!(counts(&nearest), ((3, 0), vec![true; 3], String::new()));
    folder.write("depth.txt", "-0.02 depth/000.png\n");
    let (frames, depths, warnings) = counts(&nearest);
    assert_eq!((frames, depths), ((2, 1), vec![true; 2]));
    assert!(warnings.contains("1 colour image left out"), "{warnings}");
    let (frames, depths, warnings) = counts(&one_to_one);
    assert_eq!((frames, depths), ((3, 0), vec![true, false, false]));
    assert!(warnings.contains("1 of 3 frames have a depth image"), "{warnings}");
    assert_eq!(counts(&alone), ((3, 0), vec![false; 3], String::new()));
    // Another clock matters only where depth is asked for.
    folder.write("depth.txt", "-5 depth/000.png\n");
    assert_says(Sequence::open(&folder.0, &one_to_one), &["within 0.08 s", "5.000 s away"]);
    assert_eq!(counts(&alone).0, (3, 0));
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
fn wrong_scales_and_intrinsics_are_noticed() {
    let folder = Folder::tum(3);
    let options = OpenOptions { depth_scale: Some(1.0), ..OpenOptions::default() };
    let sequence = Sequence::open(&folder.0, &options).expect("opens");
    assert_warns(&sequence.warnings, &["wrong depth scale?"]);
    folder.write("camera.json", r#"{"fx":28,"fy":28,"cx":15.5,"cy":11.5}"#);
    assert_warns(&open(&folder).expect("opens").warnings, &["intrinsics of another size?"]);
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

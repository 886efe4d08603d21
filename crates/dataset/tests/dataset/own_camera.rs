//! Images without a dataset: EXIF data, fields of view, camera files of other programs.

use crate::support::{CAMERA, Folder, assert_says, assert_warns, jpeg};
use i2slam_dataset::{DatasetError, OpenOptions, Sequence};
use i2slam_geometry::Camera;
use i2slam_storage::{Claim, OutputFolder};
use jpeg_encoder::{ColorType, Encoder};
use std::fs;

/// EXIF data with one number of 16 bits, little-endian.
fn exif(tag: u16, value: u16) -> Vec<u8> {
    let entry = |tag: u16, kind: u16, value: u32| {
        [&tag.to_le_bytes()[..], &kind.to_le_bytes(), &1_u32.to_le_bytes(), &value.to_le_bytes()]
            .concat()
    };
    let directory = |entry: Vec<u8>| [&1_u16.to_le_bytes()[..], &entry, &[0; 4]].concat();
    // The first directory is 18 bytes long and points to that of the camera behind it.
    let first = directory(entry(0x8769, 4, 8 + 18));
    let camera = directory(entry(tag, 3, value.into()));
    [&b"Exif\0\0II*\0\x08\0\0\0"[..], &first, &camera].concat()
}

/// A folder of pictures alone; those with `segment` carry it.
fn pictures(segment: Option<Vec<u8>>) -> Folder {
    pictures_with(&[segment.clone(), segment.clone(), segment])
}

/// A folder of images, each with a segment of its own.
fn pictures_with(segments: &[Option<Vec<u8>>]) -> Folder {
    let folder = Folder::new();
    for (i, segment) in segments.iter().enumerate() {
        let bytes = picture(segment.as_ref(), &[120; 3 * 64 * 48]);
        folder.write(&format!("IMG_{i:04}.jpg"), bytes);
    }
    folder
}

/// A JPEG of 64x48 px with a segment of EXIF data.
fn picture(segment: Option<&Vec<u8>>, pixels: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, 95);
    if let Some(segment) = segment {
        encoder.add_app_segment(1, segment.clone()).expect("room for it");
    }
    encoder.encode(pixels, 64, 48, ColorType::Rgb).expect("a picture");
    bytes
}

fn alone() -> OpenOptions {
    OpenOptions { colour_only: true, guess_camera: true, ..OpenOptions::default() }
}

fn open(folder: &Folder, options: &OpenOptions) -> Sequence {
    Sequence::open(&folder.0, options).expect("opens")
}

#[track_caller]
fn close(found: f64, due: f64) {
    assert!((found - due).abs() < 1e-3 * due, "{found}, not {due}");
}

#[test]
fn a_camera_file_may_give_the_frame_rate_alone() {
    let folder = pictures(None);
    assert!(open(&folder, &alone()).are_times_assumed);
    folder.write("camera.json", r#"{"fps": 24}"#);
    let sequence = open(&folder, &alone());
    assert!(sequence.camera_is_guess && !sequence.are_times_assumed);
    close(sequence.frame_rate, 24.0);
    close(sequence.camera.fx, 32.0 / 30.0_f64.to_radians().tan());
    // Of a camera under other names nothing is guessed.
    folder.write("camera.json", r#"{"fps": 24, "fl_x": 50}"#);
    assert_says(Sequence::open(&folder.0, &alone()), &["camera.json", "missing field `fx`"]);
}

#[test]
fn misspelt_keys_of_a_camera_file_are_told() {
    let folder = Folder::tum(2);
    for (key, known) in
        [("depthscale", "depth_scale"), ("FPS", "fps"), ("pixel-center", "pixel_centre")]
    {
        let camera = r#"{"fx": 14, "fy": 14, "cx": 7.5, "cy": 5.5, "remark": 1, "KEY": 1}"#;
        folder.write("camera.json", camera.replace("KEY", key));
        let told = [format!("unknown key '{key}'"), format!("did you mean '{known}'")];
        assert_says(
            Sequence::open(&folder.0, &OpenOptions::default()),
            &[told[0].as_str(), told[1].as_str()],
        );
    }
    let both = r#"{"fx": 14, "fy": 14, "cx": 7.5, "cy": 5.5, "depth_scale": 500, "depthScale": 1}"#;
    folder.write("camera.json", both);
    close(open(&folder, &OpenOptions::default()).depth_scale, 500.0);
}

#[test]
fn a_scale_of_depth_that_nothing_gives_is_told() {
    let folder = Folder::new();
    (0..2).for_each(|i| folder.frame("colour", "depth", &format!("{i}"), i));
    folder.write("camera.json", CAMERA);
    let plain = OpenOptions::default();
    assert_warns(&open(&folder, &plain).warnings, &["depth scale is not given: 5000"]);
    let is_silent = |options: &OpenOptions| {
        let warnings = open(&folder, options).warnings;
        !warnings.iter().any(|warning| warning.contains("depth scale"))
    };
    assert!(is_silent(&OpenOptions { depth_scale: Some(5000.0), ..plain.clone() }));
    assert!(is_silent(&OpenOptions { colour_only: true, ..plain.clone() }));
    folder.write("camera.json", CAMERA.replace('}', r#","depth_scale":5000}"#));
    assert!(is_silent(&plain));
    // A lens by the user leaves what else the file says.
    folder.write("camera.json", CAMERA.replace('}', r#","depth_scale":1000,"fps":24}"#));
    let sequence =
        open(&folder, &OpenOptions { intrinsics: Some([9.0, 9.0, 7.5, 5.5]), ..plain.clone() });
    assert_eq!(
        (sequence.camera.fx, sequence.depth_scale, sequence.frame_rate),
        (9.0, 1000.0, 24.0)
    );
    let folder = Folder::tum(2);
    assert!(!open(&folder, &plain).warnings.iter().any(|w| w.contains("depth scale")));
}

#[test]
fn a_frame_rate_leaves_the_camera_that_a_layout_knows() {
    let folder = Folder::tum(2);
    folder.write("camera.json", r#"{"fps": 24, "depth_scale": 1000}"#);
    folder.write("calibration.txt", "14 14 7.5 5.5");
    let sequence = open(&folder, &OpenOptions::default());
    close(sequence.camera.fx, 14.0);
    close(sequence.depth_scale, 1000.0);
    assert!(!sequence.camera_is_guess);
}

#[test]
fn a_result_beside_pictures_does_not_give_their_camera() {
    let folder = pictures(None);
    let camera = r#"{"fx": 50, "fy": 50, "cx": 32, "cy": 24}"#;
    folder.write("camera.json", camera);
    assert!(!open(&folder, &alone()).camera_is_guess);
    fs::remove_file(folder.join("camera.json")).expect("removes");
    let claim = Claim { command: "i2slam run", names: &["camera.json"], overwrite: true };
    let mut out = OutputFolder::replace(&folder.0, claim).expect("a folder");
    out.write("camera.json", |file| file.write_all(camera.as_bytes())).expect("room");
    out.commit().expect("room");
    assert!(open(&folder, &alone()).camera_is_guess);
}

#[test]
fn the_focal_length_comes_from_exif_data() {
    // 26 mm on film with a diagonal of 43.27 mm; 80 px across the diagonal here.
    let sequence = open(&pictures(Some(exif(0xa405, 26))), &alone());
    close(sequence.camera.fx, 26.0 / 43.2666 * 80.0);
    assert!(sequence.camera_is_guess && sequence.camera_source.contains("26 mm"));
    // Nothing about the lens, an impossible one, no EXIF data at all: 60 degrees.
    for segment in [Some(exif(0xa402, 1)), Some(exif(0xa405, 0)), Some(b"Exif\0\0?".to_vec()), None]
    {
        let sequence = open(&pictures(segment), &alone());
        close(sequence.camera.fx, 32.0 / 30.0_f64.to_radians().tan());
        assert!(sequence.camera_is_guess && sequence.camera_source.contains("a guess"));
    }
}

#[test]
fn photographs_in_other_formats_are_told() {
    let folder = pictures(None);
    assert!(!open(&folder, &alone()).warnings.iter().any(|w| w.contains("left out")));
    for name in ["IMG_0007.HEIC", "IMG_0003.dng", "IMG_0001.dng", "notes.txt", "._IMG_9.heic"] {
        folder.write(name, b"...");
    }
    // The first picture is there as JPEG, too.
    let warnings = open(&folder, &alone()).warnings;
    assert_warns(&warnings, &["left out 2 photographs", "IMG_0003.dng", "JPEG or PNG"]);
    let folder = Folder::new();
    folder.write("IMG_0007.HEIC", b"...");
    let due = ["1 photograph in a format that is not read", "IMG_0007.HEIC", "JPEG or PNG"];
    assert_says(Sequence::open(&folder.0, &alone()), &due);
}

#[test]
fn a_guess_must_be_asked_for() {
    let folder = pictures(None);
    let options = OpenOptions { guess_camera: false, ..alone() };
    assert!(matches!(Sequence::open(&folder.0, &options), Err(DatasetError::NoCamera { .. })));
    assert_says(Sequence::open(&folder.0, &OpenOptions::default()), &["by colour alone (--rgb)"]);
}

#[test]
fn a_field_of_view_that_is_given_counts() {
    let folder = pictures(Some(exif(0xa405, 26)));
    let options = OpenOptions { field_of_view: Some(90.0), ..alone() };
    let sequence = open(&folder, &options);
    close(sequence.camera.fx, 32.0);
    close(sequence.camera.cy, 24.0);
    assert!(!sequence.camera_is_guess);
    let options = OpenOptions { field_of_view: Some(180.0), ..alone() };
    assert!(matches!(Sequence::open(&folder.0, &options), Err(DatasetError::Option { .. })));
}

#[test]
fn large_pictures_are_made_smaller_where_that_is_asked_for() {
    let options = OpenOptions { max_side: Some(16), ..alone() };
    let folder = pictures(None);
    let sequence = open(&folder, &options);
    assert_eq!((sequence.camera.width, sequence.camera.height), (16, 12));
    assert_eq!(sequence.recorded_size, (64, 48));
    let picture = sequence.load(0).expect("a picture").colour;
    assert_eq!((picture.width, picture.height), (16, 12));
    let options = OpenOptions { max_side: Some(100), ..alone() };
    assert_eq!(open(&pictures(None), &options).camera.width, 64);
}

#[test]
fn pictures_may_lie_in_a_folder_of_a_known_name() {
    let folder = Folder::new();
    for i in 0..3 {
        folder.write(&format!("images/frame{i}.jpg"), picture(None, &[120; 3 * 64 * 48]));
    }
    let sequence = open(&folder, &alone());
    assert!(sequence.len() == 3 && sequence.entries[2].depth.is_none());
    assert_eq!(sequence.entries[2].timestamp, 2.0 / 30.0);
}

#[test]
fn cameras_are_read_from_files_of_many_kinds() {
    let folder = pictures(None);
    // Pixel centres at one half: fx 50, fy 51, cx 32, cy 24.
    for (name, text) in [
        ("a.json", r#"{"fx":50,"fy":51,"cx":31.5,"cy":23.5}"#),
        (
            "transforms.json",
            r#"{"fl_x":50,"fl_y":51,"cx":32,"cy":24,"w":64,"h":48,"frames":[{"file_path":"a.png"}]}"#,
        ),
        ("cameras.txt", "# list\n1 PINHOLE 64 48 50 51 32 24\n"),
        ("tum.txt", "50 51 31.5 23.5\n"),
        ("csv.txt", "# fx fy cx cy k1 k2 p1 p2\n50, 51, 31.5, 23.5, 0, 0, 0, 0\n"),
    ] {
        // Beside the pictures a transforms.json would be a list of them.
        folder.write(&format!("cameras/{name}"), text);
        let camera = Some(folder.join(&format!("cameras/{name}")));
        let sequence = open(&folder, &OpenOptions { camera, ..alone() });
        let c = sequence.camera;
        assert_eq!([c.fx, c.fy, c.cx, c.cy], [50.0, 51.0, 32.0, 24.0], "{name}");
        assert!(!sequence.camera_is_guess && sequence.camera_source.contains(name));
    }
    for (text, part) in [
        ("50 51 31.5\n", "3 numbers"),
        ("50 51 31.5 x\n", "expected a camera.json"),
        ("-50 51 31.5 2\n", "positive"),
        ("", "is empty"),
        ("1 OPENCV_FISHEYE 64 48 50 51 32 24 0 0 0 0\n", "not supported"),
        ("1 PINHOLE 64 48 50 51 32 24\n2 PINHOLE 64 48 60 61 32 24\n", "2 cameras"),
    ] {
        folder.write("cameras/bad.txt", text);
        let camera = Some(folder.join("cameras/bad.txt"));
        let options = OpenOptions { camera, ..alone() };
        assert_says(Sequence::open(&folder.0, &options), &[part, "bad.txt"]);
    }
}

#[test]
fn a_lens_found_in_the_pictures_is_removed_from_them() {
    let folder = pictures(None);
    for i in 0..3 {
        let wave = |i: u32| (127.5 + 90.0 * (0.4 * f64::from(i)).sin()) as u8;
        let pixels: Vec<u8> = (0..48).flat_map(|y| (0..64).map(move |x| (x, y))).fold(
            Vec::new(),
            |mut bytes, (x, y)| {
                bytes.extend([wave(x + i), wave(y), wave(x + 2 * y)]);
                bytes
            },
        );
        folder.write(&format!("IMG_{i:04}.jpg"), jpeg(64, 48, &pixels));
    }
    for (scale, crop_border) in [(1.0, 0), (0.5, 4)] {
        let options = OpenOptions { scale, crop_border, ..alone() };
        let bent = open(&folder, &options);
        let found = Camera { fx: 1.1 * bent.camera.fx, fy: 1.1 * bent.camera.fy, ..bent.camera };
        // A cushion, which reaches beyond the recorded corners.
        let estimated = bent.estimated_camera(&found, [0.25, 0.02]);
        let straight = bent.with_estimated_camera(&estimated);
        close(straight.camera.fx, found.fx);
        assert!(!straight.camera_is_guess && (straight.warnings.len() == 1) == (scale == 1.0));
        let options = OpenOptions { estimated_camera: Some(estimated), ..options };
        let again = open(&folder, &options);
        assert_eq!((again.camera, &again.valid_mask), (straight.camera, &straight.valid_mask));
        let (one, other) = (straight.load(1).expect("reads"), again.load(1).expect("reads"));
        assert_eq!(one.colour, other.colour);
        assert_ne!(one.colour, bent.load(1).expect("reads").colour);
    }
}

/// EXIF data that ask for an orientation.
fn oriented(value: u16) -> Vec<u8> {
    let entry = [&[0x12, 1, 3, 0, 1, 0, 0, 0][..], &value.to_le_bytes(), &[0; 2]].concat();
    [&b"Exif\0\0II*\0\x08\0\0\0\x01\0"[..], &entry, &[0; 4]].concat()
}

#[test]
fn pictures_that_are_to_be_turned_bring_a_warning_where_they_are_not() {
    for (value, word) in [(6, "90 degrees"), (3, "180 degrees"), (5, "mirrored")] {
        let sequence = open(&pictures(Some(oriented(value))), &alone());
        assert_warns(&sequence.warnings, &[word, "as they are stored"]);
        assert_eq!(sequence.recorded_size, (64, 48));
    }
    assert!(open(&pictures(Some(oriented(1))), &alone()).warnings.is_empty());
}

#[test]
fn pictures_of_a_lens_that_zooms_are_refused() {
    let of = |millimetres: [Option<u16>; 3]| {
        let folder = pictures_with(&millimetres.map(|mm| mm.map(|mm| exif(0xa405, mm))));
        Sequence::open(&folder.0, &alone())
    };
    let parts = ["IMG_0002.jpg", "26 mm", "52 mm"];
    assert_says(of([Some(26), Some(26), Some(52)]), &[&["IMG_0000.jpg"], &parts[..]].concat());
    assert_says(of([None, Some(52), Some(26)]), &[&["IMG_0001.jpg"], &parts[..]].concat());
    // A picture that tells nothing may be of the same lens.
    assert!(of([Some(26), None, Some(26)]).is_ok());
}

/// A sensor does not turn in its camera: all are shown alike, and which picture asks for something
/// else is said. No camera sees both a room and its mirror image.
#[test]
fn pictures_that_ask_to_be_shown_otherwise_than_the_first_are_named() {
    let turning = OpenOptions { turn_pictures: true, ..alone() };
    let of = |ways: [u16; 4]| pictures_with(&ways.map(|way| Some(oriented(way))));
    for (ways, options, shown) in [
        ([1, 1, 6, 3], &turning, "all are left as they are alike"),
        ([6, 6, 1, 1], &turning, "all are turned by 90 degrees alike"),
        ([6, 6, 1, 1], &alone(), "all are left as they are alike"),
    ] {
        let folder = of(ways);
        let sequence = open(&folder, options);
        let parts = ["does not turn in its camera", "2 pictures", "IMG_0002.jpg", shown];
        assert_warns(&sequence.warnings, &parts);
        let sizes: Vec<_> = (0..4).map(|i| sequence.load(i).expect("reads").colour.width).collect();
        assert!(sizes.iter().all(|width| *width == sequence.camera.width), "{sizes:?}");
    }
    assert_says(Sequence::open(&of([1, 1, 1, 2]).0, &turning), &["IMG_0003.jpg", "mirrored"]);
}

#[test]
fn pictures_are_turned_as_they_ask_with_their_camera() {
    let folder = pictures(None);
    // Bright at the left, so that a quarter turn to the right puts it on top.
    let pixels: Vec<u8> =
        (0..48 * 64).flat_map(|i| [if i % 64 < 16 { 220 } else { 30 }; 3]).collect();
    for i in 0..3 {
        folder.write(&format!("IMG_{i:04}.jpg"), picture(Some(&oriented(6)), &pixels));
    }
    let turned = OpenOptions { turn_pictures: true, ..alone() };
    let sequence = open(&folder, &turned);
    assert_eq!((sequence.camera.width, sequence.camera.height), (48, 64));
    assert_warns(&sequence.warnings, &["pictures are turned by 90 degrees"]);
    // 60 degrees across the longer side, which is now the height.
    close(sequence.camera.fx, 32.0 / 30.0_f64.to_radians().tan());
    close(sequence.camera.cx, 24.0);
    let picture = sequence.load(1).expect("a picture").colour;
    let row = |r: usize| picture.plane(1)[r * 48..][..48].iter().sum::<f32>() / 48.0;
    assert!(row(4) > 0.7 && row(40) < 0.2, "{} {}", row(4), row(40));
    // Numbers with the size of the stored pictures are turned with them, others are not.
    for (text, due) in [
        (
            r#"{"width":64,"height":48,"fx":50,"fy":51,"cx":30.5,"cy":20.5}"#,
            [51.0, 50.0, 27.0, 31.0],
        ),
        (
            r#"{"width":48,"height":64,"fx":50,"fy":51,"cx":25.5,"cy":30.5}"#,
            [50.0, 51.0, 26.0, 31.0],
        ),
        (r#"{"fx":50,"fy":51,"cx":25.5,"cy":30.5}"#, [50.0, 51.0, 26.0, 31.0]),
    ] {
        folder.write("cameras/a.json", text);
        let camera = Some(folder.join("cameras/a.json"));
        let c = open(&folder, &OpenOptions { camera, ..turned.clone() }).camera;
        assert_eq!([c.fx, c.fy, c.cx, c.cy], due, "{text}");
    }
}

#[test]
fn the_same_frames_are_there_at_another_size() {
    let folder = pictures(None);
    let small = open(&folder, &OpenOptions { scale: 0.25, crop_border: 4, ..alone() });
    assert_eq!((small.camera.width, small.camera.height), (14, 10));
    for (side, width) in [(28, 28), (640, 56), (10, 14)] {
        let large = small.at_least(side);
        assert_eq!((large.camera.width, large.len()), (width, small.len()));
        let frame = large.load(2).expect("a picture");
        assert_eq!((frame.colour.width, frame.index), (width, 2));
        let again = large.camera.resized(small.camera.width, small.camera.height);
        close(again.fx, small.camera.fx);
        close(again.cy, small.camera.cy);
    }
    let all = open(&folder, &alone());
    assert_eq!(all.at_least(640).camera, all.camera);
}

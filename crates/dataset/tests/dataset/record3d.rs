//! Recordings of the app Record3D: 48x32 colour, 24x16 depth.

use super::support::{Folder, assert_says, assert_warns, jpeg, rgb_png, zip};
use i2slam_dataset::{DatasetError, Layout, OpenOptions, Sequence, is_without_depth};
use std::path::Path;

const METADATA: &str = r#"{"w": 48, "h": 32, "dw": 24, "dh": 16, "fps": 60,
 "K": [41.0, 0, 0, 0, 41.0, 0, 23.0, 15.0, 1],
 "perFrameIntrinsicCoeffs": [[40, 40, 23.5, 15.5], [39, 40, 23.5, 15.5], [44, 40, 23.5, 15.5]],
 "poses": [[0, 0, 0, 1, 0, 0, 0]], "frameTimestamps": [0.5, 0.6, 0.75]}"#;

/// Files of three frames: depth of the first two, 1.5 and 1.501 m, the left half of the second doubtful, and
/// nothing read at the pixel 20, 8 of the first.
fn files() -> Vec<(String, Vec<u8>)> {
    let mut all = vec![("metadata".to_owned(), METADATA.as_bytes().to_vec())];
    all.push(("icon".to_owned(), b"no picture".to_vec()));
    for i in 0..3_u8 {
        let colour: Vec<u8> = [90 + 10 * i; 3 * 48 * 32].into();
        all.push((format!("rgbd/{i}.jpg"), jpeg(48, 32, &colour)));
    }
    for i in 0..2 {
        let z = 1.5 + 0.001 * i as f32;
        let is_missing = |at: usize| i == 0 && at == 24 * 8 + 20;
        let depth = |at: usize| if is_missing(at) { f32::NAN } else { z }.to_le_bytes();
        let depth: Vec<u8> = (0..24 * 16).flat_map(depth).collect();
        all.push((format!("rgbd/{i}.depth"), compressed(&depth)));
        let confidence: Vec<u8> =
            (0..24 * 16).map(|at| if i == 1 && at % 24 < 12 { 0 } else { 2 }).collect();
        all.push((format!("rgbd/{i}.conf"), compressed(&confidence)));
    }
    all
}

fn compressed(bytes: &[u8]) -> Vec<u8> {
    let mut out = Vec::new();
    lzfse_rust::encode_bytes(bytes, &mut out).expect("compresses");
    out
}

fn open(path: &Path) -> Result<Sequence, DatasetError> {
    Sequence::open(path, &OpenOptions::default())
}

/// The recording as an archive with stored and with deflated members, alone in a folder, and unpacked.
fn recordings(folder: &Folder) -> [std::path::PathBuf; 4] {
    let files = files();
    for (name, bytes) in &files {
        folder.write(&format!("unpacked/{name}"), bytes);
    }
    folder.write("copied/shelf.R3D", zip(&files, false));
    [
        folder.write("stored.r3d", zip(&files, false)),
        folder.write("deflated.r3d", zip(&files, true)),
        folder.join("copied"),
        folder.join("unpacked"),
    ]
}

#[test]
fn depth_comes_on_the_grid_of_colour_without_what_is_doubtful() {
    let folder = Folder::new();
    for path in recordings(&folder) {
        let sequence = open(&path).expect("a recording");
        assert_eq!((sequence.layout, sequence.len()), (Layout::Record3d, 3));
        let camera = sequence.camera;
        assert_eq!((camera.width, camera.fx, camera.fy, camera.cx), (48, 40.0, 40.0, 24.0));
        assert_eq!(sequence.frames_with_depth(), 2);
        assert_warns(&sequence.warnings, &["2 of 3 frames have a depth image"]);
        let frames: Vec<_> = (0..3).map(|at| sequence.load(at).expect("a frame")).collect();
        let depth =
            |frame: usize, x: usize| frames[frame].depth_image().map(|d| d.data[48 * 16 + x]);
        assert_eq!([depth(0, 10), depth(0, 30), depth(0, 40)], [Some(1.5), Some(1.5), Some(0.0)]);
        assert_eq!([depth(1, 23), depth(1, 24), depth(2, 0)], [Some(0.0), Some(1.501), None]);
        assert_eq!([0, 1, 2].map(|at: usize| frames[at].timestamp), [0.5, 0.6, 0.75]);
        let shade = |at: usize| frames[at].colour.plane(1)[48 * 16 + 24];
        assert!((0..3).all(|at| (255.0 * shade(at) - 90.0 - 10.0 * at as f32).abs() < 3.0));
    }
}

#[test]
fn colour_alone_and_frames_without_times_are_read() {
    let folder = Folder::new();
    let mut files = files();
    files.retain(|(name, _)| !name.ends_with(".depth") && !name.ends_with(".conf"));
    let untimed = METADATA.replace("frameTimestamps", "unused").replace("perFrame", "unused");
    files[0].1 = untimed.replace("60", "0").into_bytes();
    let options = OpenOptions { colour_only: true, ..OpenOptions::default() };
    let without_rate = folder.write("b.r3d", zip(&files, false));
    assert!(Sequence::open(&without_rate, &options).expect("colour").are_times_assumed);
    files[0].1 = untimed.into_bytes();
    let path = folder.write("a.r3d", zip(&files, false));
    assert_says(open(&path), &["rgbd", "none of its 3 pictures has depth"]);
    assert!(is_without_depth(&path));
    let sequence = Sequence::open(&path, &options).expect("colour");
    assert_eq!((sequence.camera.fx, sequence.camera.cx), (41.0, 23.5));
    assert!(!sequence.are_times_assumed);
    assert!((sequence.load(2).expect("a frame").timestamp - 2.0 / 60.0).abs() < 1e-9);
}

#[test]
fn depth_is_in_metres_whatever_the_user_says_and_an_unknown_camera_is_asked_for() {
    let folder = Folder::new();
    let [path, .., unpacked] = recordings(&folder);
    let scaled = OpenOptions { depth_scale: Some(1000.0), ..OpenOptions::default() };
    assert_says(Sequence::open(&path, &scaled), &["depth_scale", "depth in metres"]);
    let camera = r#"{"fx": 30, "fy": 30, "cx": 23.5, "cy": 15.5, "depth_scale": 1000}"#;
    folder.write("unpacked/camera.json", camera);
    // One beside an archive belongs to something else.
    folder.write("camera.json", camera);
    for (recording, fx) in [(&unpacked, 30.0), (&path, 40.0)] {
        let sequence = open(recording).expect("a recording");
        let depth = sequence.load(0).expect("a frame").depth.expect("depth");
        assert_eq!((sequence.camera.fx, depth.image.data[48 * 16 + 10]), (fx, 1.5));
    }
    let mut files = files();
    files[0].1 = br#"{"w": 48, "h": 32, "dw": 24, "dh": 16}"#.to_vec();
    let path = folder.write("b.r3d", zip(&files, false));
    assert!(matches!(open(&path), Err(DatasetError::NoCamera { .. })));
    let guessed = OpenOptions { guess_camera: true, ..OpenOptions::default() };
    assert!(Sequence::open(&path, &guessed).expect("a recording").camera_is_guess);
}

/// Writers that do not know 64-bit sizes count members modulo 65536.
#[test]
fn long_recordings_are_read_to_their_end() {
    let folder = Folder::new();
    let others = (0..0x1_0000).map(|i| (format!("other/{i}"), Vec::new()));
    let members: Vec<_> = others.chain(files()).collect();
    let path = folder.write("a.r3d", zip(&members, false));
    assert_eq!(open(&path).expect("a recording").len(), 3);
}

#[test]
fn a_recording_beside_another_sequence_does_not_replace_it() {
    let folder = Folder::tum(2);
    folder.write("other.r3d", b"damaged");
    assert_eq!(open(&folder.0).expect("a sequence").layout, Layout::Tum);
    let pictures = Folder::new();
    (0..2).for_each(|i| drop(pictures.write(&format!("{i}.png"), rgb_png(16, 12, 60 + i))));
    pictures.write("other.r3d", b"damaged");
    assert!(is_without_depth(&pictures.0));
}

#[test]
fn damaged_recordings_are_told() {
    let folder = Folder::new();
    let with = |name: &str, bytes: &[u8]| {
        let mut files = files();
        files.iter_mut().filter(|file| file.0 == name).for_each(|file| file.1 = bytes.to_vec());
        folder.write("a.r3d", zip(&files, false))
    };
    for (metadata, problem) in [
        ("{", "no JSON object of Record3D"),
        (r#"{"w": 48}"#, "missing field `h`"),
        (r#"{"w": 48, "h": "x"}"#, "h: invalid type"),
        (r#"{"w": 48, "h": 32, "dw": 0}"#, "above 0"),
        (r#"{"w": 48, "h": 32, "K": [1, 2]}"#, "expected intrinsics with fx, fy above 0"),
        (r#"{"w": 48, "h": 32, "dw": 90000, "dh": 90000}"#, "megapixels"),
    ] {
        assert_says(open(&with("metadata", metadata.as_bytes())), &["a.r3d", "metadata", problem]);
    }
    let load = |path: &Path| open(path).expect("opens").load(0);
    let short = compressed(&[0; 500]);
    let due = "expected 1536 for 24x16 values";
    assert_says(load(&with("rgbd/0.depth", &short)), &["a.r3d", "depth of 500 bytes", due]);
    let long = compressed(&[0; 5000]);
    assert_says(load(&with("rgbd/0.depth", &long)), &["depth of more bytes", due]);
    let mut broken = compressed(&(0..1536).map(|i| (i * i % 251) as u8).collect::<Vec<_>>());
    broken.truncate(40);
    assert_says(load(&with("rgbd/0.conf", &broken)), &["a.r3d", "damaged confidence"]);

    let whole = zip(&files(), false);
    let cut_off = folder.write("b.r3d", &whole[..whole.len() / 2]);
    assert_says(open(&cut_off), &["b.r3d", "cut off or no archive"]);
    let other = folder.write("c.r3d", zip(&[("a.txt".to_owned(), b"a".to_vec())], false));
    assert_says(open(&other), &["c.r3d", "no recording of Record3D"]);
    folder.write("empty/metadata", METADATA);
    folder.write("empty/rgbd/notes.txt", "");
    assert_says(open(&folder.join("empty")), &["rgbd", "0.jpg"]);
}

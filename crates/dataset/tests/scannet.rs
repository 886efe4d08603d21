//! ScanNet, extracted and as `.sens`.

mod support;

use i2slam_dataset::{DatasetError, Layout, OpenOptions, Sequence};
use std::path::Path;
use support::Folder;
use support::scannet::{Sens, depth, extract};

/// The border that holds a picture; nothing of the fixture is empty.
fn options() -> OpenOptions {
    OpenOptions { crop_border: 1, ..OpenOptions::default() }
}

fn open(path: &Path) -> Result<Sequence, DatasetError> {
    Sequence::open(path, &options())
}

/// Every frame of the fixture: colour of 32x24 averaged onto the 16x12 of depth, then cropped.
fn assert_frames(sequence: &Sequence) {
    let c = sequence.camera;
    assert_eq!((c.width, c.height), (14, 10));
    assert!((c.fx - 14.0).abs() < 1e-6 && (c.cx - 7.0).abs() < 1e-6 && (c.cy - 5.0).abs() < 1e-6);
    for (i, frame) in sequence.stream().enumerate() {
        let frame = frame.expect("loads");
        assert_eq!(frame.warnings.len(), 0, "{:?}", frame.warnings);
        for column in 0..14 {
            // Columns 2 (column + 1) and the next of the picture, four levels a column.
            let due = (4.0 * (2.0 * (column as f32 + 1.0) + 0.5) + i as f32) / 255.0;
            let found = frame.colour.at(1, column, 4);
            assert!((found - due).abs() < 1e-5, "{column}: {found} {due}");
        }
        assert!((frame.depth.at(0, 3, 4) - f32::from(depth(i)) / 1000.0).abs() < 1e-6);
    }
}

fn assert_poses(sequence: &Sequence) {
    let truth = sequence.true_trajectory().expect("poses");
    let seen: Vec<(f64, f64)> =
        truth.iter().map(|p| (p.timestamp, p.world_from_camera.translation.x)).collect();
    let times: Vec<f64> = sequence.entries.iter().map(|e| e.timestamp).collect();
    assert_eq!(seen, [(times[0], 0.0), (times[2], 2.0)]);
    assert!(
        sequence.warnings.iter().any(|w| w.contains("1 frame without a finite, rigid true pose"))
    );
}

#[test]
fn an_extracted_scene_opens() {
    for prefix in ["", "frames/"] {
        let folder = Folder::new();
        extract(&folder, prefix, &[0, 1, 2]);
        let sequence = open(&folder.0).expect("opens");
        assert_eq!((sequence.layout, sequence.len()), (Layout::ScanNet, 3));
        assert_eq!((sequence.depth_scale, sequence.frame_rate.round()), (1000.0, 30.0));
        assert_frames(&sequence);
        assert_poses(&sequence);
    }
}

#[test]
fn numbers_with_gaps_are_times_with_gaps() {
    let folder = Folder::new();
    extract(&folder, "", &[0, 10, 20]);
    let sequence = open(&folder.0).expect("opens");
    assert!((sequence.entries[2].timestamp - 20.0 / 30.0).abs() < 1e-9);
    assert!(sequence.warnings.iter().any(|w| w.contains("3 frames numbered 0 to 20")));
}

#[test]
fn the_empty_border_is_spoken_of_until_it_is_removed() {
    let folder = Folder::new();
    extract(&folder, "", &[0]);
    let speaks = |s: &Sequence| s.warnings.iter().any(|w| w.contains("crop_border 12"));
    assert!(speaks(&open(&folder.0).expect("opens")));
    let too_much = OpenOptions { crop_border: 12, ..OpenOptions::default() };
    let error = Sequence::open(&folder.0, &too_much).expect_err("nothing is left").to_string();
    assert!(error.contains("crop_border"), "{error}");
}

#[test]
fn colour_in_the_size_of_depth_has_the_camera_of_depth() {
    let folder = Folder::new();
    extract(&folder, "", &[0]);
    folder.write("color/0.jpg", support::rgb_png(16, 12, 90));
    folder.write("intrinsic/intrinsic_color.txt", "28 0 15.5 0 0 28 11.5 0 0 0 1 0 0 0 0 1");
    let sequence = open(&folder.0).expect("opens");
    assert!(
        !sequence.warnings.iter().any(|w| w.contains("another size")),
        "{:?}",
        sequence.warnings
    );
    assert!(sequence.valid_mask.is_none());
    assert_eq!(sequence.load(0).expect("loads").colour.at(0, 0, 0), 90.0 / 255.0);
}

#[test]
fn a_sens_file_gives_the_same_frames() {
    for depth_code in [0, 1] {
        let folder = Folder::new();
        let file =
            folder.write("scene0024_01.sens", Sens { depth_code, ..Sens::default() }.bytes());
        for path in [&file, &folder.0] {
            let sequence = open(path).expect("opens");
            assert_eq!((sequence.layout, sequence.len()), (Layout::Sens, 3));
            let times: Vec<f64> = sequence.entries.iter().map(|e| e.timestamp).collect();
            assert!((times[0], (times[2] - 0.08).abs() < 1e-9) == (0.0, true), "{times:?}");
            assert!((sequence.frame_rate - 25.0).abs() < 1e-6);
            assert_frames(&sequence);
            assert_poses(&sequence);
        }
        assert_eq!(open(&file).expect("opens").name, "scene0024_01");
    }
}

#[test]
fn a_cut_off_sens_file_gives_its_whole_frames() {
    let folder = Folder::new();
    let bytes = Sens::default().bytes();
    let file = folder.write("a.sens", &bytes[..bytes.len() - 5]);
    let sequence = open(&file).expect("opens");
    assert_eq!(sequence.len(), 2);
    assert!(sequence.warnings[0].contains("ends within frame 2 of 3"), "{:?}", sequence.warnings);
    let mut endless = bytes.clone();
    // The size of the first colour image, behind header, pose and stamps.
    let header = 4 + 8 + 15 + 4 * 64 + 4 * 6 + 4 + 8;
    endless[header + 80..header + 88].fill(0xff);
    folder.write("a.sens", &endless);
    let error = open(&file).expect_err("no frame").to_string();
    assert!(error.contains("at least one whole frame"), "{error}");
    folder.write("a.sens", &bytes[..430]);
    let error = open(&file).expect_err("no frame").to_string();
    assert!(error.contains("at least one whole frame"), "{error}");
    folder.write("a.sens", &bytes[..100]);
    assert!(open(&file).expect_err("no header").to_string().contains("a.sens"));
}

#[test]
fn unusable_stamps_are_replaced() {
    let folder = Folder::new();
    for step in [0, 40] {
        let file = folder.write("a.sens", Sens { step, ..Sens::default() }.bytes());
        let sequence = open(&file).expect("opens");
        assert!((sequence.entries[2].timestamp - 2.0 / 30.0).abs() < 1e-9);
        assert!(sequence.warnings.iter().any(|w| w.contains("30 frames a second assumed")));
    }
}

#[test]
fn foreign_sens_files_are_refused() {
    let folder = Folder::new();
    for (sens, part) in [
        (Sens { version: 3, ..Sens::default() }, "version 3, expected 4"),
        (Sens { depth_code: 2, ..Sens::default() }, "depth code 2"),
        (Sens { frames: 0, ..Sens::default() }, "at least one whole frame"),
    ] {
        let file = folder.write("a.sens", sens.bytes());
        let error = open(&file).expect_err("refused").to_string();
        assert!(error.contains("a.sens") && error.contains(part), "{error}");
    }
    let mut bytes = Sens::default().bytes();
    let last = bytes.len() - 1;
    bytes[last] ^= 0xff;
    bytes[last - 6] ^= 0xff;
    let sequence = open(&folder.write("a.sens", &bytes)).expect("opens");
    let error = sequence.load(2).expect_err("damaged");
    assert!(error.concerns_one_frame() && error.to_string().contains("zlib"), "{error}");
    let text = folder.write("notes.txt", "");
    assert!(open(&text).expect_err("no .sens").to_string().contains("no .sens"));
}

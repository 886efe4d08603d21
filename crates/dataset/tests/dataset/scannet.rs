//! ScanNet, extracted and as `.sens`: 32x24 colour, 16x12 depth.

use crate::support::{Folder, assert_says, assert_warns, depth_png, png, rgb_png};
use i2slam_dataset::{DatasetError, Layout, OpenOptions, Sequence};
use std::path::Path;

const COLOUR: (usize, usize) = (32, 24);
const DEPTH: (usize, usize) = (16, 12);

/// Colour camera as ScanNet writes it (pixel centres at integers); the depth camera is it resized.
const INTRINSIC_COLOUR: [f32; 4] = [28.0, 28.0, 15.5, 11.5];
const INTRINSIC_DEPTH: [f32; 4] = [14.0, 14.0, 7.5, 5.5];

fn matrix([fx, fy, cx, cy]: [f32; 4]) -> [f32; 16] {
    [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
}

/// The pose of frame `i`: `i` metres along x; frame 1 has none.
fn pose(i: usize) -> [f32; 16] {
    let mut m = matrix([1.0, 1.0, 0.0, 0.0]);
    m[3] = i as f32;
    if i == 1 { [f32::NEG_INFINITY; 16] } else { m }
}

/// Four grey levels more with every column, frame number on top.
fn colour_png(i: usize) -> Vec<u8> {
    let value = |k: usize| (4 * (k / 3 % COLOUR.0) + i) as u8;
    let data: Vec<u8> = (0..3 * COLOUR.0 * COLOUR.1).map(value).collect();
    png(COLOUR, png::ColorType::Rgb, png::BitDepth::Eight, None, &data)
}

/// Millimetres of frame `i`.
fn depth(i: usize) -> u16 {
    1000 + 100 * i as u16
}

fn text(m: [f32; 16]) -> String {
    m.chunks(4)
        .map(|row| format!("{:.6} {:.6} {:.6} {:.6}\n", row[0], row[1], row[2], row[3]))
        .collect()
}

/// The files that ScanNet's reader extracts, under a prefix such as `frames/`.
fn extract(folder: &Folder, prefix: &str, frames: &[usize]) {
    for &i in frames {
        folder.write(&format!("{prefix}color/{i}.jpg"), colour_png(i));
        folder.write(&format!("{prefix}depth/{i}.png"), depth_png(DEPTH.0, DEPTH.1, depth(i)));
        folder.write(&format!("{prefix}pose/{i}.txt"), text(pose(i)));
    }
    folder.write(&format!("{prefix}intrinsic/intrinsic_color.txt"), text(matrix(INTRINSIC_COLOUR)));
    folder.write(&format!("{prefix}intrinsic/intrinsic_depth.txt"), text(matrix(INTRINSIC_DEPTH)));
}

/// Contents of a `.sens` file.
struct Sens {
    version: u32,
    depth_code: i32,
    /// Microseconds between frames.
    step: u64,
    frames: usize,
}

impl Default for Sens {
    fn default() -> Self {
        Self { version: 4, depth_code: 1, step: 40_000, frames: 3 }
    }
}

impl Sens {
    fn bytes(&self) -> Vec<u8> {
        let mut out = self.version.to_le_bytes().to_vec();
        let name = b"StructureSensor";
        out.extend((name.len() as u64).to_le_bytes());
        out.extend(name);
        let still = matrix([1.0, 1.0, 0.0, 0.0]);
        for m in [matrix(INTRINSIC_COLOUR), still, matrix(INTRINSIC_DEPTH), still] {
            out.extend(m.iter().flat_map(|v| v.to_le_bytes()));
        }
        out.extend(2_i32.to_le_bytes());
        out.extend(self.depth_code.to_le_bytes());
        for side in [COLOUR.0, COLOUR.1, DEPTH.0, DEPTH.1] {
            out.extend((side as u32).to_le_bytes());
        }
        out.extend(1000_f32.to_le_bytes());
        out.extend((self.frames as u64).to_le_bytes());
        for i in 0..self.frames {
            out.extend(self.frame(i));
        }
        out
    }

    fn frame(&self, i: usize) -> Vec<u8> {
        let raw: Vec<u8> = (0..DEPTH.0 * DEPTH.1).flat_map(|_| depth(i).to_le_bytes()).collect();
        let depth = match self.depth_code {
            1 => miniz_oxide::deflate::compress_to_vec_zlib(&raw, 6),
            _ => raw,
        };
        let (colour, stamp) = (colour_png(i), 1_000_000 + i as u64 * self.step);
        let mut out: Vec<u8> = pose(i).iter().flat_map(|v| v.to_le_bytes()).collect();
        for word in [stamp, stamp, colour.len() as u64, depth.len() as u64] {
            out.extend(word.to_le_bytes());
        }
        out.extend(colour);
        out.extend(depth);
        out
    }
}

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
        assert!(
            (frame.depth_image().expect("depth").at(0, 3, 4) - f32::from(depth(i)) / 1000.0).abs()
                < 1e-6
        );
    }
}

fn assert_poses(sequence: &Sequence) {
    let truth = sequence.true_trajectory().expect("poses");
    let seen: Vec<(f64, f64)> =
        truth.iter().map(|p| (p.timestamp, p.world_from_camera.translation.x)).collect();
    let times: Vec<f64> = sequence.entries.iter().map(|e| e.timestamp).collect();
    assert_eq!(seen, [(times[0], 0.0), (times[2], 2.0)]);
    assert_warns(&sequence.warnings, &["1 frame without a finite, rigid true pose"]);
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
    assert_warns(&sequence.warnings, &["3 frames numbered 0 to 20"]);
}

#[test]
fn the_empty_border_is_spoken_of_until_it_is_removed() {
    let folder = Folder::new();
    extract(&folder, "", &[0]);
    let speaks = |s: &Sequence| s.warnings.iter().any(|w| w.contains("crop_border = 12"));
    assert!(speaks(&open(&folder.0).expect("opens")));
    let too_much = OpenOptions { crop_border: 12, ..OpenOptions::default() };
    assert_says(Sequence::open(&folder.0, &too_much), &["crop_border"]);
}

#[test]
fn colour_in_the_size_of_depth_has_the_camera_of_depth() {
    let folder = Folder::new();
    extract(&folder, "", &[0]);
    folder.write("color/0.jpg", rgb_png(16, 12, 90));
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
    assert_warns(&sequence.warnings, &["ends within frame 2 of 3"]);
    let mut endless = bytes.clone();
    // The size of the first colour image, behind header, pose and stamps.
    let header = 4 + 8 + 15 + 4 * 64 + 4 * 6 + 4 + 8;
    endless[header + 80..header + 88].fill(0xff);
    folder.write("a.sens", &endless);
    assert_says(open(&file), &["at least one whole frame"]);
    folder.write("a.sens", &bytes[..430]);
    assert_says(open(&file), &["at least one whole frame"]);
    folder.write("a.sens", &bytes[..100]);
    assert_says(open(&file), &["a.sens"]);
}

#[test]
fn unusable_stamps_are_replaced() {
    let folder = Folder::new();
    for step in [0, 40] {
        let file = folder.write("a.sens", Sens { step, ..Sens::default() }.bytes());
        let sequence = open(&file).expect("opens");
        assert!((sequence.entries[2].timestamp - 2.0 / 30.0).abs() < 1e-9);
        assert_warns(&sequence.warnings, &["30 frames a second assumed"]);
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
        assert_says(open(&file), &["a.sens", part]);
    }
    let mut bytes = Sens::default().bytes();
    let last = bytes.len() - 1;
    bytes[last] ^= 0xff;
    bytes[last - 6] ^= 0xff;
    let sequence = open(&folder.write("a.sens", &bytes)).expect("opens");
    let error = sequence.load(2).expect_err("damaged");
    assert!(error.concerns_one_frame() && error.to_string().contains("zlib"), "{error}");
    let text = folder.write("notes.txt", "");
    assert_says(open(&text), &["no .sens"]);
}

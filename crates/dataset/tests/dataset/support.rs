//! Assertions, and tiny sequences in temporary folders.

use i2slam_dataset::import::{ImportOptions, ImportedKeyframes};
use i2slam_dataset::{DatasetError, OpenOptions, Sequence};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

pub(crate) const WIDTH: usize = 16;
pub(crate) const HEIGHT: usize = 12;
pub(crate) const CAMERA: &str = r#"{"fx":14.0,"fy":14.0,"cx":7.5,"cy":5.5,"width":16,"height":12}"#;

/// A temporary folder.
pub(crate) struct Folder(pub(crate) PathBuf);

impl Folder {
    pub(crate) fn new() -> Self {
        static NEXT: AtomicUsize = AtomicUsize::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = format!("i2slam-dataset-{}-{number}", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&path).expect("temporary folder");
        Self(path)
    }

    pub(crate) fn join(&self, name: &str) -> PathBuf {
        self.0.join(name)
    }

    pub(crate) fn write(&self, name: &str, content: impl AsRef<[u8]>) -> PathBuf {
        let path = self.join(name);
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).expect("folder");
        }
        std::fs::write(&path, content).expect("fixture");
        path
    }

    /// A TUM sequence of `count` frames at 30 a second, colour `i` grey levels, depth 1 + i/10 m.
    pub(crate) fn tum(count: usize) -> Self {
        let folder = Self::new();
        let (mut colour, mut depth) = (String::from("# colour\n"), String::from("# depth\n"));
        for i in 0..count {
            let stamp = i as f64 / 30.0;
            colour += &format!("{stamp:.6} rgb/{i:03}.png\n");
            depth += &format!("{:.6} depth/{i:03}.png\n", stamp + 0.004);
            folder.frame("rgb", "depth", &format!("{i:03}"), i);
        }
        folder.write("rgb.txt", colour);
        folder.write("depth.txt", depth);
        folder.write("camera.json", CAMERA);
        folder
    }

    pub(crate) fn frame(&self, colour: &str, depth: &str, name: &str, i: usize) {
        self.write(&format!("{colour}/{name}.png"), rgb_png(WIDTH, HEIGHT, 60 + i as u8));
        let value = (5000.0 * (1.0 + i as f64 / 10.0)).round() as u16;
        self.write(&format!("{depth}/{name}.png"), depth_png(WIDTH, HEIGHT, value));
    }
}

impl AsRef<Path> for Folder {
    fn as_ref(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

pub(crate) fn png(
    (width, height): (usize, usize),
    color: png::ColorType,
    depth: png::BitDepth,
    palette: Option<Vec<u8>>,
    data: &[u8],
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    if let Some(palette) = palette {
        encoder.set_palette(palette);
    }
    let mut writer = encoder.write_header().expect("header");
    writer.write_image_data(data).expect("data");
    writer.finish().expect("end");
    bytes
}

pub(crate) fn rgb_png(width: usize, height: usize, value: u8) -> Vec<u8> {
    let data: Vec<u8> = (0..width * height).flat_map(|_| [value, value / 2, value / 3]).collect();
    png((width, height), png::ColorType::Rgb, png::BitDepth::Eight, None, &data)
}

pub(crate) fn depth_png(width: usize, height: usize, value: u16) -> Vec<u8> {
    let data: Vec<u8> = (0..width * height).flat_map(|_| value.to_be_bytes()).collect();
    png((width, height), png::ColorType::Grayscale, png::BitDepth::Sixteen, None, &data)
}

/// A sequence in the folder `shared/data` beside the repository.
pub(crate) fn shared_data(name: &str) -> PathBuf {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data")).join(name)
}

/// Opens a sequence with the default options.
pub(crate) fn open(folder: &Folder) -> Result<Sequence, DatasetError> {
    Sequence::open(&folder.0, &OpenOptions::default())
}

/// Opens keyframes without a folder of images, with the default options.
pub(crate) fn import(
    path: &(impl AsRef<Path> + ?Sized),
) -> Result<ImportedKeyframes, DatasetError> {
    ImportedKeyframes::open(path.as_ref(), None, &ImportOptions::default())
}

/// Opens keyframes with the images of a folder, with the default options.
pub(crate) fn import_with(
    path: &Path,
    pictures: &Folder,
) -> Result<ImportedKeyframes, DatasetError> {
    ImportedKeyframes::open(path, Some(&pictures.0), &ImportOptions::default())
}

/// The result is an error whose message contains all `parts`.
#[track_caller]
pub(crate) fn assert_says<T>(result: Result<T, DatasetError>, parts: &[&str]) {
    let message = result.err().expect("an error").to_string();
    for part in parts {
        assert!(message.contains(part), "'{part}' is not in: {message}");
    }
}

/// One of the warnings contains all `parts`.
#[track_caller]
pub(crate) fn assert_warns(warnings: &[String], parts: &[&str]) {
    let has_all = |warning: &String| parts.iter().all(|part| warning.contains(part));
    assert!(warnings.iter().any(has_all), "no warning with {parts:?} in {warnings:?}");
}

/// An 8-bit RGB JPEG.
pub(crate) fn jpeg(width: usize, height: usize, pixels: &[u8]) -> Vec<u8> {
    let mut bytes = Vec::new();
    jpeg_encoder::Encoder::new(&mut bytes, 95)
        .encode(pixels, width as u16, height as u16, jpeg_encoder::ColorType::Rgb)
        .expect("encodes");
    bytes
}

/// The header of a PNG of a size, without pixels.
pub(crate) fn png_header(width: u32, height: u32) -> Vec<u8> {
    let mut bytes = rgb_png(1, 1, 0);
    bytes[16..20].copy_from_slice(&width.to_be_bytes());
    bytes[20..24].copy_from_slice(&height.to_be_bytes());
    let checksum = crc32fast::hash(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&checksum.to_be_bytes());
    bytes
}

/// A JPEG whose header says another size.
pub(crate) fn jpeg_header(mut bytes: Vec<u8>, width: u16, height: u16) -> Vec<u8> {
    let frame = bytes.windows(2).position(|marker| marker == [0xff, 0xc0]).expect("a frame");
    bytes[frame + 5..frame + 7].copy_from_slice(&height.to_be_bytes());
    bytes[frame + 7..frame + 9].copy_from_slice(&width.to_be_bytes());
    bytes
}

/// A zip archive of members, stored or deflated.
pub(crate) fn zip(members: &[(String, Vec<u8>)], deflate: bool) -> Vec<u8> {
    let (mut out, mut table) = (Vec::new(), Vec::new());
    for (name, bytes) in members {
        let packed =
            if deflate { miniz_oxide::deflate::compress_to_vec(bytes, 6) } else { bytes.clone() };
        let mut record = vec![20, 0, 0, 0, if deflate { 8 } else { 0 }, 0, 0, 0, 0, 0];
        record.extend(crc32fast::hash(bytes).to_le_bytes());
        record.extend((packed.len() as u32).to_le_bytes());
        record.extend((bytes.len() as u32).to_le_bytes());
        record.extend((name.len() as u16).to_le_bytes());
        let offset = out.len() as u32;
        // numpy leaves room for 64-bit sizes before every member, not in the table.
        let wide = [1, 0, 16, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0];
        out.extend(b"PK\x03\x04");
        out.extend(&record);
        out.extend((wide.len() as u16).to_le_bytes());
        out.extend(name.bytes());
        out.extend(wide);
        out.extend(packed);
        table.extend(b"PK\x01\x02\x14\x03");
        table.extend(&record);
        table.extend([0; 12]);
        table.extend(offset.to_le_bytes());
        table.extend(name.bytes());
    }
    let place = out.len() as u32;
    let count = (members.len() as u16).to_le_bytes();
    out.extend(&table);
    out.extend(b"PK\x05\x06\x00\x00\x00\x00");
    out.extend([count, count].concat());
    out.extend((table.len() as u32).to_le_bytes());
    out.extend(place.to_le_bytes());
    out.extend([0, 0]);
    out
}

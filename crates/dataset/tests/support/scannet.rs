//! A small ScanNet sequence: 32x24 colour, 16x12 depth, extracted and as `.sens`.

use super::{Folder, depth_png, png};

pub const COLOUR: (usize, usize) = (32, 24);
pub const DEPTH: (usize, usize) = (16, 12);

/// Colour camera as ScanNet writes it (pixel centres at integers); the depth camera is it resized.
const INTRINSIC_COLOUR: [f32; 4] = [28.0, 28.0, 15.5, 11.5];
const INTRINSIC_DEPTH: [f32; 4] = [14.0, 14.0, 7.5, 5.5];

fn matrix([fx, fy, cx, cy]: [f32; 4]) -> [f32; 16] {
    [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
}

/// The pose of frame `i`: `i` metres along x; frame 1 has none.
pub fn pose(i: usize) -> [f32; 16] {
    let mut m = matrix([1.0, 1.0, 0.0, 0.0]);
    m[3] = i as f32;
    if i == 1 { [f32::NEG_INFINITY; 16] } else { m }
}

/// Four grey levels more with every column, frame number on top.
pub fn colour_png(i: usize) -> Vec<u8> {
    let value = |k: usize| (4 * (k / 3 % COLOUR.0) + i) as u8;
    let data: Vec<u8> = (0..3 * COLOUR.0 * COLOUR.1).map(value).collect();
    png(COLOUR, png::ColorType::Rgb, png::BitDepth::Eight, None, &data)
}

/// Millimetres of frame `i`.
pub fn depth(i: usize) -> u16 {
    1000 + 100 * i as u16
}

fn text(m: [f32; 16]) -> String {
    m.chunks(4)
        .map(|row| format!("{:.6} {:.6} {:.6} {:.6}\n", row[0], row[1], row[2], row[3]))
        .collect()
}

/// The files that ScanNet's reader extracts, under a prefix such as `frames/`.
pub fn extract(folder: &Folder, prefix: &str, frames: &[usize]) {
    for &i in frames {
        folder.write(&format!("{prefix}color/{i}.jpg"), colour_png(i));
        folder.write(&format!("{prefix}depth/{i}.png"), depth_png(DEPTH.0, DEPTH.1, depth(i)));
        folder.write(&format!("{prefix}pose/{i}.txt"), text(pose(i)));
    }
    folder.write(&format!("{prefix}intrinsic/intrinsic_color.txt"), text(matrix(INTRINSIC_COLOUR)));
    folder.write(&format!("{prefix}intrinsic/intrinsic_depth.txt"), text(matrix(INTRINSIC_DEPTH)));
}

/// What a `.sens` file is made of.
pub struct Sens {
    pub version: u32,
    pub depth_code: i32,
    /// Microseconds between frames.
    pub step: u64,
    pub frames: usize,
}

impl Default for Sens {
    fn default() -> Self {
        Self { version: 4, depth_code: 1, step: 40_000, frames: 3 }
    }
}

impl Sens {
    pub fn bytes(&self) -> Vec<u8> {
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

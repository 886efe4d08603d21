//! ScanNet's `.sens` files.

use super::picture::{SIZE, colour};
use super::scene::{matrix, position};

const DEPTH_SIZE: (usize, usize) = (12, 9);

/// A file of three frames with depth of a compression, 0 for none or 1 for zlib.
pub(super) fn bytes(depth_compression: i32) -> Vec<u8> {
    let floats = |m: [f64; 16]| m.map(|v| (v as f32).to_le_bytes()).concat();
    let camera = |[fx, fy, cx, cy]: [f64; 4]| {
        floats([fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    };
    let mut out = 4_u32.to_le_bytes().to_vec();
    let name = b"StructureSensor";
    out.extend((name.len() as u64).to_le_bytes());
    out.extend(name);
    out.extend(camera(super::scene::INTRINSICS));
    out.extend(floats(matrix(0.0)));
    out.extend(camera([10.0, 10.0, 5.5, 4.0]));
    out.extend(floats(matrix(0.0)));
    // Colour is compressed as PNG or JPEG.
    out.extend(2_i32.to_le_bytes());
    out.extend(depth_compression.to_le_bytes());
    for side in [SIZE.0, SIZE.1, DEPTH_SIZE.0, DEPTH_SIZE.1] {
        out.extend((side as u32).to_le_bytes());
    }
    out.extend(1000_f32.to_le_bytes());
    out.extend(3_u64.to_le_bytes());
    for i in 0..3 {
        let raw = (0..DEPTH_SIZE.0 * DEPTH_SIZE.1).flat_map(|k| (1000 + k as u16).to_le_bytes());
        let raw: Vec<u8> = raw.collect();
        let depth = match depth_compression {
            1 => miniz_oxide::deflate::compress_to_vec_zlib(&raw, 6),
            _ => raw,
        };
        let (colour, time) = (colour(SIZE, i), 1_000_000 + 40_000 * i as u64);
        out.extend(floats(matrix(position(i))));
        out.extend(
            [time, time, colour.len() as u64, depth.len() as u64].map(u64::to_le_bytes).concat(),
        );
        out.extend(colour);
        out.extend(depth);
    }
    out
}

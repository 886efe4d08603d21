//! Arrays of DROID-SLAM, as `.npy` files and in `.npz` archives.

use super::picture::pattern;
use super::scene::position;
use crate::container::join_zip;

/// Width and height of the pictures [px].
const SIZE: (usize, usize) = (24, 16);
const FRAMES: usize = 3;
/// Intrinsics of the pictures, pixel centres at integers [px].
const INTRINSICS: [f64; 4] = [20.0, 20.0, 11.5, 7.5];

/// Kind of the numbers, shape and numbers of an array.
fn npy(kind: &str, shape: &[usize], numbers: &[f64]) -> Vec<u8> {
    let sides: String = shape.iter().map(|side| format!("{side}, ")).collect();
    let mut header =
        format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}", sides.trim());
    while (header.len() + 11) % 64 != 0 {
        header.push(' ');
    }
    header.push('\n');
    let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
    bytes.extend((header.len() as u16).to_le_bytes());
    bytes.extend(header.bytes());
    for &number in numbers {
        match kind {
            "|u1" => bytes.push(number as u8),
            "<f8" => bytes.extend(number.to_le_bytes()),
            _ => bytes.extend((number as f32).to_le_bytes()),
        }
    }
    bytes
}

/// Names and contents of the arrays.
pub(super) fn members() -> Vec<(&'static str, Vec<u8>)> {
    let (width, height) = SIZE;
    let (small_width, small_height) = (width / 8, height / 8);
    let of_frame = |i: usize| [-position(i), 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
    let poses: Vec<f64> = (0..FRAMES).flat_map(of_frame).collect();
    let mut images = Vec::new();
    for i in 0..FRAMES {
        let pixels = pattern(SIZE, i);
        for channel in [2, 1, 0] {
            images.extend(pixels.chunks(3).map(|pixel| f64::from(pixel[channel])));
        }
    }
    let numbers = FRAMES * small_width * small_height;
    let intrinsics: Vec<f64> = (0..FRAMES).flat_map(|_| INTRINSICS.map(|v| v / 8.0)).collect();
    vec![
        ("tstamps.npy", npy("<f8", &[FRAMES], &[0.0, 1.0, 2.0])),
        ("images.npy", npy("|u1", &[FRAMES, 3, height, width], &images)),
        ("disps.npy", npy("<f4", &[FRAMES, small_height, small_width], &vec![0.5; numbers])),
        ("disps_cov.npy", npy("<f4", &[FRAMES, small_height, small_width], &vec![0.01; numbers])),
        ("poses.npy", npy("<f4", &[FRAMES, 7], &poses)),
        ("intrinsics.npy", npy("<f4", &[FRAMES, 4], &intrinsics)),
    ]
}

/// The arrays as an archive, stored or deflated.
pub(super) fn archive(deflate: bool) -> Vec<u8> {
    let members = members();
    let methods = vec![if deflate { 8 } else { 0 }; members.len()];
    let parts = members.into_iter().flat_map(|(name, bytes)| [name.as_bytes().to_vec(), bytes]);
    join_zip(&parts.collect::<Vec<_>>(), &methods)
}

/// The variance of a depth picture of the sequences [m²].
pub(super) fn variance((width, height): (usize, usize)) -> Vec<u8> {
    npy("<f4", &[height, width], &vec![0.01; width * height])
}

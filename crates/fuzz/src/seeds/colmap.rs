//! Sparse models of COLMAP, text and binary.

use super::files;
use super::scene::position;
use crate::corpus::Files;

const FRAMES: usize = 3;
/// Places of points [m], 2 m in front of the first camera.
const POINTS: [[f64; 3]; 3] = [[0.0, 0.0, 2.0], [0.2, -0.1, 2.0], [-0.2, 0.1, 2.2]];

pub(super) fn text() -> Files {
    let image = |i: usize| {
        let (number, x) = (i + 1, -position(i));
        format!("{number} 1 0 0 0 {x} 0 0 1 {i}.png\n1.5 2.5 -1 3.5 4.5 7\n")
    };
    let point = |(n, [x, y, z]): (usize, &[f64; 3])| {
        format!("{} {x} {y} {z} 9 9 9 0.5 1 0 2 1 3 0\n", n + 1)
    };
    let images: String = (0..FRAMES).map(image).collect();
    let points: String = POINTS.iter().enumerate().map(point).collect();
    files([
        ("cameras.txt", b"# Camera list\n1 PINHOLE 24 18 20 20 12 9\n"),
        ("images.txt", format!("# Image list\n{images}").as_bytes()),
        ("points3D.txt", points.as_bytes()),
    ])
}

pub(super) fn binary() -> Files {
    files([("cameras.bin", &cameras()), ("images.bin", &images()), ("points3D.bin", &points())])
}

/// One camera of the model OPENCV.
pub(super) fn cameras() -> Vec<u8> {
    let mut out = 1_u64.to_le_bytes().to_vec();
    out.extend(1_u32.to_le_bytes());
    out.extend(4_i32.to_le_bytes());
    out.extend([24_u64, 18].map(u64::to_le_bytes).concat());
    out.extend([20.0_f64, 20.0, 12.0, 9.0, 0.1, -0.01, 0.0, 0.0].map(f64::to_le_bytes).concat());
    out
}

fn images() -> Vec<u8> {
    let mut out = (FRAMES as u64).to_le_bytes().to_vec();
    for i in 0..FRAMES {
        out.extend((i as u32 + 1).to_le_bytes());
        let numbers = [1.0, 0.0, 0.0, 0.0, -position(i), 0.0, 0.0];
        out.extend(numbers.map(f64::to_le_bytes).concat());
        out.extend(1_u32.to_le_bytes());
        out.extend(format!("{i}.png\0").bytes());
        out.extend(1_u64.to_le_bytes());
        out.extend([12.0_f64, 9.0].map(f64::to_le_bytes).concat());
        out.extend(1_u64.to_le_bytes());
    }
    out
}

fn points() -> Vec<u8> {
    let mut out = (POINTS.len() as u64).to_le_bytes().to_vec();
    for (number, point) in (1_u64..).zip(POINTS) {
        out.extend(number.to_le_bytes());
        out.extend(point.map(f64::to_le_bytes).concat());
        out.extend([9; 3]);
        out.extend(0.5_f64.to_le_bytes());
        out.extend((FRAMES as u64).to_le_bytes());
        for i in 0..FRAMES {
            out.extend([i as u32 + 1, 0].map(u32::to_le_bytes).concat());
        }
    }
    out
}

//! A room of known shape and colour, seen by a camera that moves.

use crate::support::{Folder, png};
use i2slam_geometry::{Camera, Pose, Rotation, Vec3};
use png::{BitDepth, ColorType};

pub(super) const WIDTH: usize = 48;
pub(super) const HEIGHT: usize = 32;
pub(super) const CAMERA_JSON: &str = r#"{"fx":40,"fy":40,"cx":24,"cy":16,"pixel_centre":0.5}"#;

/// Half the width of the room [m].
const HALF: f64 = 2.0;

pub(super) fn camera() -> Camera<f64> {
    Camera { width: WIDTH, height: HEIGHT, fx: 40.0, fy: 40.0, cx: 24.0, cy: 16.0 }
}

/// `world_from_camera` of frame `i`: sideways and turning.
pub(super) fn pose(i: usize) -> Pose<f64> {
    let i = i as f64;
    let turn = Vec3::new(0.05 * (1.3 * i).sin(), 0.06 * i - 0.2, 0.03 * i);
    Pose::new(Rotation::exp(turn), Vec3::new(0.12 * i - 0.4, 0.05 * i, 0.3 - 0.04 * i))
}

/// Time stamp of frame `i` [s].
pub(super) fn stamp(i: usize) -> f64 {
    100.0 + i as f64 / 10.0
}

/// Depth [m] and colour of every pixel of frame `i`.
pub(super) fn render(i: usize) -> (Vec<f64>, Vec<u8>) {
    let (mut depth, mut colour) = (Vec::new(), Vec::new());
    for row in 0..HEIGHT {
        for column in 0..WIDTH {
            let (u, v) = Camera::<f64>::pixel_centre(column, row);
            let ray = camera().unproject(u, v, 1.0);
            let (z, shades) = look(i, ray);
            depth.push(z);
            colour.extend(shades);
        }
    }
    (depth, colour)
}

/// Depth [m] and colour that frame `i` sees along a ray of its camera of z = 1.
pub(super) fn look(i: usize, ray: Vec3<f64>) -> (f64, [u8; 3]) {
    let ray = pose(i).rotation.rotate(ray);
    let z = distance(pose(i).translation, ray);
    let p = (pose(i).translation + ray * z).to_array();
    let wave = |a: f64, b: f64, c: f64| (a * p[0] + b * p[1] + c * p[2]).sin();
    let shades = [wave(5.0, 3.0, 2.0), wave(-3.0, 6.0, 1.0), wave(2.0, -2.0, 7.0)];
    (z, shades.map(|s| (128.0 + 100.0 * s) as u8))
}

/// Distance from `from` to the nearest wall, in lengths of `ray`.
fn distance(from: Vec3<f64>, ray: Vec3<f64>) -> f64 {
    let along = from.to_array().into_iter().zip(ray.to_array());
    let walls = along.map(|(o, d)| if d > 0.0 { (HALF - o) / d } else { (-HALF - o) / d });
    walls.filter(|t| t.is_finite()).fold(f64::INFINITY, f64::min)
}

pub(super) fn colour_png(i: usize) -> Vec<u8> {
    png((WIDTH, HEIGHT), ColorType::Rgb, BitDepth::Eight, None, &render(i).1)
}

pub(super) fn grey16_png(values: &[u16]) -> Vec<u8> {
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
    png((WIDTH, HEIGHT), ColorType::Grayscale, BitDepth::Sixteen, None, &bytes)
}

pub(super) fn depth_png(i: usize) -> Vec<u8> {
    let values: Vec<u16> = render(i).0.iter().map(|z| (5000.0 * z).round() as u16).collect();
    grey16_png(&values)
}

/// A TUM sequence without depth of `count` frames.
pub(super) fn colour_sequence(count: usize) -> Folder {
    let folder = Folder::new();
    let mut list = String::new();
    for i in 0..count {
        list += &format!("{:.6} rgb/{i:03}.png\n", stamp(i));
        folder.write(&format!("rgb/{i:03}.png"), colour_png(i));
    }
    folder.write("rgb.txt", list);
    folder.write("camera.json", CAMERA_JSON);
    folder
}

/// A TUM sequence with depth of `count` frames.
pub(super) fn sequence(count: usize) -> Folder {
    let folder = colour_sequence(count);
    let mut list = String::new();
    for i in 0..count {
        list += &format!("{:.6} depth/{i:03}.png\n", stamp(i) + 0.002);
        folder.write(&format!("depth/{i:03}.png"), depth_png(i));
    }
    folder.write("depth.txt", list);
    folder
}

/// The line of a TUM trajectory.
pub(super) fn line(timestamp: f64, pose: Pose<f64>) -> String {
    let (t, q) = (pose.translation, pose.rotation);
    format!("{timestamp:.6} {} {} {} {} {} {} {}\n", t.x, t.y, t.z, q.v.x, q.v.y, q.v.z, q.w)
}

/// A TUM trajectory of some frames.
pub(super) fn trajectory(frames: impl IntoIterator<Item = usize>) -> String {
    frames.into_iter().map(|i| line(stamp(i), pose(i))).collect()
}

//! A made-up room: two textured walls and a floor, seen by a camera that moves a little.

use std::fmt::Write;
use std::fs;
use std::path::Path;

pub(crate) const WIDTH: usize = 48;
pub(crate) const HEIGHT: usize = 36;
const FOCAL: f64 = 45.0;
/// Depth image value of one metre.
const UNITS: f64 = 5000.0;

/// How a sequence is made.
#[derive(Clone, Copy)]
pub(crate) struct Scene {
    pub(crate) frames: usize,
    /// Camera motion from frame to frame [m].
    pub(crate) step: f64,
    /// `depth_scale` written to camera.json.
    pub(crate) declared_units: f64,
}

impl Default for Scene {
    fn default() -> Self {
        Self { frames: 6, step: 0.01, declared_units: UNITS }
    }
}

/// Time of a frame [s].
pub(crate) fn stamp(frame: usize) -> String {
    format!("{:.6}", 100.0 + 0.04 * frame as f64)
}

impl Scene {
    /// Write the sequence in the TUM layout with camera.json and ground truth.
    pub(crate) fn write(&self, folder: &Path) {
        for part in ["rgb", "depth"] {
            fs::create_dir_all(folder.join(part)).expect("a folder");
        }
        let (mut colours, mut depths, mut truth) = (String::new(), String::new(), String::new());
        for frame in 0..self.frames {
            let time = stamp(frame);
            let x = self.step * frame as f64;
            let (colour, depth) = self.pictures(x);
            write_colour(&folder.join(format!("rgb/{time}.png")), (WIDTH, HEIGHT), &colour);
            write_depth(&folder.join(format!("depth/{time}.png")), &depth);
            writeln!(colours, "{time} rgb/{time}.png").expect("memory");
            writeln!(depths, "{time} depth/{time}.png").expect("memory");
            writeln!(truth, "{time} {x:.6} 0 {:.6} 0 0 0 1", 0.3 * x).expect("memory");
        }
        fs::write(folder.join("rgb.txt"), colours).expect("room");
        fs::write(folder.join("depth.txt"), depths).expect("room");
        fs::write(folder.join("groundtruth.txt"), truth).expect("room");
        let camera = format!(
            "{{\"width\": {WIDTH}, \"height\": {HEIGHT}, \"fx\": {FOCAL}, \"fy\": {FOCAL}, \
             \"cx\": 24, \"cy\": 18, \"pixel_centre\": 0.5, \"depth_scale\": {}, \"fps\": 25}}",
            self.declared_units
        );
        fs::write(folder.join("camera.json"), camera).expect("room");
    }

    /// Colour bytes and depth units seen from `(x, 0, 0.3 x)`.
    fn pictures(&self, x: f64) -> (Vec<u8>, Vec<u16>) {
        let (mut colour, mut depth) = (Vec::new(), Vec::new());
        for row in 0..HEIGHT {
            for column in 0..WIDTH {
                let across = (column as f64 + 0.5 - 24.0) / FOCAL;
                let down = (row as f64 + 0.5 - 18.0) / FOCAL;
                // A back wall at z = 1.6, a wall on the right that comes towards the camera, and a
                // floor 0.35 m below it.
                let back = 1.6 - 0.3 * x;
                let right = (0.9 - x + 0.15 * x) / (across + 0.5);
                let floor = if down > 0.0 { 0.35 / down } else { f64::INFINITY };
                let z = if across > -0.4 { back.min(right) } else { back }.min(floor);
                let point = [x + across * z, down * z, 0.3 * x + z];
                colour.extend(texture(point));
                depth.push((z * UNITS).round() as u16);
            }
        }
        (colour, depth)
    }
}

/// A smooth pattern without repetition in the picture.
fn texture([x, y, z]: [f64; 3]) -> [u8; 3] {
    let value = |phase: f64| {
        let wave = (9.0 * x + phase).sin() * (13.0 * y - phase).cos() + (5.0 * z + 11.0 * y).sin();
        (127.5 + 50.0 * wave) as u8
    };
    [value(0.0), value(1.3), value(2.1)]
}

/// An 8-bit RGB PNG.
pub(crate) fn write_colour(path: &Path, (width, height): (usize, usize), bytes: &[u8]) {
    write_png(path, (width, height), png::ColorType::Rgb, png::BitDepth::Eight, bytes);
}

/// A 16-bit grey PNG of the scene's size.
pub(crate) fn write_depth(path: &Path, units: &[u16]) {
    let bytes: Vec<u8> = units.iter().flat_map(|u| u.to_be_bytes()).collect();
    let (colour, bits) = (png::ColorType::Grayscale, png::BitDepth::Sixteen);
    write_png(path, (WIDTH, HEIGHT), colour, bits, &bytes);
}

fn write_png(
    path: &Path,
    (width, height): (usize, usize),
    colour: png::ColorType,
    bits: png::BitDepth,
    bytes: &[u8],
) {
    let file = fs::File::create(path).expect("a file");
    let mut encoder = png::Encoder::new(file, width as u32, height as u32);
    encoder.set_color(colour);
    encoder.set_depth(bits);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(bytes).expect("pixels");
}

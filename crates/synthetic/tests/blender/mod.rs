//! The Blender script: its layout opens, and true depth and poses reproject frames onto each other.

use crate::support::Scratch;
use i2slam_dataset::{OpenOptions, Sequence};
use i2slam_geometry::Camera;
use std::process::Command;

const SCRIPT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/blender/render_sequence.py");

#[test]
#[ignore = "needs a Python with bpy and numpy (I2SLAM_BPY_PYTHON names it)"]
fn the_script_writes_a_sequence_with_its_truth() {
    let python = std::env::var("I2SLAM_BPY_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let scratch = Scratch::new("blender");
    std::fs::create_dir_all(&scratch.0).expect("a folder");
    let size = ["--frames", "4", "--width", "64", "--height", "48", "--samples", "8"];
    let mut script = Command::new(&python);
    script.arg(SCRIPT).arg("--out").arg(scratch.0.join("room")).args(size);
    let ran = script.output().expect("python starts");
    assert!(ran.status.success(), "{}", String::from_utf8_lossy(&ran.stderr));
    let options = OpenOptions { minimum_gap: 0.0, ..OpenOptions::default() };
    let sequence = Sequence::open(&scratch.0.join("room"), &options).expect("a sequence");
    assert_eq!((sequence.len(), sequence.camera.width), (4, 64));
    for folder in ["sharp/000003.png", "hdr/000003.exr", "groundtruth_shutter.txt", "exposure.csv"]
    {
        assert!(scratch.0.join("room").join(folder).is_file(), "{folder}");
    }
    let [right, inverse] = [false, true].map(|inverse| depth_error(&sequence, inverse));
    assert!(right < 0.02 && inverse > 2.0 * right, "{right} m, {inverse} m with inverse poses");
}

/// Median difference of the depth of frame 0, carried to frame 3, from the depth there [m].
fn depth_error(sequence: &Sequence, inverse: bool) -> f64 {
    let truth = sequence.true_trajectory().expect("poses");
    let (from, to) = (truth[0].world_from_camera, truth[3].world_from_camera);
    let move_by = if inverse { from.inverse() * to } else { to.inverse() * from };
    let [first, last] =
        [0, 3].map(|i| sequence.load(i).expect("a frame").depth.expect("depth").image);
    let camera = sequence.camera;
    let mut errors: Vec<f64> = (0..first.pixels())
        .filter(|&i| first.data[i] > 0.0)
        .filter_map(|i| {
            let (u, v) = Camera::<f64>::pixel_centre(i % first.width, i / first.width);
            let point = move_by * camera.unproject(u, v, f64::from(first.data[i]));
            let (u, v) = camera.project(point);
            let inside = u >= 0.0 && v >= 0.0 && u < last.width as f64 && v < last.height as f64;
            let there = inside.then(|| last.at(0, u as usize, v as usize))?;
            (there > 0.0).then(|| (f64::from(there) - point.z).abs())
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    errors.get(errors.len() / 2).copied().unwrap_or(f64::INFINITY)
}

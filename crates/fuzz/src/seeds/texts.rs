//! Settings, lists, trajectories and camera files.

use super::picture::{SIZE, colour, depth};
use super::scene::{INTRINSICS, trajectory, words};
use super::{NamedSeed, colmap, files};
use crate::corpus::Files;
use i2slam::Config;
use i2slam_synthetic::Spec;

pub(super) fn seeds() -> Vec<NamedSeed> {
    let transforms = r#"{"fl_x": 20, "fl_y": 20, "cx": 12, "cy": 9, "w": 24, "h": 18, "frames": [
 {"file_path": "images/0.png", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]}]}"#;
    let line = format!("# fx fy cx cy k1 k2 p1 p2\n{} 0.1 -0.01 0 0\n", words(&INTRINSICS));
    let own = r#"{"width": 24, "height": 18, "fx": 20, "fy": 20, "cx": 12, "cy": 9,
 "pixel_centre": 0.5, "distortion": [0.1, 0, 0, 0, 0], "depth_scale": 5000}"#;
    let short = "preset = \"paper-tum\"\n[map]\nkind = \"gaussian\"\n[mapping]\niterations = 7\n";
    vec![
        ("camera", "own", camera("camera.json", own.as_bytes())),
        ("camera", "line", camera("calibration.txt", line.as_bytes())),
        ("camera", "transforms", camera("transforms.json", transforms.as_bytes())),
        ("camera", "colmap-text", camera("cameras.txt", b"1 SIMPLE_RADIAL 24 18 20 12 9 0.1\n")),
        ("camera", "colmap-binary", camera("cameras.bin", &colmap::cameras())),
        ("trajectory", "tum", files([("trajectory.txt", trajectory(4).as_bytes())])),
        ("frame-list", "list", files([("frames.txt", b"# Source: none\n3\n8 # last\n\n12\n")])),
        ("config", "whole", files([("config.toml", Config::default().to_toml().as_bytes())])),
        ("config", "short", files([("config.toml", short.as_bytes())])),
        ("synth-spec", "whole", files([("spec.toml", Spec::default().to_toml().as_bytes())])),
    ]
}

/// A camera file, and two frames without one.
fn camera(name: &str, bytes: &[u8]) -> Files {
    let mut all = files([
        ("frames/colour/0.png", &colour(SIZE, 0)),
        ("frames/colour/1.png", &colour(SIZE, 1)),
        ("frames/depth/0.png", &depth(SIZE, 5000)),
        ("frames/depth/1.png", &depth(SIZE, 5000)),
    ]);
    all.insert(format!("lens/{name}"), bytes.to_vec());
    all
}

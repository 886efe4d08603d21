//! What lies beside the page.

use std::fmt::Write;

/// Names and what they hold, for readers who see such a folder for the first time.
const FILES: [(&str, &str); 14] = [
    ("trajectory.txt", "Camera path, TUM format, world from camera, mid-exposure"),
    ("trajectory_shutter.txt", "Poses at shutter open and close"),
    ("frames.csv", "Frame by frame: exposure, white balance, blur, losses, times, size of the map"),
    ("camera_response.csv", "The response curve"),
    ("map.ply", "The map for 3D Gaussian viewers such as SuperSplat"),
    ("map.i2slam", "The map in full precision and range"),
    ("metrics.json", "The figures of the run, as at the top of this page, for programs"),
    ("renders/sharp", "Pictures without blur, from the middle of each exposure"),
    ("renders/blurred", "What formation predicts for the pictures taken"),
    ("renders/hdr", "Linear radiance (OpenEXR)"),
    ("renders/depth", "Depth, 16 bit, 5000 = 1 m"),
    ("config.toml", "All settings, for <code>--config</code>"),
    ("input.json", "The dataset, and how it was read"),
    (
        "camera.json, state.json",
        "Camera of the renders; what else <code>i2slam render</code> reads",
    ),
];

/// A row for each that is there; `there` is asked by name.
pub(super) fn rows(there: impl Fn(&str) -> bool) -> String {
    let mut out = String::new();
    for (names, meaning) in FILES {
        if names.split(", ").all(&there) {
            // Writing to a string cannot fail.
            writeln!(out, "<tr><td><code>{names}</code></td><td>{meaning}</td></tr>").ok();
        }
    }
    out
}

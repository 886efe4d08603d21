//! What is said of a run that has ended.

use super::camera::focal_length_line;
use crate::output::{counted, say};
use i2slam_result::{Metrics, UnitOfLength};
use std::path::Path;

/// The run in a few lines.
pub(super) fn summarise(metrics: &Metrics, map: &str, folder: &Path, readout_searched: bool) {
    let unfinished = if metrics.complete { "" } else { " (ended early)" };
    let frames = counted(metrics.frames_given, "frame");
    say(&format!("{} of {frames} tracked{unfinished}, {map}", metrics.tracked));
    if let Some(error) = metrics.ate_rmse_m {
        let centimetres = error * 100.0;
        let digits = if centimetres < 0.1 { 4 } else { 2 };
        say(&format!(
            "trajectory error {centimetres:.digits$} cm (ATE RMSE over {}{})",
            counted(metrics.ate_poses, "pose"),
            if metrics.ate_scale_aligned { ", scale aligned" } else { "" }
        ));
    }
    if let Some(psnr) = metrics.psnr_sharp_db {
        say(&format!("sharp renders {psnr:.2} dB against the true sharp pictures"));
    }
    if metrics.unit_of_length == UnitOfLength::Unknown {
        say("unit of length: unknown, pictures alone do not tell the scale");
    }
    if let Some(assumed) = metrics.focal_length_assumed_px {
        let found = (metrics.focal_length_px, metrics.horizontal_fov_deg);
        say(&focal_length_line(found, None, assumed));
    }
    if let Some([k1, k2]) = metrics.lens_distortion {
        say(&format!("lens distortion: k1 {k1:.4}, k2 {k2:.4}, found in the pictures and removed"));
    }
    if metrics.rolling_shutter_readout_s != 0.0 {
        let milliseconds = 1e3 * metrics.rolling_shutter_readout_s;
        say(&format!("rolling shutter: rows read in {milliseconds:.1} ms"));
    } else if readout_searched {
        say("rolling shutter: none found, rows read at once (0.0 ms)");
    }
    let memory = metrics.peak_memory_bytes.map(|bytes| format!(", {} MB", bytes / 1_000_000));
    say(&format!(
        "{:.2} s per frame, {:.0} s in all{}",
        metrics.seconds_per_frame,
        metrics.seconds,
        memory.unwrap_or_default()
    ));
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    say(&format!("results in {}", absolute.display()));
    let report = absolute.join("report.html");
    if report.is_file() {
        say(&report.display().to_string());
    }
}

//! `report.html`: a self-contained page with pictures, plots and figures of a run, for readers who
//! see such a system for the first time.

mod evaluation;
mod gallery;
mod headline;
mod plots;
#[cfg(test)]
mod tests;

pub use evaluation::{EvaluationSection, EvaluationSource, GroundTruthSource, insert_evaluations};
pub use gallery::Comparison;

use crate::html::{STYLE, escape, fill};
use crate::{FrameFiles, Metrics, NoViewer, ResultError, VIEWER_FILE};
use i2slam::geometry::StampedPose;
use i2slam::{FrameEstimate, Reconstruction, Warning};
use i2slam_storage::OutputFolder;
use std::fmt::Write;

const TEMPLATE: &str = include_str!("template.html");
const SCRIPT: &str = include_str!("script.js");

/// Contents of the page.
#[derive(Clone, Copy, Debug)]
pub struct Report<'a> {
    /// Name of the sequence.
    pub title: &'a str,
    /// The run.
    pub reconstruction: &'a Reconstruction,
    /// Its measurements.
    pub metrics: &'a Metrics,
    /// Ground truth aligned to the estimate, in the estimate's world; empty if unknown.
    pub ground_truth: &'a [StampedPose],
    /// Length of the estimate's unit by the ground truth \[m\].
    pub metres_per_unit: f64,
    /// True exposures as (stream index, exposure in any unit); empty if unknown.
    pub true_exposure: &'a [(usize, f64)],
    /// Pictures to show.
    pub comparisons: &'a [Comparison],
    /// Files of the pictures taken.
    pub files: &'a FrameFiles,
    /// Size of the viewer page beside the report [bytes], or why there is none.
    pub viewer: Result<usize, NoViewer>,
}

impl Report<'_> {
    /// The page; it lists those files of the folder for which `exists` is true.
    pub fn html(&self, exists: impl Fn(&str) -> bool) -> String {
        let values = [
            ("title", escape(self.title)),
            ("style", STYLE.to_owned()),
            ("script", SCRIPT.to_owned()),
            ("lead", headline::lead(self)),
            ("cards", headline::cards(self.metrics)),
            ("warnings", warning_section(&self.metrics.warnings)),
            ("gallery", gallery::gallery(self)),
            ("viewer", gallery::viewer(self, exists(VIEWER_FILE))),
            (
                "brackets",
                gallery::brackets(self.comparisons, self.reconstruction.config.formation.tone),
            ),
            ("trajectory", plots::trajectory(self)),
            ("tone", plots::tone(self)),
            ("motion", plots::blur(self)),
            ("work", plots::statistics(self)),
            ("files", file_rows(exists)),
            ("settings", escape(&self.reconstruction.config.to_toml())),
            ("version", escape(&self.metrics.version)),
        ];
        fill(TEMPLATE, &values)
    }

    /// Writes `report.html`; it comes last, because it lists the other files.
    pub fn save(&self, folder: &OutputFolder) -> Result<(), ResultError> {
        Ok(folder.write_text("report.html", &self.html(|name| folder.has(name)))?)
    }
}

/// Selects at most `count` frames, the most blurred of each of so many equal parts of the sequence.
/// Returns ascending indices into `frames`.
pub fn frames_to_show(frames: &[FrameEstimate], count: usize) -> Vec<usize> {
    let parts = count.min(frames.len());
    let most_blurred = |part: usize| {
        let (from, to) = (part * frames.len() / parts, (part + 1) * frames.len() / parts);
        (from..to).max_by(|&a, &b| frames[a].blur_length.total_cmp(&frames[b].blur_length))
    };
    (0..parts).filter_map(most_blurred).collect()
}

/// Number of warnings that are shown without unfolding.
const UNFOLDED: usize = 6;

/// The list of warnings; empty if there are none.
fn warning_section(warnings: &[Warning]) -> String {
    if warnings.is_empty() {
        return String::new();
    }
    let (open, folded) = warnings.split_at(warnings.len().min(UNFOLDED));
    let mut out = format!(
        "<section id=\"warnings\">\n<h2>Warnings</h2>\n<ul class=\"warnings\">{}</ul>",
        warning_items(open)
    );
    if !folded.is_empty() {
        let (count, items) = (folded.len(), warning_items(folded));
        write!(
            out,
            "<details><summary>{count} more</summary><ul class=\"warnings\">{items}</ul></details>"
        )
        .ok();
    }
    out + "\n</section>"
}

fn warning_items(warnings: &[Warning]) -> String {
    let item = |warning: &Warning| {
        let time = warning.time_s.map(|time| format!(" <small>at {time:.2} s</small>"));
        format!("<li>{}{}</li>", escape(&warning.text), time.unwrap_or_default())
    };
    warnings.iter().map(item).collect()
}

/// Files of a result with their contents.
const FILES: [(&str, &str); 17] = [
    ("trajectory.txt", "Camera path, TUM format, world from camera, mid-exposure"),
    ("trajectory_online.txt", "Camera path as it was known when the frames came"),
    ("trajectory_shutter.txt", "Poses at shutter open and close"),
    (
        "frames.csv",
        "Frame by frame: exposure, white balance, blur, losses, times, size of the map, file",
    ),
    ("camera_response.csv", "The response curve"),
    (VIEWER_FILE, "The map in 3D, for a browser"),
    (
        "map.ply",
        "The map for programs that read 3D Gaussians (for SuperSplat and PlayCanvas: \
         <code>i2slam export --format ply</code>)",
    ),
    ("map.i2slam", "The map in full precision and range"),
    ("metrics.json", "The figures of the run, as at the top of this page, for programs"),
    ("renders/sharp", "Pictures without blur, from the middle of each exposure"),
    ("renders/blurred", "What formation predicts for the pictures taken"),
    ("renders/hdr", "Linear radiance (OpenEXR)"),
    ("renders/depth", "Depth, 16 bit, 5000 = 1 m"),
    ("renders/opacity", "White where the map was seen, black where it shows nothing"),
    ("config.toml", "All settings, for <code>--config</code>"),
    ("input.json", "The dataset, and how it was read"),
    (
        "camera.json, state.json",
        "Camera of the renders; what else <code>i2slam render</code> reads",
    ),
];

/// A table row for every file that exists.
fn file_rows(exists: impl Fn(&str) -> bool) -> String {
    let mut out = String::new();
    for (names, meaning) in FILES {
        if names.split(", ").all(&exists) {
            let links: Vec<String> = names
                .split(", ")
                .map(|name| format!("<a href=\"{name}\"><code>{name}</code></a>"))
                .collect();
            // Writing to a string cannot fail.
            writeln!(out, "<tr><td>{}</td><td>{meaning}</td></tr>", links.join(", ")).ok();
        }
    }
    out
}

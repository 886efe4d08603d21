//! `report.html`: one self-contained page that shows what a run found, for someone who sees such
//! a system for the first time.

mod axis;
mod evaluation;
mod files;
mod gallery;
mod headline;
mod picture;
mod plot;
mod plots;
#[cfg(test)]
mod tests;
mod warnings;

pub use axis::Axis;
pub use evaluation::{EvaluationSection, EvaluationSource, TruthSource, put_evaluations};
pub use gallery::Comparison;

use super::{ExportError, Metrics, ResultFolder, Storage};
use i2slam::geometry::StampedPose;
use i2slam::{FrameEstimate, Reconstruction};

const TEMPLATE: &str = include_str!("template.html");
/// The style sheet of this project's pages.
pub const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("script.js");

/// What the page is made of.
#[derive(Clone, Copy, Debug)]
pub struct Report<'a> {
    /// Name of the sequence.
    pub title: &'a str,
    /// The run.
    pub reconstruction: &'a Reconstruction,
    /// Its figures.
    pub metrics: &'a Metrics,
    /// Ground truth laid onto the estimate, in the estimate's world; empty if unknown.
    pub ground_truth: &'a [StampedPose],
    /// True exposures as (stream index, exposure in any unit); empty if unknown.
    pub true_exposure: &'a [(usize, f64)],
    /// Pictures to show.
    pub comparisons: &'a [Comparison],
}

impl Report<'_> {
    /// The page; `there` tells which files lie beside it.
    pub fn html(&self, there: impl Fn(&str) -> bool) -> String {
        let values = [
            ("title", escape(self.title)),
            ("style", STYLE.to_owned()),
            ("script", SCRIPT.to_owned()),
            ("lead", headline::lead(self)),
            ("cards", headline::cards(self.metrics)),
            ("warnings", warnings::section(&self.metrics.warnings)),
            ("gallery", gallery::gallery(self)),
            ("brackets", gallery::brackets(self.comparisons)),
            ("trajectory", plots::trajectory(self)),
            ("tone", plots::tone(self)),
            ("motion", plots::motion(self)),
            ("work", plots::work(self)),
            ("files", files::rows(there)),
            ("settings", escape(&self.reconstruction.config.to_toml())),
            ("version", escape(&self.metrics.version)),
        ];
        fill(TEMPLATE, &values)
    }

    /// Write the page as `report.html`, last of all files: it lists those that it finds there.
    pub fn save<S: Storage>(&self, folder: &ResultFolder<S>) -> Result<(), ExportError> {
        folder.write_text("report.html", &self.html(|name| folder.path().join(name).exists()))
    }
}

/// At most `count` frames worth showing: the sequence is cut into equal parts, and each gives
/// its most blurred frame. Returns positions in `frames`, ascending.
pub fn frames_to_show(frames: &[FrameEstimate], count: usize) -> Vec<usize> {
    let parts = count.min(frames.len());
    let most_blurred = |part: usize| {
        let (from, to) = (part * frames.len() / parts, (part + 1) * frames.len() / parts);
        (from..to).max_by(|&a, &b| frames[a].blur_length.total_cmp(&frames[b].blur_length))
    };
    (0..parts).filter_map(most_blurred).collect()
}

/// Replaces each `{{key}}` of the template once, left to right; values are not searched again.
fn fill(template: &str, values: &[(&str, String)]) -> String {
    let mut page = String::new();
    let mut rest = template;
    while let Some((before, after)) = rest.split_once("{{") {
        page += before;
        let Some((key, after)) = after.split_once("}}") else { break };
        page += values.iter().find(|(name, _)| *name == key).map_or("", |(_, value)| value);
        rest = after;
    }
    page + rest
}

/// Text that may stand in HTML.
pub fn escape(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => escaped += "&amp;",
            '<' => escaped += "&lt;",
            '>' => escaped += "&gt;",
            '"' => escaped += "&quot;",
            other => escaped.push(other),
        }
    }
    escaped
}

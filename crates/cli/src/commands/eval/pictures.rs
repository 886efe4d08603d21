//! Renders against true pictures.

use super::failed;
use super::figure::{Figure, Row};
use super::frames::{Chosen, shortened};
use super::metrics::{self, Metric, Pair};
use super::reference::Reference;
use super::source::checksum;
use super::subject::Subject;
use crate::arguments::{Eval, Protocol};
use crate::failure::Failure;
use crate::output::counted;
use crate::picture::{at_size_of, read_depth, read_png};
use crate::progress::Progress;
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};

/// What was measured.
pub(super) struct Judged {
    metrics: &'static [Metric],
    /// Frame, and one number per metric.
    rows: Vec<(usize, Vec<Option<f64>>)>,
    missing: Vec<usize>,
    /// CRC-32 of every true picture, as `rows`.
    pub(super) checksums: Vec<u32>,
    /// The list that chose the frames.
    pub(super) list: Option<String>,
}

/// Measures every chosen frame.
pub(super) fn judge(
    arguments: &Eval,
    subject: &Subject,
    reference: &Reference,
    chosen: Chosen,
) -> Result<Judged, Failure> {
    if arguments.protocol == Protocol::Splatam && matches!(reference, Reference::Folder { .. }) {
        let message = "--protocol splatam needs true depth: give the dataset as --reference";
        return Err(Failure::Usage(message.to_owned()));
    }
    let metrics = metrics::of(arguments.protocol);
    let progress = Progress::new(chosen.frames.len(), false);
    let done = AtomicUsize::new(0);
    let row = |(frame, render): &(usize, std::path::PathBuf)| {
        let mut pair = pair(subject, reference, *frame, render)?;
        // Depth was drawn at the estimated pose.
        pair.depth = pair.depth.filter(|_| !arguments.optimise_poses);
        let values = metrics.iter().map(|metric| (metric.of)(&pair));
        let values: Result<Vec<_>, _> = values.collect();
        let values = values.map_err(|e| failed(render, e))?;
        let done = done.fetch_add(1, Ordering::Relaxed) + 1;
        progress.step("judging pictures", done, chosen.frames.len());
        Ok(((*frame, values), checksum(&pair.truth)))
    };
    let rows: Result<Vec<_>, Failure> = chosen.frames.par_iter().map(row).collect();
    progress.clear();
    let (rows, checksums) = rows?.into_iter().unzip();
    Ok(Judged { metrics, rows, checksums, missing: chosen.missing, list: chosen.list })
}

fn pair(
    subject: &Subject,
    reference: &Reference,
    frame: usize,
    render: &Path,
) -> Result<Pair, Failure> {
    let picture = read_png(render)?;
    let truth = reference.load(frame)?;
    let size = (truth.colour.width, truth.colour.height);
    let sizes = || {
        format!(
            "{}x{} pixels, its truth in {} has {}x{}",
            picture.width,
            picture.height,
            reference.path().display(),
            size.0,
            size.1
        )
    };
    // Renders of a run may be smaller than a reference that was made for the recorded size.
    let colour = match subject {
        Subject::Result(_) => at_size_of(truth.colour, &picture),
        _ => (size == (picture.width, picture.height)).then_some(truth.colour),
    };
    let colour = colour.ok_or_else(|| failed(render, sizes()))?;
    let valid = truth.depth.as_ref().map(|d| d.data.iter().map(|z| *z > 0.0).collect::<Vec<_>>());
    let valid = valid.filter(|valid| valid.len() == colour.pixels());
    let drawn = subject.result().map(|r| r.join(format!("renders/depth/{frame:06}.png")));
    let drawn = drawn.filter(|file| file.is_file()).map(|file| read_depth(&file)).transpose()?;
    Ok(Pair { picture, truth: colour, depth: drawn.zip(truth.depth), valid })
}

impl Judged {
    /// The frames judged.
    pub(super) fn frames(&self) -> Vec<usize> {
        self.rows.iter().map(|(frame, _)| *frame).collect()
    }

    /// Means over the frames where the number exists and is finite.
    pub(super) fn figures(&self) -> Vec<Figure> {
        let column = |i: usize| {
            let values = self.rows.iter().filter_map(move |(_, row)| row[i]);
            let finite: Vec<f64> = values.filter(|v| v.is_finite()).collect();
            (!finite.is_empty()).then(|| finite.iter().sum::<f64>() / finite.len() as f64)
        };
        let figure = |(i, m): (usize, &Metric)| Figure {
            key: m.key,
            label: m.label,
            unit: m.unit,
            decimals: m.decimals,
            value: column(i),
        };
        self.metrics.iter().enumerate().map(figure).collect()
    }

    /// Frames whose render equals the truth: their PSNR is infinite and in no mean.
    fn equal(&self) -> usize {
        self.rows.iter().filter(|(_, row)| row[0] == Some(f64::INFINITY)).count()
    }

    /// Name and value of everything that could be measured.
    pub(super) fn rows(&self) -> Vec<Row> {
        let list = self.list.as_ref().map(|list| format!(", list {list}")).unwrap_or_default();
        let count = self.rows.len().to_string();
        let mut rows = vec![Row { name: "frames judged".to_owned(), number: count, rest: list }];
        let known = self.figures().into_iter().filter(|figure| figure.value.is_some());
        rows.extend(known.map(|figure| figure.row()));
        rows
    }

    /// What a reader of the table must know.
    pub(super) fn remarks(&self) -> Vec<String> {
        let mut remarks = Vec::new();
        if !self.missing.is_empty() {
            let (count, names) = (self.missing.len(), shortened(&self.missing));
            let count = counted(count, "frame");
            remarks.push(format!("warning: {count} without a render not judged ({names})"));
        }
        if self.equal() > 0 {
            let words = match self.equal() {
                1 => "1 render equals its".to_owned(),
                count => format!("{count} renders equal their"),
            };
            remarks.push(format!("note: {words} truth, in no mean of PSNR"));
        }
        remarks
    }

    pub(super) fn json(&self) -> Map<String, Value> {
        let mut object: Map<String, Value> = self.figures().iter().map(Figure::json).collect();
        object.insert("sharp_frames".to_owned(), self.rows.len().into());
        object.insert("list".to_owned(), json!(self.list));
        object.insert("equal_frames".to_owned(), self.equal().into());
        object.insert("missing_frames".to_owned(), json!(self.missing));
        let frame = |(index, row): &(usize, Vec<Option<f64>>)| {
            let values = self.metrics.iter().zip(row).map(|(m, v)| (m.key.to_owned(), json!(v)));
            let mut frame: Map<String, Value> = values.collect();
            frame.insert("index".to_owned(), (*index).into());
            Value::Object(frame)
        };
        let frames = self.rows.iter().map(frame).collect();
        object.insert("frames".to_owned(), Value::Array(frames));
        object
    }
}

//! A run whose frames are done, written to its folder.

use super::camera::FoundCamera;
use super::draw::Drawing;
use super::drive::Tracked;
use super::figures::{self, Figures};
use super::{Job, earlier};
use crate::failure::Failure;
use crate::progress::Progress;
use crate::truth::Truth;
use i2slam::Warning;
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam_result::report::Report;
use i2slam_result::{ExportError, Input, Layout, Metrics, ResultFolder, save, save_metrics};
use std::path::PathBuf;

/// A run whose frames are done.
pub(super) struct Finished<'a> {
    pub(super) job: &'a Job,
    pub(super) folder: &'a ResultFolder,
    pub(super) sequence: &'a Sequence,
    pub(super) truth: &'a Truth,
    pub(super) tracked: Tracked,
}

/// What came of writing.
pub(super) struct Written {
    pub(super) metrics: Metrics,
    /// The map in words.
    pub(super) map: String,
    /// Where it was written.
    pub(super) folder: PathBuf,
    pub(super) problems: Vec<String>,
}

impl Finished<'_> {
    /// What opens the sequence as it was used.
    fn opened(&self) -> OpenOptions {
        let lens = self.tracked.camera.as_ref().and_then(FoundCamera::lens);
        let before = &self.job.open;
        OpenOptions {
            estimated_camera: lens.copied().or(before.estimated_camera),
            ..before.clone()
        }
    }

    /// All that was warned of, with the stamps of frames.
    fn warnings(&self, progress: &Progress) -> Vec<Warning> {
        let stamp = |index: usize| {
            let entries = &self.sequence.entries;
            let place = entries.binary_search_by_key(&index, |entry| entry.index).ok()?;
            Some(entries[place].timestamp)
        };
        progress.warnings().into_iter().map(|warning| warning.timed(stamp)).collect()
    }

    /// The folder that is written to: a run that has not come as far as an earlier one leaves that
    /// alone.
    fn place(&self, progress: &Progress) -> Result<ResultFolder, Failure> {
        let out = self.folder.path();
        let tracked = self.tracked.reconstruction.frames.iter().filter(|f| f.tracked).count();
        if self.tracked.complete || !earlier::is_better(out, tracked) {
            return Ok(self.folder.clone());
        }
        let beside = earlier::beside(out);
        progress.warn(format!(
            "this run ended early: the earlier result in {} stays, and what there is of this one is \
             in {}",
            out.display(),
            beside.display()
        ));
        Ok(ResultFolder::create(&beside)?)
    }

    /// What matters most first: poses and map, then figures, then pictures, then the page.
    pub(super) fn write(self, progress: &mut Progress) -> Result<Written, Failure> {
        let reconstruction = &self.tracked.reconstruction;
        let folder = &self.place(progress)?;
        let mut problems: Vec<String> = self.tracked.problem.iter().cloned().collect();
        let mut note = |result: Result<(), ExportError>| {
            problems.extend(result.err().map(|error| error.to_string()));
        };
        if self.job.overwrite {
            note(Layout::of_result().remove(folder.path()));
        }
        save(folder, reconstruction).into_iter().for_each(|error| note(Err(error)));
        note(Input::new(&self.job.dataset, &self.opened()).save(folder));
        let mut figures = Figures::of(&self.tracked, self.truth);
        for warning in &figures.warnings {
            progress.warn(warning.as_str());
        }
        figures.metrics.warnings = self.warnings(progress);
        note(save_metrics(folder, &figures.metrics));
        let drawing = Drawing {
            sequence: self.sequence,
            truth: self.truth,
            reconstruction,
            draw: self.job.draw,
        };
        let drawn = drawing.run(folder, progress);
        drawn.failure.into_iter().for_each(|error| note(Err(error)));
        drawn.measures.fill(&mut figures.metrics);
        figures.metrics.peak_memory_bytes = figures::peak_memory();
        note(save_metrics(folder, &figures.metrics));
        let report = Report {
            title: self.job.title.unwrap_or(&self.sequence.name),
            reconstruction,
            metrics: &figures.metrics,
            ground_truth: &figures.truth_in_world,
            true_exposure: &self.truth.exposure,
            comparisons: &drawn.comparisons,
        };
        note(report.save(folder));
        let map = reconstruction.map.to_string();
        let folder = folder.path().to_owned();
        Ok(Written { metrics: figures.metrics, map, folder, problems })
    }
}

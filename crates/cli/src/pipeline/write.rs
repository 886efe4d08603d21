//! A run whose frames are done, written to its folder.

use super::draw::Drawing;
use super::figures::{self, Figures};
use super::{Job, earlier};
use crate::failure::Failure;
use crate::progress::Progress;
use crate::truth::Truth;
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam::{RunOutcome, Warning};
use i2slam_result::report::Report;
use i2slam_result::{ExportError, Input, Layout, Metrics, ResultFolder, save, save_metrics};
use std::path::PathBuf;

/// A run whose frames are done.
pub(super) struct Finished<'a> {
    pub(super) job: &'a Job,
    pub(super) folder: &'a ResultFolder,
    pub(super) sequence: &'a Sequence,
    pub(super) truth: &'a Truth,
    pub(super) outcome: RunOutcome,
    /// Warnings so far, those of the outcome included.
    pub(super) warnings: Vec<Warning>,
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
        let lens = self.outcome.camera.as_ref().and_then(|camera| camera.lens);
        let before = &self.job.options.open;
        OpenOptions { estimated_camera: lens.or(before.estimated_camera), ..before.clone() }
    }

    /// The folder to write to: an earlier result that is better than this run stays, and this one
    /// goes beside it.
    fn output_folder(&mut self, progress: &Progress) -> Result<ResultFolder, Failure> {
        let out = self.folder.path();
        let tracked = self.outcome.reconstruction.frames.iter().filter(|f| f.tracked).count();
        if self.outcome.complete || !earlier::is_better(out, tracked) {
            return Ok(self.folder.clone());
        }
        let beside = earlier::beside(out);
        let warning = format!(
            "this run ended early: the earlier result in {} stays, and what there is of this one is \
             in {}",
            out.display(),
            beside.display()
        );
        progress.warn(&warning);
        self.warnings.push(warning.into());
        Ok(ResultFolder::create(&beside)?)
    }

    /// Writes everything, the most important first: poses and map, then figures, then pictures,
    /// then the report.
    pub(super) fn write(mut self, progress: &Progress) -> Result<Written, Failure> {
        let folder = &self.output_folder(progress)?;
        let reconstruction = &self.outcome.reconstruction;
        let problem = self.outcome.problem.take().map(Failure::from);
        let mut problems: Vec<String> =
            problem.iter().filter_map(Failure::message).map(str::to_owned).collect();
        let mut note = |result: Result<(), ExportError>| {
            problems.extend(result.err().map(|error| error.to_string()));
        };
        if self.job.overwrite {
            note(Layout::of_result().remove(folder.path()));
        }
        save(folder, reconstruction).into_iter().for_each(|error| note(Err(error)));
        note(Input::new(&self.job.dataset, &self.opened()).save(folder));
        let mut figures = Figures::of(&self.outcome, self.truth);
        figures.warnings.iter().for_each(|warning| progress.warn(warning));
        let later = figures.warnings.iter().map(|warning| Warning::from(warning.as_str()));
        figures.metrics.warnings = self.warnings.iter().cloned().chain(later).collect();
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

//! Result folder of a run, with the errors against ground truth.

use super::Job;
use super::pictures::PictureRenderer;
use crate::failure::Failure;
use crate::ground_truth::{GroundTruth, range_stops};
use crate::progress::Progress;
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam::geometry::StampedPose;
use i2slam::{RunOutcome, Warning};
use i2slam_eval::exposure::exposure_agreement;
use i2slam_eval::trajectory::Alignment;
use i2slam_result::report::Report;
use i2slam_result::{
    FolderContents, FolderLayout, Metrics, ResultError, ResultFolder, RunInput, save, save_metrics,
};
use std::fs;
use std::path::{Path, PathBuf};

/// A run whose frames are done.
pub(super) struct FinishedRun<'a> {
    pub(super) job: &'a Job<'a>,
    pub(super) folder: &'a ResultFolder,
    pub(super) sequence: &'a Sequence,
    pub(super) truth: &'a GroundTruth,
    pub(super) outcome: RunOutcome,
    /// Warnings so far, those of the outcome included.
    pub(super) warnings: Vec<Warning>,
}

/// Summary of a written run.
pub(super) struct WrittenRun {
    pub(super) metrics: Metrics,
    /// Description of the map.
    pub(super) map: String,
    /// Folder that was written.
    pub(super) folder: PathBuf,
    pub(super) problems: Vec<String>,
}

impl FinishedRun<'_> {
    /// Options that open the sequence as it was used.
    fn open_options(&self) -> OpenOptions {
        let lens = self.outcome.camera.as_ref().and_then(|camera| camera.lens);
        let before = &self.job.options.open;
        OpenOptions { estimated_camera: lens.or(before.estimated_camera), ..before.clone() }
    }

    /// The folder to write to: an earlier result that is better than this run stays, and this one
    /// goes beside it.
    fn output_folder(&mut self, progress: &Progress) -> Result<ResultFolder, Failure> {
        let out = self.folder.path();
        let tracked = self.outcome.reconstruction.frames.iter().filter(|f| f.tracked).count();
        let falls_short = !self.outcome.shortfalls.is_empty();
        if self.outcome.complete && !falls_short || !has_better_result(out, tracked) {
            return Ok(self.folder.clone());
        }
        let beside = partial_folder(out);
        let end = if self.outcome.complete { "found too little" } else { "ended early" };
        let warning = format!(
            "this run {end}: the earlier result in {} stays, and what there is of this one is \
             in {}",
            out.display(),
            beside.display()
        );
        progress.warn(&warning);
        self.warnings.push(warning.into());
        Ok(ResultFolder::create(&beside)?)
    }

    /// Writes everything, the most important first: poses and map, then measurements, then pictures,
    /// then the report.
    pub(super) fn write(mut self, progress: &Progress) -> Result<WrittenRun, Failure> {
        let folder = &self.output_folder(progress)?;
        let reconstruction = &self.outcome.reconstruction;
        let problem = self.outcome.problem.take().map(Failure::from);
        let mut problems: Vec<String> =
            problem.iter().filter_map(Failure::message).map(str::to_owned).collect();
        let mut note = |result: Result<(), ResultError>| {
            problems.extend(result.err().map(|error| error.to_string()));
        };
        if self.job.overwrite {
            note(FolderLayout::of_result().remove(folder.path()));
        }
        save(folder, reconstruction).into_iter().for_each(|error| note(Err(error)));
        note(RunInput::new(&self.job.dataset, &self.open_options()).save(folder));
        let mut measurements = Measurements::new(&self.outcome, self.truth);
        measurements
            .metrics
            .degrade(problem.iter().filter_map(Failure::message).map(str::to_owned));
        measurements.warnings.iter().for_each(|warning| progress.warn(warning));
        let later = measurements.warnings.iter().map(|warning| Warning::from(warning.as_str()));
        measurements.metrics.warnings = self.warnings.iter().cloned().chain(later).collect();
        note(save_metrics(folder, &measurements.metrics));
        let renderer = PictureRenderer {
            sequence: self.sequence,
            truth: self.truth,
            reconstruction,
            renders: self.job.renders,
        };
        let rendered = renderer.render(folder, progress);
        measurements.metrics.degrade(rendered.failure.iter().map(ToString::to_string));
        rendered.failure.into_iter().for_each(|error| note(Err(error)));
        rendered.metrics.write_to(&mut measurements.metrics);
        measurements.metrics.peak_memory_bytes = peak_memory();
        note(save_metrics(folder, &measurements.metrics));
        let report = Report {
            title: self.job.title.unwrap_or(&self.sequence.name),
            reconstruction,
            metrics: &measurements.metrics,
            ground_truth: &measurements.truth_in_world,
            true_exposure: &self.truth.exposure,
            comparisons: &rendered.comparisons,
        };
        note(report.save(folder));
        let map = reconstruction.map.to_string();
        let folder = folder.path().to_owned();
        Ok(WrittenRun { metrics: measurements.metrics, map, folder, problems })
    }
}

/// Smallest range of true exposures [stops]: below, a correlation would be one of noise.
const MIN_EXPOSURE_RANGE: f64 = 0.1;

/// Metrics, and the true poses aligned to the estimate.
struct Measurements {
    metrics: Metrics,
    truth_in_world: Vec<StampedPose>,
    /// Measurements that failed, with reasons.
    warnings: Vec<String>,
}

impl Measurements {
    fn new(outcome: &RunOutcome, truth: &GroundTruth) -> Self {
        let reconstruction = &outcome.reconstruction;
        let mut metrics = Metrics::of(reconstruction);
        metrics.complete = outcome.complete;
        metrics.degrade(outcome.shortfalls.clone());
        metrics.skipped = outcome.frames_skipped;
        metrics.frames_given = outcome.frames_given;
        metrics.seconds = outcome.seconds;
        metrics.seconds_per_frame = outcome.seconds / metrics.frames.max(1) as f64;
        metrics.peak_memory_bytes = peak_memory();
        if let Some(camera) = &outcome.camera {
            let estimated = camera.is_focal_length_estimated;
            metrics.camera_source = Some(camera.source.clone());
            metrics.focal_length_assumed_px = estimated.then_some(camera.assumed_focal_length);
            metrics.focal_length_deviation = camera.focal_length_deviation;
            metrics.lens_distortion = camera.lens.map(|lens| lens.distortion);
            if metrics.rolling_shutter_readout_s == 0.0 {
                metrics.rolling_shutter_readout_s = camera.rolling_shutter_readout;
            }
        }
        let mut measurements = Self { metrics, truth_in_world: Vec::new(), warnings: Vec::new() };
        measurements.measure_trajectory(outcome, truth);
        measurements.measure_exposure(outcome, truth);
        measurements
    }

    fn measure_trajectory(&mut self, outcome: &RunOutcome, truth: &GroundTruth) {
        let scaled = outcome.reconstruction.config.is_rgb();
        let alignment = if scaled { Alignment::Sim3 } else { Alignment::Se3 };
        self.metrics.ate_scale_aligned = scaled;
        match truth.trajectory_error(&outcome.reconstruction.trajectory(), alignment) {
            Ok(Some((error, aligned))) => {
                self.metrics.ate_rmse_m = Some(error.ate_rmse_m);
                self.metrics.ate_mean_m = Some(error.ate_mean_m);
                self.metrics.ate_poses = error.pairs;
                self.truth_in_world = aligned;
            }
            Ok(None) => {}
            Err(failure) => {
                let reason = failure.message().unwrap_or_default();
                self.warnings.push(format!("trajectory error not measured: {reason}"));
            }
        }
    }

    fn measure_exposure(&mut self, outcome: &RunOutcome, truth: &GroundTruth) {
        let reconstruction = &outcome.reconstruction;
        if !reconstruction.config.formation.tone || truth.exposure.is_empty() {
            return;
        }
        let pairs = reconstruction.frames.iter().filter_map(|frame| {
            let known = truth.exposure.iter().find(|(index, _)| *index == frame.index);
            known.map(|&(_, exposure)| (f64::from(frame.tone.exposure()), exposure))
        });
        let (estimate, due): (Vec<f64>, Vec<f64>) = pairs.unzip();
        if range_stops(&due) < MIN_EXPOSURE_RANGE {
            return;
        }
        match exposure_agreement(&estimate, &due) {
            Ok(agreement) => self.metrics.log_exposure_correlation = Some(agreement.pearson),
            Err(error) => self.warnings.push(format!("exposure not compared: {error}")),
        }
    }
}

/// Peak resident memory of the process [bytes]; Linux only.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

/// Whether a folder holds a result that is complete and not degraded, has more than `tracked`
/// frames, or whose `metrics.json` cannot be read.
fn has_better_result(folder: &Path, tracked: usize) -> bool {
    FolderLayout::of_result().contents(folder) == FolderContents::Own
        && saved_metrics(folder)
            .is_none_or(|earlier| is_sound(&earlier) || earlier.tracked > tracked)
}

/// Whether a result is complete and what was asked for.
fn is_sound(metrics: &Metrics) -> bool {
    metrics.complete && !metrics.degraded
}

/// Folder for a run that ended early, or is degraded, beside a better result: `NAME-partial`,
/// numbered if that holds anything else.
fn partial_folder(folder: &Path) -> PathBuf {
    let whole = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    let name = whole.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let numbered = |number: usize| match number {
        1 => whole.with_file_name(format!("{name}-partial")),
        number => whole.with_file_name(format!("{name}-partial-{number}")),
    };
    let is_free = |path: &PathBuf| match FolderLayout::of_result().contents(path) {
        FolderContents::Empty => !path.is_file(),
        FolderContents::Own => saved_metrics(path).is_some_and(|earlier| !is_sound(&earlier)),
        FolderContents::Other(_) | FolderContents::Foreign(_) => false,
    };
    (1..).map(numbered).find(is_free).unwrap_or(whole)
}

fn saved_metrics(folder: &Path) -> Option<Metrics> {
    serde_json::from_str(&fs::read_to_string(folder.join("metrics.json")).ok()?).ok()
}

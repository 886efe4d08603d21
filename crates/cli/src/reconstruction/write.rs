//! Result folder of a run, with the errors against ground truth.

use super::Job;
use super::pictures::PictureRenderer;
use crate::failure::Failure;
use crate::ground_truth::{GroundTruth, range_stops};
use crate::messages::displaced_files;
use crate::progress::Progress;
use crate::recording::RecordedRun;
use crate::taken_pictures::taken_pictures;
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam::geometry::StampedPose;
use i2slam::{RunOutcome, Warning};
use i2slam_eval::exposure::exposure_agreement;
use i2slam_eval::trajectory::Alignment;
use i2slam_result::report::Report;
use i2slam_result::{
    FrameFiles, Metrics, ResultError, RunInput, UnitOfLength, VIEWER_FILE, ViewerPage,
    load_metrics, save, save_metrics,
};
use i2slam_storage::OutputFolder;
use std::path::{Path, PathBuf};

/// A run whose frames are done.
pub(super) struct FinishedRun<'a> {
    pub(super) job: &'a Job<'a>,
    pub(super) folder: OutputFolder,
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
    /// Files of the frames without a pose.
    pub(super) not_placed: Vec<String>,
    pub(super) problems: Vec<String>,
}

impl FinishedRun<'_> {
    /// Options that open the sequence as it was used.
    fn open_options(&self) -> OpenOptions {
        let lens = self.outcome.camera.as_ref().and_then(|camera| camera.lens);
        let before = &self.job.options.open;
        OpenOptions { estimated_camera: lens.or(before.estimated_camera), ..before.clone() }
    }

    /// Writes everything, the most important first: poses and map, then measurements, then pictures,
    /// then the report.
    pub(super) fn write(mut self, progress: &Progress) -> Result<WrittenRun, Failure> {
        let folder = &self.folder;
        let reconstruction = &self.outcome.reconstruction;
        let problem = self.outcome.problem.take().map(Failure::from);
        let mut problems: Vec<String> =
            problem.iter().filter_map(Failure::message).map(str::to_owned).collect();
        let mut note = |result: Result<(), ResultError>| {
            problems.extend(result.err().map(|error| error.to_string()));
        };
        // From here on what is written survives the process.
        folder.keep();
        let files = FrameFiles::of(self.sequence, &self.job.dataset);
        save(folder, reconstruction, &files).into_iter().for_each(|error| note(Err(error)));
        note(RunInput::new(&self.job.dataset, &self.open_options()).save(folder));
        let mut measurements = Measurements::new(&self.outcome, self.sequence, self.truth);
        measurements
            .metrics
            .degrade(problem.iter().filter_map(Failure::message).map(str::to_owned));
        measurements.warnings.iter().for_each(|warning| progress.warn(warning));
        let later = measurements.warnings.iter().map(|warning| Warning::from(warning.as_str()));
        measurements.metrics.warnings = self.warnings.iter().cloned().chain(later).collect();
        // Until everything else is written, what there is counts as a part.
        measurements.metrics.complete = false;
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
        let budget = reconstruction.config.memory;
        if let Some(warning) = over_budget(measurements.metrics.peak_memory_bytes, budget) {
            progress.warn(&warning);
            measurements.metrics.warnings.push(Warning::from(warning.as_str()));
        }
        measurements.metrics.complete = self.outcome.complete;
        let title = self.job.title.unwrap_or(&self.sequence.name);
        let page = ViewerPage::of(title, reconstruction, &files);
        let page = page.html(taken_pictures(self.sequence));
        if let Ok(page) = &page {
            note(folder.write_text(VIEWER_FILE, page).map_err(ResultError::from));
        }
        let report = Report {
            title,
            reconstruction,
            metrics: &measurements.metrics,
            ground_truth: &measurements.truth_in_world,
            metres_per_unit: measurements.metres_per_unit,
            true_exposure: &self.truth.exposures(),
            comparisons: &rendered.comparisons,
            files: &files,
            viewer: page.map(|page| page.len()),
        };
        note(report.save(folder));
        if let Some(recording) = &self.job.recording {
            let mut load = taken_pictures(self.sequence);
            let run = RecordedRun {
                title,
                reconstruction,
                files: &files,
                has_times: !self.sequence.are_times_assumed,
                load_picture: &mut load,
            };
            note(recording.write(run).map_err(ResultError::from));
        }
        measurements.metrics.complete &= problems.is_empty();
        if let Err(error) = save_metrics(folder, &measurements.metrics) {
            measurements.metrics.complete = false;
            problems.push(error.to_string());
        }
        let map = reconstruction.map.to_string();
        let metrics = measurements.metrics;
        let folder = place(&mut self.folder, &metrics, &mut problems, progress);
        let not_placed = files.without_pose(&reconstruction.frames);
        Ok(WrittenRun { metrics, map, folder, not_placed, problems })
    }
}

/// Puts a result in place; one that is a part, or that cannot take the place of the earlier one,
/// goes beside.
fn place(
    folder: &mut OutputFolder,
    metrics: &Metrics,
    problems: &mut Vec<String>,
    progress: &Progress,
) -> PathBuf {
    let out = folder.path().to_owned();
    let why = match is_sound(metrics) || !has_better_result(folder, metrics.tracked) {
        true => match folder.commit() {
            Ok(committed) => {
                if let Some(displaced) = &committed.displaced {
                    progress.warn(&displaced_files(displaced));
                }
                return out;
            }
            Err(error) => {
                problems.push(error.to_string());
                "this result cannot be put in place"
            }
        },
        false if metrics.complete => "this run found too little",
        false => "this run ended early",
    };
    match folder.commit_beside("partial") {
        Ok(beside) => {
            let earlier = match folder.has_earlier_result() {
                true => format!("the earlier result in {}", out.display()),
                false => format!("what {} held", out.display()),
            };
            let beside_is = beside.display();
            progress.warn(&format!(
                "{why}: {earlier} stays, and what there is of this run is in {beside_is}"
            ));
            beside
        }
        Err(error) => {
            problems.push(error.to_string());
            out
        }
    }
}

/// Smallest range of true exposures [stops]: below, a correlation would be one of noise.
const MIN_EXPOSURE_RANGE: f64 = 0.1;
/// Ratio of lengths to the true ones from which the scale of depth is taken to be wrong.
const MAX_LENGTH_RATIO: f64 = 1.2;

/// Metrics, and the true poses aligned to the estimate.
struct Measurements {
    metrics: Metrics,
    truth_in_world: Vec<StampedPose>,
    /// Length of the estimate's unit by the truth \[m\].
    metres_per_unit: f64,
    /// Measurements that failed, with reasons.
    warnings: Vec<String>,
}

impl Measurements {
    fn new(outcome: &RunOutcome, sequence: &Sequence, truth: &GroundTruth) -> Self {
        let reconstruction = &outcome.reconstruction;
        let mut metrics = Metrics::of(reconstruction);
        metrics.complete = outcome.complete;
        metrics.degrade(outcome.shortfalls.clone());
        metrics.unordered = outcome.is_unordered;
        metrics.skipped = outcome.frames_skipped;
        metrics.frames_given = outcome.frames_given;
        let is_assumed =
            sequence.is_depth_scale_assumed && metrics.unit_of_length == UnitOfLength::Metre;
        metrics.depth_scale_assumed = is_assumed.then_some(sequence.depth_scale);
        metrics.seconds = outcome.seconds;
        metrics.seconds_per_frame = outcome.seconds / metrics.frames.max(1) as f64;
        metrics.peak_memory_bytes = peak_memory();
        metrics.camera_source = Some(absolute_source(outcome.camera_source.clone()));
        if let Some(camera) = &outcome.camera {
            let estimated = camera.is_focal_length_estimated;
            metrics.focal_length_assumed_px = estimated.then_some(camera.assumed_focal_length);
            metrics.focal_length_deviation = camera.focal_length_deviation;
            metrics.lens_distortion = camera.lens.map(|lens| lens.distortion);
            (metrics.depth_delay_s, metrics.depth_shift_px) =
                (camera.depth_delay, camera.depth_shift);
            if metrics.rolling_shutter_readout_s == 0.0 {
                metrics.rolling_shutter_readout_s = camera.rolling_shutter_readout;
            }
        }
        let mut measurements = Self {
            metrics,
            truth_in_world: Vec::new(),
            metres_per_unit: 1.0,
            warnings: Vec::new(),
        };
        measurements.measure_trajectory(outcome, sequence, truth);
        measurements.measure_exposure(outcome, truth);
        measurements
    }

    fn measure_trajectory(
        &mut self,
        outcome: &RunOutcome,
        sequence: &Sequence,
        truth: &GroundTruth,
    ) {
        let path = outcome.reconstruction.trajectory();
        if let Ok(count) = truth.frames_without_pose(sequence, &path) {
            self.metrics.ate_frames_without_pose = count;
        }
        let scaled = outcome.reconstruction.config.is_rgb();
        let alignment = if scaled { Alignment::Sim3 } else { Alignment::Se3 };
        self.metrics.ate_scale_aligned = scaled;
        match truth.trajectory_error(&path, alignment) {
            Ok(Some((error, aligned))) => {
                self.metrics.ate_rmse_m = Some(error.ate_rmse_m);
                self.metrics.ate_mean_m = Some(error.ate_mean_m);
                self.metrics.ate_poses = error.pairs;
                let scaled_error = truth.trajectory_error(&path, Alignment::Sim3).ok().flatten();
                // Of a path within its error the scale tells nothing.
                let better = scaled_error
                    .map(|(scaled_error, _)| scaled_error)
                    .filter(|scaled_error| 2.0 * scaled_error.ate_rmse_m < error.ate_rmse_m);
                let ratio = better.map_or(1.0, |e| e.truth_from_estimate.scale.recip());
                if !scaled && ratio.ln().abs() > MAX_LENGTH_RATIO.ln() {
                    let (given, fits) = (sequence.depth_scale, sequence.depth_scale * ratio);
                    self.warnings.push(format!(
                        "lengths are {ratio:.3} times the true ones: wrong depth scale? With {fits:.0} in place \
                         of {given} for one metre (--depth-scale) they would be right"
                    ));
                }
                self.truth_in_world = aligned;
                self.metres_per_unit = error.truth_from_estimate.scale;
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
        if !reconstruction.config.formation.tone || truth.tones.is_empty() {
            return;
        }
        let pairs = reconstruction.frames.iter().filter_map(|frame| {
            let known = truth.tones.iter().find(|tone| tone.frame == frame.index);
            known.map(|tone| (f64::from(frame.tone.exposure()), tone.exposure))
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

/// Source of a camera with an absolute path, where it is a file.
fn absolute_source(source: String) -> String {
    let path = Path::new(&source);
    let absolute = path.is_file().then(|| std::path::absolute(path).ok()).flatten();
    absolute.map_or(source, |path| path.display().to_string())
}

/// Memory over the budget that is worth a warning: this bounds it about.
const MIN_EXCESS: f64 = 1.05;

/// A warning if a run has taken more memory [bytes] than its budget [GB].
fn over_budget(peak: Option<u64>, budget: f64) -> Option<String> {
    let peak = peak? as f64 * 1e-9;
    (peak > MIN_EXCESS * budget).then(|| {
        format!(
            "{peak:.2} GB of memory were taken, more than the {budget} GB of --memory: only pictures wait \
             in a file, the map and its optimisation need the rest (--max-side makes both smaller)"
        )
    })
}

/// Peak resident memory of the process [bytes]; Linux only.
fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

/// Whether the folder holds a result that is complete and not degraded, has more than `tracked`
/// frames, or whose `metrics.json` cannot be read.
fn has_better_result(folder: &OutputFolder, tracked: usize) -> bool {
    folder.has_earlier_result()
        && load_metrics(folder.path())
            .is_none_or(|earlier| is_sound(&earlier) || earlier.tracked > tracked)
}

/// Whether a result is complete and what was asked for.
fn is_sound(metrics: &Metrics) -> bool {
    metrics.complete && !metrics.degraded
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_that_gave_the_camera_is_told_with_its_absolute_path() {
        let file = absolute_source("Cargo.toml".to_owned());
        assert!(Path::new(&file).is_absolute() && file.ends_with("Cargo.toml"), "{file}");
        assert_eq!(absolute_source("the given intrinsics".to_owned()), "the given intrinsics");
    }

    #[test]
    fn memory_above_its_budget_is_told() {
        let told = over_budget(Some(1_310_000_000), 1.0).expect("a warning");
        assert!(told.starts_with("1.31 GB of memory were taken, more than the 1 GB of"), "{told}");
        assert!(
            over_budget(Some(1_040_000_000), 1.0).is_none() && over_budget(None, 1.0).is_none()
        );
    }
}

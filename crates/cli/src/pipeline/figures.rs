//! The figures of a run that need no pictures.

use crate::truth::Truth;
use i2slam::RunOutcome;
use i2slam::geometry::StampedPose;
use i2slam_eval::exposure::exposure_agreement;
use i2slam_eval::trajectory::Alignment;
use i2slam_result::Metrics;

/// Exposures that differ by less are constant: a correlation would be one of noise [stops].
const MIN_RANGE: f64 = 0.1;

/// Figures, and the truth laid onto the estimate.
pub(crate) struct Figures {
    pub(crate) metrics: Metrics,
    pub(crate) truth_in_world: Vec<StampedPose>,
    /// What could not be measured, and why.
    pub(crate) warnings: Vec<String>,
}

impl Figures {
    pub(crate) fn of(outcome: &RunOutcome, truth: &Truth) -> Self {
        let reconstruction = &outcome.reconstruction;
        let mut metrics = Metrics::of(reconstruction);
        metrics.complete = outcome.complete;
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
        let mut figures = Self { metrics, truth_in_world: Vec::new(), warnings: Vec::new() };
        figures.judge_trajectory(outcome, truth);
        figures.judge_exposure(outcome, truth);
        figures
    }

    fn judge_trajectory(&mut self, outcome: &RunOutcome, truth: &Truth) {
        let scaled = outcome.reconstruction.config.is_rgb();
        let alignment = if scaled { Alignment::Sim3 } else { Alignment::Se3 };
        self.metrics.ate_scale_aligned = scaled;
        match truth.judge(&outcome.reconstruction.trajectory(), alignment) {
            Ok(Some((error, laid))) => {
                self.metrics.ate_rmse_m = Some(error.ate_rmse_m);
                self.metrics.ate_mean_m = Some(error.ate_mean_m);
                self.metrics.ate_poses = error.pairs;
                self.truth_in_world = laid;
            }
            Ok(None) => {}
            Err(failure) => {
                let reason = failure.message().unwrap_or_default();
                self.warnings.push(format!("trajectory error not measured: {reason}"));
            }
        }
    }

    fn judge_exposure(&mut self, outcome: &RunOutcome, truth: &Truth) {
        let reconstruction = &outcome.reconstruction;
        if !reconstruction.config.formation.tone || truth.exposure.is_empty() {
            return;
        }
        let pairs = reconstruction.frames.iter().filter_map(|frame| {
            let known = truth.exposure.iter().find(|(index, _)| *index == frame.index);
            known.map(|&(_, exposure)| (f64::from(frame.tone.exposure()), exposure))
        });
        let (estimate, due): (Vec<f64>, Vec<f64>) = pairs.unzip();
        if range_stops(&due) < MIN_RANGE {
            return;
        }
        match exposure_agreement(&estimate, &due) {
            Ok(agreement) => self.metrics.log_exposure_correlation = Some(agreement.pearson),
            Err(error) => self.warnings.push(format!("exposure not judged: {error}")),
        }
    }
}

/// Ratio of the largest to the smallest exposure [stops].
fn range_stops(exposures: &[f64]) -> f64 {
    let ends = |pick: fn(f64, f64) -> f64| exposures.iter().copied().reduce(pick);
    let (low, high) = (ends(f64::min), ends(f64::max));
    low.zip(high).map_or(0.0, |(low, high)| (high / low).log2())
}

/// The most memory this process ever held [bytes], where the system tells (Linux).
pub(super) fn peak_memory() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

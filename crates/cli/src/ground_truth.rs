//! Ground truth in a dataset: poses, sharp pictures, exposures, radiance.

use crate::exposure_table::{TrueTone, read_exposure_table};
use crate::failure::Failure;
use i2slam::dataset::Sequence;
use i2slam::geometry::{Image, StampedPose};
use i2slam_eval::trajectory::{
    Alignment, DEFAULT_TOLERANCE, TrajectoryError, absolute_trajectory_error,
    count_frames_without_pose,
};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Ground truth in a dataset's folder; all of it may be missing.
pub(crate) struct GroundTruth {
    folder: PathBuf,
    /// The sequence with its sharp pictures in place of those taken.
    sharp: Option<Sequence>,
    /// True exposures and white balance.
    pub(crate) tones: Vec<TrueTone>,
    /// True poses.
    pub(crate) trajectory: Vec<StampedPose>,
    /// Files that cannot be used, with reasons.
    pub(crate) warnings: Vec<String>,
}

impl GroundTruth {
    /// Opens poses (of a ground-truth file or of the frames), `sharp/`, `exposure.csv` and `hdr/`.
    pub(crate) fn open(folder: &Path, sequence: &Sequence) -> Self {
        let mut warnings = Vec::new();
        let trajectory = sequence.true_trajectory().unwrap_or_else(|error| {
            // The sequence has warned of an unreadable file.
            let is_known = sequence.warnings.iter().any(|w| w.contains(&error.to_string()));
            if !is_known {
                warnings.push(format!("ground truth ignored: {error}"));
            }
            Vec::new()
        });
        let exposure = folder.join("exposure.csv");
        let tones = exposure.exists().then(|| read_exposure_table(&exposure));
        let tones = tones.unwrap_or(Ok(Vec::new())).unwrap_or_else(|reason| {
            warnings.push(format!("exposure.csv ignored: {reason}"));
            Vec::new()
        });
        Self {
            folder: folder.to_owned(),
            sharp: sharp_sequence(folder, sequence),
            tones,
            trajectory,
            warnings,
        }
    }

    /// Leaves the poses out if they are those of `keyframes`, against which no error tells anything; true if
    /// so.
    pub(crate) fn leave_out_poses_of(&mut self, keyframes: &Path, sequence: &Sequence) -> bool {
        let sources = match &sequence.ground_truth {
            Some(file) => vec![file.clone()],
            None => vec![self.folder.clone(), self.folder.join("transforms.json")],
        };
        let Ok(given) = keyframes.canonicalize() else { return false };
        let is_given = sources.iter().any(|path| path.canonicalize().is_ok_and(|p| p == given));
        let is_known = is_given && !self.trajectory.is_empty();
        if is_known {
            self.trajectory.clear();
        }
        is_known
    }

    /// The true sharp picture of the frame at a place of the sequence.
    pub(crate) fn sharp(&self, position: usize) -> Option<Image<f32>> {
        let sharp = self.sharp.as_ref()?;
        let there = sharp.entries.get(position)?.colour.is_file();
        there
            .then(|| sharp.load(position).ok().map(|frame| Arc::unwrap_or_clone(frame.colour)))
            .flatten()
    }

    /// True exposures, in any unit, by stream index.
    pub(crate) fn exposures(&self) -> Vec<(usize, f64)> {
        self.tones.iter().map(|tone| (tone.frame, tone.exposure)).collect()
    }

    /// Kinds of ground truth, in words.
    pub(crate) fn kinds(&self) -> Vec<&'static str> {
        [
            (!self.trajectory.is_empty(), "poses"),
            (self.sharp.is_some(), "sharp pictures"),
            (self.folder.join("hdr").is_dir(), "radiance"),
            (!self.tones.is_empty(), "exposures"),
        ]
        .into_iter()
        .filter_map(|(there, kind)| there.then_some(kind))
        .collect()
    }

    /// The file of a frame's true radiance.
    pub(crate) fn radiance(&self, index: usize) -> Option<PathBuf> {
        let path = self.folder.join(format!("hdr/{index:06}.exr"));
        path.is_file().then_some(path)
    }

    /// Absolute trajectory error, and the true poses aligned to the estimate.
    pub(crate) fn trajectory_error(
        &self,
        estimate: &[StampedPose],
        alignment: Alignment,
    ) -> Result<Option<(TrajectoryError, Vec<StampedPose>)>, Failure> {
        if self.trajectory.is_empty() {
            return Ok(None);
        }
        let truth = &self.trajectory;
        let error = absolute_trajectory_error(estimate, truth, alignment, DEFAULT_TOLERANCE)?;
        let estimate_from_truth = error.truth_from_estimate.inverse();
        let aligned = error.associations.iter().map(|pair| StampedPose {
            timestamp: estimate[pair.estimate].timestamp,
            world_from_camera: estimate_from_truth
                .apply_to_pose(truth[pair.truth].world_from_camera),
        });
        let aligned = aligned.collect();
        Ok(Some((error, aligned)))
    }

    /// Number of frames of a sequence that have a true pose and no estimated one.
    pub(crate) fn frames_without_pose(
        &self,
        sequence: &Sequence,
        estimate: &[StampedPose],
    ) -> Result<usize, Failure> {
        let frames: Vec<f64> = sequence.entries.iter().map(|entry| entry.timestamp).collect();
        let truth = &self.trajectory;
        Ok(count_frames_without_pose(&frames, estimate, truth, DEFAULT_TOLERANCE)?)
    }
}

/// The sequence with the pictures of `sharp/`, which get the same crop and scale as the recorded
/// ones.
fn sharp_sequence(folder: &Path, sequence: &Sequence) -> Option<Sequence> {
    let sharp = folder.join("sharp");
    if !sharp.is_dir() {
        return None;
    }
    let mut sharp_frames = sequence.clone();
    for entry in &mut sharp_frames.entries {
        let name = entry.colour.file_name()?.to_owned();
        entry.colour = sharp.join(name);
    }
    Some(sharp_frames)
}

/// Ratio of the largest to the smallest exposure [stops].
pub(crate) fn range_stops(exposures: &[f64]) -> f64 {
    let ends = |pick: fn(f64, f64) -> f64| exposures.iter().copied().reduce(pick);
    let (low, high) = (ends(f64::min), ends(f64::max));
    low.zip(high).map_or(0.0, |(low, high)| (high / low).log2())
}

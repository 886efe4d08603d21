//! Relocalisation: searches the keyframes' surroundings for a camera that was lost.

use super::levenberg_marquardt::{AlignmentOutcome, EvaluationMode};
use super::target::AlignmentTarget;
use super::{FrameAlignment, TrackingState};
use crate::objective::FrameObjective;
use i2slam_geometry::{Pose, Rotation, Vec3};
use i2slam_radiance::RadianceMap;

/// Rotations about the camera's vertical axis that are tried at every candidate pose [deg].
const YAWS: [f64; 5] = [-24.0, -12.0, 0.0, 12.0, 24.0];
/// Those about its horizontal axis [deg].
const PITCHES: [f64; 3] = [-12.0, 0.0, 12.0];
/// Largest number of keyframes that are tried, evenly spread over all.
const MAX_KEYFRAMES: usize = 16;
/// Starts with the largest overlap that are optimised.
const MAX_STARTS: usize = 4;

impl FrameAlignment<'_> {
    /// Optimises from the last tracked pose and the keyframes' poses, rotated by up to a third of a
    /// picture; returns the accepted end with the largest overlap.
    pub(super) fn relocalize<M: RadianceMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        predicted: &TrackingState,
    ) -> Option<AlignmentOutcome> {
        let mut starts = Vec::new();
        for pose in self.candidate_poses() {
            starts.extend(self.candidates_around(objective, map, predicted, pose));
        }
        starts.sort_by(|a, b| b.0.total_cmp(&a.0));
        starts
            .into_iter()
            .take(MAX_STARTS)
            .map(|(_, start)| self.optimize(objective, map, start))
            .filter(|end| self.is_accepted(end))
            .max_by(|a, b| a.sums.overlap().total_cmp(&b.sums.overlap()))
    }

    fn candidate_poses(&self) -> Vec<Pose<f64>> {
        let frames = self.context.frames;
        let last = frames.iter().rev().find(|f| f.tracked).map(|f| f.middle());
        let keyframes: Vec<_> = frames.iter().filter(|f| f.keyframe).map(|f| f.middle()).collect();
        let stride = keyframes.len().div_ceil(MAX_KEYFRAMES).max(1);
        last.into_iter().chain(keyframes.into_iter().rev().step_by(stride)).collect()
    }

    /// States rotated around `pose`, each with its overlap on the coarsest level.
    fn candidates_around<M: RadianceMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        predicted: &TrackingState,
        pose: Pose<f64>,
    ) -> Vec<(f64, TrackingState)> {
        let target = AlignmentTarget::from_map(self, objective, map, pose);
        let level = self.levels.len() - 1;
        let turns = YAWS.iter().flat_map(|&yaw| PITCHES.map(|pitch| (yaw, pitch)));
        turns
            .map(|(yaw, pitch)| {
                let turn = Vec3::new(pitch.to_radians(), yaw.to_radians(), 0.0);
                let rotation = pose.rotation * Rotation::exp(turn);
                let state = predicted.at_rest(Pose::new(rotation, pose.translation));
                let sums = self.residuals(&target, level, &state, 1, EvaluationMode::CostOnly);
                (sums.overlap(), state)
            })
            .collect()
    }
}

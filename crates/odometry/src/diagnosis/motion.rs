//! Motion of the picture between frames, from their poses.

use crate::sfm_state::SfmState;
use i2slam_compute::median;

/// Rotation and translation between two frames, each as a length in the picture [px].
pub(crate) type Step = [f64; 6];

/// Length of a step [px].
pub(crate) fn length(step: &Step) -> f64 {
    step.iter().map(|v| v * v).sum::<f64>().sqrt()
}

/// Motion between the frames of a reconstruction.
pub(crate) struct Motion<'a> {
    state: &'a SfmState,
    /// Median inverse depth of the landmarks in every frame; 0 without any.
    inverse_depths: Vec<f64>,
}

impl<'a> Motion<'a> {
    pub(crate) fn new(state: &'a SfmState) -> Self {
        let inverse_depth = |frame: usize| {
            let Some(pose) = state.poses[frame] else { return 0.0 };
            let matches = state.matches(frame);
            let mut all: Vec<f64> =
                matches.iter().map(|(landmark, _)| landmark.inverse_depth_in(&pose)).collect();
            median(&mut all).map_or(0.0, |inverse| inverse.max(0.0))
        };
        Self { state, inverse_depths: (0..state.poses.len()).map(inverse_depth).collect() }
    }

    /// The step from one frame to another, `(f t / z, f φ)` with tangent `(t, φ)`, focal length `f` and
    /// median depth `z`; `None` unless both have a pose.
    pub(crate) fn step(&self, from: usize, to: usize) -> Option<Step> {
        let pose = |frame: usize| self.state.poses.get(frame).copied().flatten();
        let tangent = pose(from)?.local(pose(to)?).to_array();
        let focal = self.state.camera.fx;
        let inverse = self.inverse_depths[from];
        Some(std::array::from_fn(|i| tangent[i] * focal * if i < 3 { inverse } else { 1.0 }))
    }
}

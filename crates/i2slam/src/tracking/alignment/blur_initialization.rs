//! Initial velocity of a camera whose last motion is unknown, by trying out blur kernels.
//!
//! Blur is symmetric in time, so that the picture's derivative by the velocity vanishes at rest:
//! from there no iteration finds a moving camera.

use super::levenberg_marquardt::EvaluationMode;
use super::target::AlignmentTarget;
use super::{FrameAlignment, TrackingState, mean_losses};
use crate::objective::FrameObjective;
use i2slam_geometry::Tangent;
use i2slam_radiance::RadianceMap;

/// Rotation axes that are tried (horizontal, vertical), of unit length.
const AXES: [[f64; 2]; 4] = [[1.0, 0.0], [0.0, 1.0], [0.71, 0.71], [0.71, -0.71]];
/// Blur lengths that are tried [px].
const LENGTHS_PX: [f64; 3] = [4.0, 9.0, 18.0];
/// Pyramid level on which they are compared.
const LEVEL: usize = 1;

impl FrameAlignment<'_> {
    /// `start` with the rotational velocity whose blur suits the picture best; `None` if that is no
    /// motion.
    pub(super) fn with_initial_blur<M: RadianceMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        start: &TrackingState,
    ) -> Option<TrackingState> {
        if !self.context.config.formation.blur {
            return None;
        }
        let target = AlignmentTarget::from_map(self, objective, map, start.motion.centre);
        let level = LEVEL.min(self.levels.len() - 1);
        let cameras = self.context.config.formation.virtual_cameras;
        let loss = |state: &TrackingState| {
            let sums = self.residuals(&target, level, state, cameras, EvaluationMode::CostOnly);
            match sums.errors.image_count {
                0 => f64::INFINITY,
                _ => mean_losses(&sums).image,
            }
        };
        let candidates = AXES.iter().flat_map(|axis| LENGTHS_PX.map(|length| (axis, length)));
        let moving = candidates.map(|(axis, length)| {
            let turn = axis.map(|part| part * length / self.pixels_per_unit[3]);
            let velocity = Tangent::from_array([0.0, 0.0, 0.0, turn[0], turn[1], 0.0]);
            let mut state = start.clone();
            state.motion.velocity = velocity;
            (loss(&state), state)
        });
        let best = moving.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 < loss(start)).then_some(best.1)
    }
}

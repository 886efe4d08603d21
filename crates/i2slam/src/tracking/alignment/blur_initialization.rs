//! A first guess of the velocity of a camera whose last motion is unknown.
//!
//! Blur does not tell forward from backward in time, so that the picture's derivative by the
//! velocity vanishes at a still camera: from there no descent finds a streak. Some are tried.

use super::levenberg_marquardt::Purpose;
use super::target::Reference;
use super::{Frame, State, losses};
use crate::objective::{FrameObjective, SceneMap};
use i2slam_geometry::Tangent;

/// Directions of streaks: about the camera's horizontal and vertical axis.
const DIRECTIONS: [[f64; 2]; 4] = [[1.0, 0.0], [0.0, 1.0], [0.71, 0.71], [0.71, -0.71]];
/// Lengths of streaks [px].
const LENGTHS: [f64; 3] = [4.0, 9.0, 18.0];
/// Level of the pictures on which streaks are compared.
const LEVEL: usize = 1;

impl Frame<'_> {
    /// The start with the streak that suits the picture best, if one suits it better than none.
    pub(super) fn with_streak<M: SceneMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        start: &State,
    ) -> Option<State> {
        if !self.context.formation.blur {
            return None;
        }
        let model = Reference::model(self, objective, map, start.motion.centre);
        let level = LEVEL.min(self.observed.len() - 1);
        let cameras = self.context.formation.virtual_cameras;
        let loss = |state: &State| {
            let sums = self.residuals(&model, level, state, cameras, Purpose::Compare);
            match sums.errors.image_count {
                0 => f64::INFINITY,
                _ => losses(&sums).image,
            }
        };
        let streaks = DIRECTIONS.iter().flat_map(|axis| LENGTHS.map(|length| (axis, length)));
        let moving = streaks.map(|(axis, length)| {
            let turn = axis.map(|part| part * length / self.pixels[3]);
            let velocity = Tangent::from_array([0.0, 0.0, 0.0, turn[0], turn[1], 0.0]);
            let mut state = start.clone();
            state.motion.velocity = velocity;
            (loss(&state), state)
        });
        let best = moving.min_by(|a, b| a.0.total_cmp(&b.0))?;
        (best.0 < loss(start)).then_some(best.1)
    }
}

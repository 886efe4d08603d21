//! Finding a camera that was lost.

use super::levenberg_marquardt::{Outcome, Purpose};
use super::target::Reference;
use super::{Frame, Motion, State, extrapolate};
use crate::objective::{FrameObjective, SceneMap};
use i2slam_geometry::{Pose, Rotation, Tangent, Vec3};

/// Turns about the camera's vertical and horizontal axis that are tried around every place [deg].
const TURNS: [f64; 5] = [-24.0, -12.0, 0.0, 12.0, 24.0];
const TILTS: [f64; 3] = [-12.0, 0.0, 12.0];
/// Keyframes that are looked from, evenly spread over those there are.
const PLACES: usize = 16;
/// Starts that are followed to their end.
const STARTS: usize = 4;

impl Frame<'_> {
    /// Looks for the frame where the camera was last and where the keyframes were, turned by up to
    /// a third of a picture; the best end that can be believed.
    pub(super) fn recover<M: SceneMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        predicted: &State,
    ) -> Option<Outcome> {
        let mut starts = Vec::new();
        for place in self.places() {
            starts.extend(self.looks_from(objective, map, predicted, place));
        }
        starts.sort_by(|a, b| b.0.total_cmp(&a.0));
        starts
            .into_iter()
            .take(STARTS)
            .map(|(_, start)| self.settle(objective, map, start))
            .filter(|end| self.is_believed(end))
            .max_by(|a, b| a.sums.overlap().total_cmp(&b.sums.overlap()))
    }

    fn places(&self) -> Vec<Pose<f64>> {
        let frames = self.context.frames;
        let last = frames.iter().rev().find(|f| f.tracked).map(|f| f.middle());
        let keyframes: Vec<_> = frames.iter().filter(|f| f.keyframe).map(|f| f.middle()).collect();
        let stride = keyframes.len().div_ceil(PLACES).max(1);
        last.into_iter().chain(keyframes.into_iter().rev().step_by(stride)).collect()
    }

    /// States turned around one place, and the share of the coarsest picture's depth that lies on
    /// the model from there.
    fn looks_from<M: SceneMap>(
        &self,
        objective: &mut FrameObjective<M>,
        map: &M,
        predicted: &State,
        place: Pose<f64>,
    ) -> Vec<(f64, State)> {
        let reference = Reference::model(self, objective, map, place);
        let level = self.observed.len() - 1;
        let turns = TURNS.iter().flat_map(|&turn| TILTS.map(|tilt| (turn, tilt)));
        turns
            .map(|(turn, tilt)| {
                let look = Vec3::new(tilt.to_radians(), turn.to_radians(), 0.0);
                let rotation = place.rotation * Rotation::exp(look);
                let next = Pose::new(rotation, place.translation);
                let state = standing(predicted, next);
                let sums = self.residuals(&reference, level, &state, 1, Purpose::Compare);
                (sums.overlap(), state)
            })
            .collect()
    }
}

/// A camera that stands still at a pose.
pub(super) fn standing(predicted: &State, next: Pose<f64>) -> State {
    let motion = extrapolate(Motion { next, step: Tangent::zero() }, 0.0);
    State { motion, ..predicted.clone() }
}

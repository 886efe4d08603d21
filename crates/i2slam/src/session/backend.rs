//! Back end of a session: mapping with tracked frames.

use super::state::SessionState;
use crate::config::{Config, MapKind};
use crate::mapping::{
    AdjacentFrames, FieldMapper, GaussianMapper, Keyframe, Mapper, Tracker, is_keyframe,
};
use crate::objective::Observation;
use crate::warning::Warning;
use i2slam_geometry::Camera;
use std::sync::Arc;
use std::time::Instant;

/// The map with all that mapping changes.
pub(super) struct Backend {
    pub(super) mapper: Box<dyn Mapper>,
    pub(super) state: SessionState,
    /// A frame that is still to be mapped.
    pending: Option<Keyframe>,
}

impl Backend {
    pub(super) fn new(config: &Config, camera: &Camera<f64>) -> Self {
        let mapper: Box<dyn Mapper> = match config.map.kind {
            MapKind::Gaussian => Box::new(GaussianMapper::new(config, camera)),
            MapKind::HashGrid => Box::new(FieldMapper::new(camera)),
        };
        Self { mapper, state: SessionState::new(config), pending: None }
    }

    /// Enqueues the last frame for mapping, and decides whether it becomes a keyframe.
    pub(super) fn enqueue(
        &mut self,
        config: &Config,
        camera: &Camera<f64>,
        observation: Arc<Observation>,
    ) {
        let SessionState { frames, keyframes, .. } = &mut self.state;
        let position = frames.len() - 1;
        let adjacent = AdjacentFrames::default();
        let current = Keyframe { frame: position, observation, adjacent };
        let last = keyframes.last().map(|k| k.frame);
        frames[position].keyframe = self.mapper.is_empty()
            || last.is_none_or(|last| {
                is_keyframe(&config.mapping, camera, frames, last, &current.observation)
            });
        if frames[position].keyframe {
            keyframes.push(current.clone());
        }
        self.pending = Some(current);
    }

    pub(super) fn map_pending(&mut self, config: &Config, camera: &Camera<f64>) {
        let Some(current) = self.pending.take() else { return };
        let clock = Instant::now();
        let (position, state) = (current.frame, &mut self.state);
        let first = self.mapper.is_empty();
        if first || (position + 1).is_multiple_of(config.mapping.interval) {
            let earlier = state.keyframes.len() - usize::from(state.frames[position].keyframe);
            let mut context = state.mapping_context(config, camera, earlier);
            self.mapper.add(&mut context, &current);
            self.mapper.refine(&mut context, &current, first);
        }
        let estimate = &mut state.frames[position];
        if first && self.mapper.is_empty() {
            // Nothing was measured with a map that did not outlive its first frame.
            estimate.tracked = false;
        }
        estimate.mapping_seconds = clock.elapsed().as_secs_f64();
        estimate.gaussians = self.mapper.gaussians();
    }

    /// Final optimisation over all keyframes; stops when `on_step(done, total)` returns false.
    pub(super) fn finish(
        &mut self,
        config: &Config,
        camera: &Camera<f64>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) {
        self.map_pending(config, camera);
        let keyframes = self.state.keyframes.len();
        if keyframes > 0 {
            let mut context = self.state.mapping_context(config, camera, keyframes);
            self.mapper.finish(&mut context, on_step);
        }
        let failure =
            self.mapper.failure().map(|error| Warning::from(format!("the map is empty: {error}")));
        self.state.warnings.extend(failure);
    }

    /// A copy of the map to track against, in the memory of `last`.
    pub(super) fn snapshot(&self, last: Option<Box<dyn Tracker>>) -> Option<Box<dyn Tracker>> {
        self.mapper.snapshot(self.state.valid_mask.clone(), last)
    }
}

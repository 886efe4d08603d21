//! The back end: the map takes in frames that were tracked.

use crate::config::Config;
use crate::mapping::{AdjacentFrames, Keyframe, Mapper, MappingContext, Tracker, is_keyframe};
use crate::objective::Observation;
use crate::reconstruction::FrameEstimate;
use crate::warning::Warning;
use i2slam_compute::{CancellationToken, Random};
use i2slam_formation::CameraResponse;
use i2slam_geometry::{Camera, Image};
use std::sync::Arc;
use std::time::Instant;

/// All that mapping changes.
pub(super) struct Backend {
    pub(super) mapper: Box<dyn Mapper>,
    pub(super) responses: Vec<CameraResponse<f32>>,
    pub(super) frames: Vec<FrameEstimate>,
    pub(super) keyframes: Vec<Keyframe>,
    pub(super) covered: Option<Arc<Image<bool>>>,
    pub(super) warnings: Vec<Warning>,
    pub(super) cancellation: CancellationToken,
    random: Random,
    /// A frame that the map has not taken in yet.
    pending: Option<Keyframe>,
}

impl Backend {
    pub(super) fn new(config: &Config, camera: &Camera<f64>) -> Self {
        Self {
            mapper: super::mapper(config, camera),
            responses: vec![super::response(config)],
            frames: Vec::new(),
            keyframes: Vec::new(),
            covered: None,
            warnings: Vec::new(),
            cancellation: CancellationToken::default(),
            random: Random::new(config.seed),
            pending: None,
        }
    }

    /// Hands the last frame over for mapping: [`work`](Self::work) does it.
    pub(super) fn hand_over(
        &mut self,
        config: &Config,
        camera: &Camera<f64>,
        observation: Arc<Observation>,
    ) {
        let position = self.frames.len() - 1;
        let current =
            Keyframe { frame: position, observation, adjacent: AdjacentFrames::default() };
        let last = self.keyframes.last().map(|k| k.frame);
        self.frames[position].keyframe = self.mapper.is_empty()
            || last.is_none_or(|last| {
                is_keyframe(&config.mapping, camera, &self.frames, last, &current.observation)
            });
        if self.frames[position].keyframe {
            self.keyframes.push(current.clone());
        }
        self.pending = Some(current);
    }

    /// Takes the frame in that was handed over, if any.
    pub(super) fn work(&mut self, config: &Config, camera: &Camera<f64>) {
        let Some(current) = self.pending.take() else { return };
        let clock = Instant::now();
        let position = current.frame;
        let first = self.mapper.is_empty();
        if first || (position + 1).is_multiple_of(config.mapping.interval) {
            let before = self.keyframes.len() - usize::from(self.frames[position].keyframe);
            let (mapper, mut context) = self.context(config, camera, before);
            mapper.add(&mut context, &current);
            mapper.refine(&mut context, &current, first);
        }
        let estimate = &mut self.frames[position];
        estimate.mapping_seconds = clock.elapsed().as_secs_f64();
        estimate.gaussians = self.mapper.gaussians();
    }

    /// Refines the map over all keyframes; `on_step(done, of)` says whether to go on.
    pub(super) fn finish(
        &mut self,
        config: &Config,
        camera: &Camera<f64>,
        on_step: &mut dyn FnMut(usize, usize) -> bool,
    ) {
        self.work(config, camera);
        if !self.keyframes.is_empty() {
            let (mapper, mut context) = self.context(config, camera, self.keyframes.len());
            mapper.finish(&mut context, on_step);
        }
        let failure =
            self.mapper.failure().map(|error| Warning::from(format!("the map is empty: {error}")));
        self.warnings.extend(failure);
    }

    /// A copy of the map for tracking.
    pub(super) fn snapshot(
        &self,
        camera: &Camera<f64>,
        last: Option<Box<dyn Tracker>>,
    ) -> Option<Box<dyn Tracker>> {
        self.mapper.snapshot(camera, self.covered.clone(), last)
    }

    /// The map, and what it works on: the first `keyframes` of them.
    fn context<'a>(
        &'a mut self,
        config: &'a Config,
        camera: &'a Camera<f64>,
        keyframes: usize,
    ) -> (&'a mut dyn Mapper, MappingContext<'a>) {
        let context = MappingContext {
            config,
            camera,
            frames: &mut self.frames,
            keyframes: &self.keyframes[..keyframes],
            responses: &mut self.responses,
            covered: self.covered.as_deref(),
            random: &mut self.random,
            warnings: &mut self.warnings,
            cancellation: &self.cancellation,
        };
        (self.mapper.as_mut(), context)
    }
}

//! When a session's map takes in a frame.

use super::Session;
use crate::mapping::{Keyframe, Mapper, Story, is_keyframe};
use crate::objective::Observation;
use std::sync::Arc;

impl Session {
    pub(super) fn map_frame(&mut self, position: usize, observation: Arc<Observation>) {
        let first = self.mapper.is_empty();
        let keyframe = Keyframe { frame: position, observation };
        let mapping = &self.config.mapping;
        let last = self.keyframes.last().map(|k| k.frame);
        let is_keyframe = first
            || last.is_none_or(|last| {
                let frames = &self.frames[..=position];
                is_keyframe(mapping, &self.camera, frames, last, &keyframe.observation)
            });
        if first || (position + 1).is_multiple_of(mapping.interval) {
            let (mapper, mut story) = self.mapper();
            mapper.add(&mut story, &keyframe);
            mapper.refine(&mut story, &keyframe, first);
        }
        if is_keyframe {
            self.frames[position].keyframe = true;
            self.keyframes.push(keyframe);
        }
    }

    /// The map, and what it works on.
    pub(super) fn mapper(&mut self) -> (&mut dyn Mapper, Story<'_>) {
        let story = Story {
            config: &self.config,
            camera: &self.camera,
            frames: &mut self.frames,
            keyframes: &self.keyframes,
            responses: &mut self.responses,
            covered: self.covered.as_deref(),
            random: &mut self.random,
            warnings: &mut self.warnings,
        };
        (self.mapper.as_mut(), story)
    }
}

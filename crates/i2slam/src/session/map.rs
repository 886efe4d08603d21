//! What a session does to its map with a frame: adding, refining, pruning.

use super::Session;
use crate::mapping::{
    Keyframe, SceneScale, Sight, Source, add_gaussians, is_keyframe, merge, placement, prune,
    seed_map, select_window,
};
use crate::objective::{Observation, Tone};
use crate::tracking::sampling;
use i2slam_formation::CentreVelocity;
use std::sync::Arc;
use std::time::Instant;

/// Share of the capacity that is left when a full map was merged.
const ROOMY: f64 = 0.9;
/// SplaTAM prunes at this step of a round, beside the first.
const PRUNE_STEP: usize = 20;

impl Session {
    pub(super) fn map_frame(&mut self, position: usize, observation: Arc<Observation>) {
        let first = self.map.is_empty();
        let keyframe = Keyframe { frame: position, observation };
        let mapping = self.config.mapping.clone();
        let last = self.keyframes.last().map(|k| k.frame);
        let is_keyframe = first
            || last.is_none_or(|last| {
                let frames = &self.frames[..=position];
                is_keyframe(&mapping, &self.camera, frames, last, &keyframe.observation)
            });
        if first || (position + 1).is_multiple_of(mapping.interval) {
            self.densify(&keyframe, first);
            let iterations = if first { mapping.first_iterations } else { mapping.iterations };
            self.map_round(&keyframe, iterations);
        }
        if is_keyframe {
            self.frames[position].keyframe = true;
            self.keyframes.push(keyframe);
        }
    }

    fn densify(&mut self, keyframe: &Keyframe, first: bool) {
        let estimate = &self.frames[keyframe.frame];
        let curve = self.config.formation.tone.then(|| self.responses[estimate.response].curve());
        let source = Source {
            camera: &self.camera,
            world_from_depth: estimate.depth_pose(),
            colour_from_depth: estimate.middle().inverse() * estimate.depth_pose(),
            velocity: CentreVelocity::from(estimate.shutter).velocity,
            readout: estimate.readout,
            observation: &keyframe.observation,
            depth: placement(&keyframe.observation, &self.config.mapping, self.covered.as_deref()),
            tone: curve.as_ref().map(|curve| Tone { frame: estimate.tone, curve }),
        };
        if first {
            let ratio = self.config.mapping.scene_radius_ratio;
            self.scene = SceneScale::new(&keyframe.observation, ratio);
            seed_map(&mut self.map, &self.config.map, &source);
        } else {
            let render = self.objective.render(&self.map, source.world_from_depth).clone();
            let settings = (&self.config.map, &self.config.mapping);
            add_gaussians(&mut self.map, settings, &source, &render);
        }
        self.make_room();
    }

    /// Keeps the map within its capacity, and then with some room for the next frames.
    fn make_room(&mut self) {
        let capacity = self.config.map.capacity;
        if self.map.len() <= capacity {
            return;
        }
        let aim = (ROOMY * capacity as f64) as usize;
        let keep = merge(&mut self.map, aim..=capacity);
        self.optimizer.retain(&keep);
        if !self.full {
            self.full = true;
            self.warnings.push(format!(
                "the map is full: from now on similar neighbours are merged to keep it at \
                 {capacity} Gaussians; map.capacity sets the limit"
            ));
        }
    }

    fn map_round(&mut self, current: &Keyframe, iterations: usize) {
        let mapping = &self.config.mapping;
        if mapping.fresh_optimizer {
            self.optimizer.reset();
        }
        let window = select_window(
            &self.keyframes,
            current,
            &self.frames,
            &self.camera,
            mapping.window,
            &mut self.random,
        );
        let fresh = mapping.fresh_optimizer;
        let budget = f64::from(mapping.seconds_per_frame);
        let clock = Instant::now();
        for iteration in 0..iterations {
            if iteration > 0 && budget > 0.0 && clock.elapsed().as_secs_f64() > budget {
                break;
            }
            let chosen = &window[self.random.below(window.len())];
            self.map_step(chosen);
            if fresh && (iteration == 0 || iteration == PRUNE_STEP) {
                self.prune();
            }
        }
        if !fresh {
            self.prune();
        }
    }

    pub(super) fn map_step(&mut self, keyframe: &Keyframe) {
        let estimate = &self.frames[keyframe.frame];
        let sampling = sampling(
            &self.config.formation,
            &self.camera,
            &estimate.shutter,
            &keyframe.observation,
        );
        let mut sight = Sight {
            config: &self.config,
            objective: &mut self.objective,
            map: &mut self.map,
            frames: &mut self.frames,
            responses: &mut self.responses,
            gauge_frame: self.keyframes.first().map_or(keyframe.frame, |k| k.frame),
            sampling,
        };
        self.optimizer.step(&mut sight, keyframe);
    }

    pub(super) fn prune(&mut self) {
        let keep = prune(&mut self.map, &self.config.mapping, self.scene);
        if keep.contains(&false) {
            self.optimizer.retain(&keep);
        }
    }
}

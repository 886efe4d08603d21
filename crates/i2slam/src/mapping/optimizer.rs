//! One step of mapping: the joint optimisation of Gaussians, tone, response and keyframe poses.

use super::ages::Ages;
use super::frames::{FrameOptimizers, adam};
use super::{Keyframe, Story};
use crate::config::Config;
use crate::objective::{Evaluation, Exposure, FrameObjective, FrameVariables, Sampling, Tone};
use i2slam_compute::Adam;
use i2slam_radiance::gaussian::{GaussianMap, MapGradient, Shape};

/// Optimiser state of map, response and keyframes.
pub(crate) struct MapOptimizer {
    gradient: MapGradient,
    means: Adam,
    log_scales: Adam,
    rotations: Adam,
    opacities: Adam,
    colours: Adam,
    ages: Ages,
    frames: FrameOptimizers,
}

impl MapOptimizer {
    pub(crate) fn new() -> Self {
        Self {
            gradient: MapGradient::new(0),
            means: adam(),
            log_scales: adam(),
            rotations: adam(),
            opacities: adam(),
            colours: adam(),
            ages: Ages::default(),
            frames: FrameOptimizers::default(),
        }
    }

    /// Forgets all moments.
    pub(crate) fn reset(&mut self) {
        let gradient = std::mem::replace(&mut self.gradient, MapGradient::new(0));
        *self = Self { gradient, ..Self::new() };
    }

    /// Drops the moments of pruned Gaussians.
    pub(crate) fn retain(&mut self, keep: &[bool]) {
        self.ages.retain(keep);
        self.means.retain(keep, 3);
        self.log_scales.retain(keep, 3);
        self.rotations.retain(keep, 4);
        self.opacities.retain(keep, 1);
        self.colours.retain(keep, 3);
    }

    /// One gradient step on the view of one keyframe.
    pub(crate) fn step(
        &mut self,
        story: &mut Story<'_>,
        (map, objective): (&mut GaussianMap, &mut FrameObjective<GaussianMap>),
        keyframe: &Keyframe,
        sampling: Sampling,
    ) -> Evaluation {
        let config = story.config;
        let estimate = &story.frames[keyframe.frame];
        let mapping = &config.mapping;
        let curve = config.formation.tone.then(|| story.responses[estimate.response].curve());
        let variables = FrameVariables {
            exposure: Exposure {
                shutter: estimate.shutter,
                sampling,
                readout: estimate.readout,
                depth_pose: estimate.depth_is_apart().then(|| estimate.depth_pose()),
            },
            tone: curve.as_ref().map(|curve| Tone { frame: estimate.tone, curve }),
        };
        self.gradient.reset(map.len());
        let mut evaluation = objective.map(
            map,
            &keyframe.observation,
            &variables,
            mapping.ssim_share,
            (mapping.image_weight, mapping.depth_weight),
            &mut self.gradient,
        );
        self.step_map(config, map);
        let gauge_frame = story.gauge_frame(keyframe);
        self.frames.step(story, keyframe.frame, gauge_frame, &mut evaluation);
        evaluation
    }

    fn step_map(&mut self, config: &Config, map: &mut GaussianMap) {
        let (rates, gradient) = (&config.mapping, &self.gradient);
        let ages = self.ages.advance(gradient, rates.only_seen);
        if ages.is_empty() {
            return;
        }
        let groups = [
            (&mut self.means, map.means.as_flattened_mut(), gradient.means.as_flattened()),
            (&mut self.colours, map.colours.as_flattened_mut(), gradient.colours.as_flattened()),
            (&mut self.opacities, map.opacity_logits.as_mut_slice(), &gradient.opacity_logits[..]),
            (
                &mut self.log_scales,
                map.log_scales.as_flattened_mut(),
                gradient.log_scales.as_flattened(),
            ),
        ];
        let steps = [rates.mean_rate, rates.colour_rate, rates.opacity_rate, rates.scale_rate];
        for ((adam, values, gradient), rate) in groups.into_iter().zip(steps) {
            adam.step_elements(values, gradient, rate, values.len() / ages.len(), ages);
        }
        match map.shape {
            Shape::Isotropic => map.log_scales.iter_mut().for_each(|s| *s = [s[0]; 3]),
            Shape::Anisotropic => self.rotations.step_elements(
                map.rotations.as_flattened_mut(),
                gradient.rotations.as_flattened(),
                rates.rotation_rate,
                4,
                ages,
            ),
        }
    }
}

//! Gradient steps on Gaussians together with tone, response and keyframe poses.

use crate::config::Config;
use crate::mapping::context::MappingContext;
use crate::mapping::frame_optimizer::{FrameOptimizers, adam};
use crate::mapping::keyframe::Keyframe;
use crate::mapping::mapper::ComparedMap;
use crate::objective::{FrameVariables, Observation};
use i2slam_compute::Adam;
use i2slam_formation::Formation;
use i2slam_radiance::gaussian::{GaussianMap, MapGradient, Shape};
use rayon::prelude::*;

/// λ_img, a mean over pixels (SplaTAM).
const IMAGE_WEIGHT: f32 = 0.5;
/// Share of 1 - SSIM in the image loss; the rest is L1 (SplaTAM).
const SSIM_SHARE: f32 = 0.2;
/// Learning rate of opacity logits (SplaTAM).
const OPACITY_RATE: f32 = 0.05;

/// Optimiser state of map, response and keyframes.
pub(crate) struct GaussianOptimizer {
    gradient: MapGradient,
    means: Adam,
    log_scales: Adam,
    rotations: Adam,
    opacities: Adam,
    colours: Adam,
    step_counts: StepCounts,
    frames: FrameOptimizers,
}

impl GaussianOptimizer {
    pub(crate) fn new() -> Self {
        Self {
            gradient: MapGradient::new(0),
            means: adam(),
            log_scales: adam(),
            rotations: adam(),
            opacities: adam(),
            colours: adam(),
            step_counts: StepCounts::default(),
            frames: FrameOptimizers::default(),
        }
    }

    pub(crate) fn reset(&mut self) {
        let gradient = std::mem::replace(&mut self.gradient, MapGradient::new(0));
        *self = Self { gradient, ..Self::new() };
    }

    /// Drops the moments of pruned Gaussians.
    pub(crate) fn retain(&mut self, keep: &[bool]) {
        self.step_counts.retain(keep);
        self.means.retain(keep, 3);
        self.log_scales.retain(keep, 3);
        self.rotations.retain(keep, 4);
        self.opacities.retain(keep, 1);
        self.colours.retain(keep, 3);
    }

    /// Rotates the moments of a Gaussian's mean and quaternion.
    pub(crate) fn rotate(
        &mut self,
        gaussian: usize,
        of_mean: &[[f32; 3]; 3],
        of_quaternion: &[[f32; 4]; 4],
    ) {
        self.means.rotate(gaussian, of_mean);
        self.rotations.rotate(gaussian, of_quaternion);
    }

    /// One gradient step on the view of one keyframe.
    pub(crate) fn step(
        &mut self,
        context: &mut MappingContext<'_>,
        target: &mut ComparedMap<GaussianMap>,
        (keyframe, observation): (&Keyframe, &Observation),
    ) {
        let ComparedMap { map, objective } = target;
        let config = context.config;
        let estimate = &context.frames[keyframe.frame];
        let curve = config.formation.tone.then(|| context.responses[estimate.response].curve());
        let variables = FrameVariables {
            exposure: context.exposure(keyframe.frame, observation),
            tone: curve.as_ref().map(|curve| Formation { tone: estimate.tone, curve }),
        };
        self.gradient.reset(map.len());
        let mut evaluation = objective.map(
            map,
            observation,
            &variables,
            SSIM_SHARE,
            (IMAGE_WEIGHT, config.mapping.depth_weight),
            &mut self.gradient,
        );
        self.step_map(config, map);
        let gauge_frame = context.gauge_frame(keyframe);
        self.frames.step(context, keyframe.frame, gauge_frame, &mut evaluation);
    }

    fn step_map(&mut self, config: &Config, map: &mut GaussianMap) {
        let (rates, gradient) = (&config.parameters.gaussians, &self.gradient);
        let step_counts = self.step_counts.advance(gradient, rates.selective_adam);
        if step_counts.is_empty() {
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
        let steps = [rates.mean_rate, rates.colour_rate, OPACITY_RATE, rates.scale_rate];
        for ((adam, values, gradient), rate) in groups.into_iter().zip(steps) {
            adam.step_elements(
                values,
                gradient,
                rate,
                values.len() / step_counts.len(),
                step_counts,
            );
        }
        match map.shape {
            Shape::Isotropic => map.log_scales.iter_mut().for_each(|s| *s = [s[0]; 3]),
            Shape::Anisotropic => self.rotations.step_elements(
                map.rotations.as_flattened_mut(),
                gradient.rotations.as_flattened(),
                rates.rotation_rate,
                4,
                step_counts,
            ),
        }
    }
}

/// Gaussians whose steps are counted in one task, at least.
const MIN_TASK_GAUSSIANS: usize = 8192;

/// Optimiser steps that each Gaussian has taken.
#[derive(Default)]
struct StepCounts {
    steps: Vec<u32>,
    /// Scratch: counts returned by [`Self::advance`].
    active: Vec<u32>,
}

impl StepCounts {
    /// Counts a step; returns the counts of the Gaussians that take it, 0 for the others. With
    /// `only_seen`, those without a gradient take none, so that momentum does not move them on.
    fn advance(&mut self, gradient: &MapGradient, only_seen: bool) -> &[u32] {
        let count = gradient.opacity_logits.len();
        self.steps.resize(count, 0);
        self.active.resize(count, 0);
        let counts = self.steps.par_iter_mut().zip(&mut self.active).enumerate();
        counts.with_min_len(MIN_TASK_GAUSSIANS).for_each(|(i, (steps, active))| {
            let derivatives = gradient.colours[i].iter().chain(&gradient.means[i]);
            let moves = !only_seen
                || gradient.opacity_logits[i] != 0.0
                || derivatives.into_iter().any(|&g| g != 0.0);
            *steps += u32::from(moves);
            *active = if moves { *steps } else { 0 };
        });
        &self.active
    }

    fn retain(&mut self, keep: &[bool]) {
        self.steps.resize(keep.len(), 0);
        let mut kept = keep.iter();
        self.steps.retain(|_| kept.next().is_some_and(|&k| k));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_seen_gaussians_count_a_step() {
        let mut step_counts = StepCounts::default();
        let mut gradient = MapGradient::new(3);
        gradient.colours[1][2] = 0.5;
        assert_eq!(step_counts.advance(&gradient, true), [0, 1, 0]);
        assert_eq!(step_counts.advance(&gradient, false), [1, 2, 1]);
        step_counts.retain(&[false, true, true]);
        gradient.reset(2);
        gradient.opacity_logits[0] = -1.0;
        assert_eq!(step_counts.advance(&gradient, true), [3, 0]);
    }
}

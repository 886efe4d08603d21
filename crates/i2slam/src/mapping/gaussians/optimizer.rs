//! Gradient steps on Gaussians together with tone, response and keyframe poses.

use super::scale_bounds::ScaleBounds;
use crate::config::Config;
use crate::mapping::context::MappingContext;
use crate::mapping::frame_optimizer::{FrameOptimizers, adam};
use crate::mapping::keyframe::Keyframe;
use crate::mapping::mapper::ComparedMap;
use crate::objective::{Evaluation, FrameVariables, ImageLoss, Observation};
use i2slam_compute::Adam;
use i2slam_radiance::gaussian::{GaussianMap, MapGradient, Shape, ViewColours};
use rayon::prelude::*;

/// λ_img, a mean over pixels (SplaTAM).
const IMAGE_WEIGHT: f32 = 0.5;
/// Share of 1 - SSIM in the image loss (SplaTAM).
const SSIM_SHARE: f32 = 0.2;
/// Learning rate of the coefficients of view colours, as a share of that of colours.
const VIEW_COLOUR_RATE: f32 = 0.5;
/// Share of the differences between the channels of view colours that a step takes away: few views tell them,
/// and what is wrong in them are coloured dots beside the path. It favours gloss of the colour of its surface.
const CHANNEL_DECAY: f32 = 0.1;
/// Learning rate of opacity logits (SplaTAM).
const OPACITY_RATE: f32 = 0.05;
/// Learning rate of the means of flat Gaussians, in pixels of the nearest keyframe that saw them.
const FLAT_MEAN_RATE: f32 = 0.06;

/// Scale of the learning rates of a step.
#[derive(Clone, Copy)]
pub(super) struct StepScale<'a> {
    /// Widths of a pixel where flat Gaussians are.
    pub(super) bounds: &'a ScaleBounds,
    /// Factor of all rates of the map.
    pub(super) share: f32,
}

/// Share of the learning rates at one of a number of final steps: in the last third, when Gaussians are no
/// longer split, it falls to a tenth, for Adam goes on moving by the rate where gradients are noise.
pub(super) fn final_rate_share(step: usize, total: usize) -> f32 {
    0.1_f32.powf((3.0 * step as f32 / total as f32 - 2.0).max(0.0))
}

/// Optimiser state of map, response and keyframes.
pub(crate) struct GaussianOptimizer {
    gradient: MapGradient,
    means: Adam,
    log_scales: Adam,
    rotations: Adam,
    opacities: Adam,
    colours: Adam,
    view_colours: Adam,
    step_counts: StepCounts,
    /// Of each row of coefficients of view colours.
    view_steps: StepCounts,
    frames: FrameOptimizers,
}

impl GaussianOptimizer {
    pub(crate) fn new() -> Self {
        Self {
            gradient: MapGradient::default(),
            means: adam(),
            log_scales: adam(),
            rotations: adam(),
            opacities: adam(),
            colours: adam(),
            view_colours: adam(),
            step_counts: StepCounts::default(),
            view_steps: StepCounts::default(),
            frames: FrameOptimizers::default(),
        }
    }

    pub(crate) fn reset(&mut self) {
        let gradient = std::mem::take(&mut self.gradient);
        *self = Self { gradient, ..Self::new() };
    }

    /// Drops the moments of responses and tones that were replaced.
    pub(crate) fn forget_tone(&mut self) {
        self.frames.forget_tone();
    }

    /// Drops the moments of view colours that were replaced.
    pub(crate) fn forget_view_colours(&mut self) {
        self.view_colours.reset();
        self.view_steps = StepCounts::default();
    }

    /// Drops the moments of Gaussians that are removed from a map with such view colours.
    pub(crate) fn retain(&mut self, keep: &[bool], view_colours: &ViewColours) {
        self.step_counts.retain(keep);
        self.means.retain(keep, 3);
        self.log_scales.retain(keep, 3);
        self.rotations.retain(keep, 4);
        self.opacities.retain(keep, 1);
        self.colours.retain(keep, 3);
        let rows = view_colours.spread_flags(keep);
        self.view_colours.retain(&rows, 3);
        self.view_steps.retain(&rows);
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
        scale: StepScale<'_>,
    ) {
        let mut evaluation = self.evaluate(context, target, (keyframe, observation));
        self.step_map(context.config, &mut target.map, scale);
        let gauge_frame = context.gauge_frame(keyframe);
        self.frames.step(context, keyframe, gauge_frame, &mut evaluation);
    }

    /// The derivative of the loss of one keyframe by the map.
    pub(crate) fn gradient(
        &mut self,
        context: &MappingContext<'_>,
        target: &mut ComparedMap<GaussianMap>,
        (keyframe, observation): (&Keyframe, &Observation),
    ) -> &MapGradient {
        self.evaluate(context, target, (keyframe, observation));
        &self.gradient
    }

    /// Returns the memory of a derivative by a map that was larger for a while.
    pub(crate) fn release_gradient(&mut self) {
        self.gradient = MapGradient::default();
    }

    fn evaluate(
        &mut self,
        context: &MappingContext<'_>,
        target: &mut ComparedMap<GaussianMap>,
        (keyframe, observation): (&Keyframe, &Observation),
    ) -> Evaluation {
        let ComparedMap { map, objective } = target;
        let config = context.config;
        let estimate = &context.frames[keyframe.frame];
        let curve = config.formation.tone.then(|| context.responses[estimate.response].curve());
        let variables = FrameVariables {
            exposure: context.exposure(keyframe.frame, observation),
            tone: curve.as_ref().map(|curve| context.formation(keyframe.frame, curve)),
        };
        let loss = ImageLoss {
            pixel: config.parameters.gaussians.pixel_loss,
            ssim_share: SSIM_SHARE,
            weight: IMAGE_WEIGHT,
        };
        self.gradient.reset(map);
        objective.map(
            map,
            observation,
            &variables,
            (loss, config.mapping.depth_weight),
            &mut self.gradient,
        )
    }

    fn step_map(&mut self, config: &Config, map: &mut GaussianMap, scale: StepScale<'_>) {
        let (rates, gradient) = (&config.parameters.gaussians, &self.gradient);
        let StepScale { bounds, share } = scale;
        let all = !rates.selective_adam;
        let step_counts = self.step_counts.advance(map.len(), |i| all || has_gradient(gradient, i));
        if step_counts.is_empty() {
            return;
        }
        let mean_rate = |i| bounds.pixel_width(i).map_or(rates.mean_rate, |px| FLAT_MEAN_RATE * px);
        self.means.step_elements(
            map.means.as_flattened_mut(),
            gradient.means.as_flattened(),
            |i| share * mean_rate(i),
            3,
            step_counts,
        );
        let groups = [
            (&mut self.colours, map.colours.as_flattened_mut(), gradient.colours.as_flattened()),
            (&mut self.opacities, map.opacity_logits.as_mut_slice(), &gradient.opacity_logits[..]),
            (
                &mut self.log_scales,
                map.log_scales.as_flattened_mut(),
                gradient.log_scales.as_flattened(),
            ),
        ];
        let steps = [rates.colour_rate, OPACITY_RATE, rates.scale_rate];
        for ((adam, values, gradient), rate) in groups.into_iter().zip(steps) {
            adam.step_elements(
                values,
                gradient,
                |_| share * rate,
                values.len() / step_counts.len(),
                step_counts,
            );
        }
        match map.shape {
            Shape::Isotropic => map.log_scales.iter_mut().for_each(|s| *s = [s[0]; 3]),
            Shape::Anisotropic => self.rotations.step_elements(
                map.rotations.as_flattened_mut(),
                gradient.rotations.as_flattened(),
                |_| share * rates.rotation_rate,
                4,
                step_counts,
            ),
        }
        self.step_view_colours(share * VIEW_COLOUR_RATE * rates.colour_rate, map);
    }

    /// Steps the coefficients of view colours that are seen.
    fn step_view_colours(&mut self, rate: f32, map: &mut GaussianMap) {
        let (gradient, adam) = (self.gradient.view_colours.as_flattened(), &mut self.view_colours);
        let moves = |i: usize| gradient[3 * i..3 * i + 3].iter().any(|&g| g != 0.0);
        let step_counts = self.view_steps.advance(gradient.len() / 3, moves);
        adam.step_elements(
            map.view_colours.coefficients_mut().as_flattened_mut(),
            gradient,
            |_| rate,
            3,
            step_counts,
        );
        let rows = map.view_colours.coefficients_mut();
        rows.iter_mut().zip(step_counts).filter(|(_, steps)| **steps > 0).for_each(|(row, _)| {
            let mean = row.iter().sum::<f32>() / 3.0;
            *row = row.map(|value| value - CHANNEL_DECAY * (value - mean));
        });
    }
}

/// True if a Gaussian has a gradient: without, momentum alone would move it on.
fn has_gradient(gradient: &MapGradient, i: usize) -> bool {
    let derivatives = gradient.colours[i].iter().chain(&gradient.means[i]);
    gradient.opacity_logits[i] != 0.0 || derivatives.into_iter().any(|&g| g != 0.0)
}

/// Elements whose steps are counted in one task, at least.
const MIN_TASK_ELEMENTS: usize = 8192;

/// Optimiser steps that each element has taken.
#[derive(Default)]
struct StepCounts {
    steps: Vec<u32>,
    /// Scratch: counts returned by [`Self::advance`].
    active: Vec<u32>,
}

impl StepCounts {
    /// Counts a step of so many elements; returns the counts of those that take it, 0 for the others.
    fn advance(&mut self, count: usize, moves: impl Fn(usize) -> bool + Sync) -> &[u32] {
        self.steps.resize(count, 0);
        self.active.resize(count, 0);
        let counts = self.steps.par_iter_mut().zip(&mut self.active).enumerate();
        counts.with_min_len(MIN_TASK_ELEMENTS).for_each(|(i, (steps, active))| {
            let moves = moves(i);
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
    use i2slam_radiance::gaussian::{ColourActivation, Cone, Gaussian};

    #[test]
    fn only_seen_gaussians_count_a_step() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        (0..3).for_each(|_| {
            map.push(Gaussian {
                mean: [0.0; 3],
                log_scale: [0.0; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity_logit: 0.0,
                colour: [0.0; 3],
            })
        });
        let mut step_counts = StepCounts::default();
        let mut gradient = MapGradient::new(&map);
        gradient.colours[1][2] = 0.5;
        assert_eq!(step_counts.advance(3, |i| has_gradient(&gradient, i)), [0, 1, 0]);
        assert_eq!(step_counts.advance(3, |_| true), [1, 2, 1]);
        step_counts.retain(&[false, true, true]);
        gradient.colours[1][2] = 0.0;
        gradient.opacity_logits[0] = -1.0;
        assert_eq!(step_counts.advance(2, |i| has_gradient(&gradient, i)), [3, 0]);
    }

    /// The first step of Adam is as long as the rate: in pixels of flat Gaussians, a length of balls.
    #[test]
    fn means_of_flat_gaussians_step_by_pixels() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        (0..3).for_each(|_| {
            map.push(Gaussian {
                mean: [0.0; 3],
                log_scale: [-4.0; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity_logit: 0.0,
                colour: [0.0; 3],
            })
        });
        let config = Config::default();
        let mut bounds = ScaleBounds::default();
        [0.01, 3.0].iter().for_each(|pixel| bounds.push(*pixel, [-4.0; 3]));
        let mut optimizer = GaussianOptimizer::new();
        optimizer.gradient = MapGradient::new(&map);
        optimizer.gradient.means.fill([2.0, 0.0, -1.0]);
        optimizer.step_map(&config, &mut map, StepScale { bounds: &bounds, share: 0.5 });
        let rates =
            [FLAT_MEAN_RATE * 0.01, FLAT_MEAN_RATE * 3.0, config.parameters.gaussians.mean_rate];
        for (mean, rate) in map.means.iter().zip(rates) {
            let due = [-0.5 * rate, 0.0, 0.5 * rate];
            let is_near = |(a, b): (&f32, f32)| (a - b).abs() < 1e-4 * rate;
            assert!(mean.iter().zip(due).all(is_near), "{mean:?} {due:?}");
        }
    }

    #[test]
    fn rates_fall_to_a_tenth_in_the_last_third_of_the_final_steps() {
        let shares = [0, 100, 200, 250, 300].map(|step| final_rate_share(step, 300));
        assert_eq!(shares[..3], [1.0; 3]);
        assert!((shares[3] - 0.1_f32.sqrt()).abs() < 1e-6 && (shares[4] - 0.1).abs() < 1e-6);
    }

    /// Differences between channels decay where a view colour is seen, their mean stays.
    #[test]
    fn channels_of_view_colours_come_together() {
        let mut map = GaussianMap::new(Shape::Anisotropic, ColourActivation::Exponential);
        let cone = Cone { rotation: [1.0, 0.0, 0.0, 0.0], spread: 0.1 };
        let row = [0.4, -0.1, 0.3];
        (0..2).for_each(|i| map.view_colours.push(i, cone, &[row; 2]));
        let mut optimizer = GaussianOptimizer::new();
        optimizer.gradient.view_colours = vec![[0.0; 3]; 4];
        optimizer.gradient.view_colours[0] = [1e-6; 3];
        optimizer.step_view_colours(0.0, &mut map);
        let rows = map.view_colours.coefficients_mut();
        let due = row.map(|value| 0.2 + (1.0 - CHANNEL_DECAY) * (value - 0.2));
        assert!(rows[0].iter().zip(due).all(|(a, b)| (a - b).abs() < 1e-6), "{rows:?}");
        assert_eq!(rows[1..], [row; 3]);
    }
}

//! Optimiser steps on exposure, white balance, responses and the motion during exposures.

use super::context::MappingContext;
use super::keyframe::Keyframe;
use crate::config::ResponseScope;
use crate::objective::Evaluation;
use crate::tracking::RESPONSE_NODE_SPACING;
use i2slam_compute::{Adam, AdamSettings};
use i2slam_formation::{
    CurveGradient, FrameTone, FrameToneGradient, ResponsePrior, ShutterTangent,
};
use i2slam_geometry::{Tangent, Vec3};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

/// Epsilon of Adam in SplaTAM's mapping.
const EPSILON: f32 = 1e-15;

/// A new Adam optimiser with the settings of mapping.
pub(super) fn adam() -> Adam {
    Adam::new(AdamSettings { epsilon: EPSILON, ..AdamSettings::default() })
}

/// Optimiser state of all responses and keyframes.
#[derive(Default)]
pub(super) struct FrameOptimizers {
    responses: BTreeMap<usize, Vec<Adam>>,
    /// By the index of the frame.
    frames: BTreeMap<usize, FrameOptimizer>,
}

struct FrameOptimizer {
    exposure: Adam,
    white_balance: Adam,
    translation: Adam,
    rotation: Adam,
}

/// Derivatives of the responses that the frames of a batch were formed with, by response index.
#[derive(Default)]
pub(super) struct ResponseGradients(BTreeMap<usize, CurveGradient<f32>>);

impl ResponseGradients {
    pub(super) fn add(&mut self, response: usize, gradient: CurveGradient<f32>) {
        match self.0.entry(response) {
            Entry::Vacant(entry) => drop(entry.insert(gradient)),
            Entry::Occupied(mut entry) => {
                let sums = entry.get_mut().values.iter_mut().flatten();
                sums.zip(gradient.values.iter().flatten()).for_each(|(sum, g)| *sum += g);
            }
        }
    }
}

impl FrameOptimizers {
    /// One step on tone, response and motion during the exposure of a keyframe; the gauge frame
    /// keeps tone and motion.
    pub(super) fn step(
        &mut self,
        context: &mut MappingContext<'_>,
        keyframe: &Keyframe,
        gauge_frame: usize,
        evaluation: &mut Evaluation,
    ) {
        let frame = keyframe.frame;
        let is_gauge = frame == gauge_frame;
        if let Some(d_curve) = &mut evaluation.curve {
            if !is_gauge {
                self.step_tone(context, frame, &evaluation.tone);
            }
            self.step_response(context, context.frames[frame].response, d_curve);
        }
        if !is_gauge && !keyframe.has_found_motion {
            self.step_motion(context, frame, &evaluation.shutter);
        }
    }

    /// Drops the moments of responses and tones that were replaced.
    pub(super) fn forget_tone(&mut self) {
        self.responses.clear();
        for optimizer in self.frames.values_mut() {
            optimizer.exposure.reset();
            optimizer.white_balance.reset();
        }
    }

    fn frame(&mut self, index: usize) -> &mut FrameOptimizer {
        self.frames.entry(index).or_insert_with(|| FrameOptimizer {
            exposure: adam(),
            white_balance: adam(),
            translation: adam(),
            rotation: adam(),
        })
    }

    /// One step on exposure and white balance. Callers leave out the gauge frame.
    pub(super) fn step_tone(
        &mut self,
        context: &mut MappingContext<'_>,
        frame: usize,
        d_tone: &FrameToneGradient<f32>,
    ) {
        let mut d_tone = *d_tone;
        context.white_balance.project_gradient(&mut d_tone.log_white_balance);
        let gradient = d_tone.to_array();
        let mut values = context.frames[frame].tone.to_array();
        let rates = &context.config.parameters.frames;
        let optimizer = self.frame(context.frames[frame].index);
        let (exposure, balance) = values.split_at_mut(1);
        optimizer.exposure.step(exposure, &gradient[..1], rates.exposure_rate);
        if !context.has_found_white_balance {
            optimizer.white_balance.step(balance, &gradient[1..], rates.white_balance_rate);
        }
        context.frames[frame].tone = FrameTone::from_array(values);
    }

    /// One step on every response of a batch.
    pub(super) fn step_responses(
        &mut self,
        context: &mut MappingContext<'_>,
        gradients: ResponseGradients,
    ) {
        for (index, mut d_curve) in gradients.0 {
            self.step_response(context, index, &mut d_curve);
        }
    }

    /// One step on the nodes of a response, with its prior.
    fn step_response(
        &mut self,
        context: &mut MappingContext<'_>,
        index: usize,
        d_curve: &mut CurveGradient<f32>,
    ) {
        if context.has_found_response {
            return;
        }
        let weight = context.config.parameters.frames.response_prior;
        let scope = context.config.formation.response_scope;
        let response = &mut context.responses[index];
        if weight > 0.0 && scope == ResponseScope::Sequence {
            let prior = ResponsePrior::new(response);
            prior.value_and_gradient(&response.curve(), weight, d_curve);
        }
        let d_nodes = response.pull_back(d_curve);
        let curves = response.nodes.len();
        let optimizers =
            self.responses.entry(index).or_insert_with(|| (0..curves).map(|_| adam()).collect());
        let rate = context.config.parameters.frames.response_rate * RESPONSE_NODE_SPACING;
        for ((nodes, d), adam) in response.nodes.iter_mut().zip(&d_nodes).zip(optimizers) {
            adam.step(nodes, d, rate);
        }
    }

    /// One step on the motion during the exposure, start and end pose each by its own tangent; the
    /// pose at mid-exposure stays. None at rates of zero.
    pub(super) fn step_motion(
        &mut self,
        context: &mut MappingContext<'_>,
        frame: usize,
        d_shutter: &ShutterTangent<f64>,
    ) {
        let rates = &context.config.parameters.frames;
        if rates.motion_rotation_rate <= 0.0 && rates.motion_translation_rate <= 0.0 {
            return;
        }
        let optimizer = self.frame(context.frames[frame].index);
        let gradient = d_shutter.to_array().map(|g| g as f32);
        let pick = |from: [usize; 6]| from.map(|i| gradient[i]);
        let (mut translation, mut rotation) = ([0.0; 6], [0.0; 6]);
        let rate = rates.motion_translation_rate;
        optimizer.translation.step(&mut translation, &pick([0, 1, 2, 6, 7, 8]), rate);
        let rate = rates.motion_rotation_rate;
        optimizer.rotation.step(&mut rotation, &pick([3, 4, 5, 9, 10, 11]), rate);
        let side = |at: usize| Tangent {
            translation: Vec3::new(translation[at], translation[at + 1], translation[at + 2])
                .cast(),
            rotation: Vec3::new(rotation[at], rotation[at + 1], rotation[at + 2]).cast(),
        };
        let step = ShutterTangent::<f64> { start: side(0), end: side(3) };
        let shutter = &mut context.frames[frame].shutter;
        *shutter = shutter.retract(&step).with_middle(shutter.middle());
    }
}

//! One step of mapping: the joint optimisation of map, tone, response and keyframe poses.

use super::Keyframe;
use super::ages::Ages;
use crate::config::{Config, ResponseScope};
use crate::objective::{Evaluation, Exposure, FrameObjective, FrameVariables, Sampling, Tone};
use crate::reconstruction::FrameEstimate;
use crate::tracking::{NODE_STEP, mask_white_balance};
use i2slam_compute::{Adam, AdamSettings};
use i2slam_formation::{CameraResponse, FrameTone, ResponsePrior, ShutterTangent};
use i2slam_geometry::{Tangent, Vec3};
use i2slam_radiance::gaussian::{GaussianMap, MapGradient, Shape};
use std::collections::BTreeMap;

/// SplaTAM's epsilon while mapping.
const EPSILON: f32 = 1e-15;

/// Optimiser state of map, response and keyframes.
pub(crate) struct MapOptimizer {
    gradient: MapGradient,
    means: Adam,
    log_scales: Adam,
    rotations: Adam,
    opacities: Adam,
    colours: Adam,
    ages: Ages,
    responses: BTreeMap<usize, Vec<Adam>>,
    frames: BTreeMap<usize, FrameOptimizer>,
}

/// Optimiser state of one keyframe.
struct FrameOptimizer {
    tone: Adam,
    translation: Adam,
    rotation: Adam,
}

/// What a step works on.
pub(crate) struct Sight<'a> {
    pub(crate) config: &'a Config,
    pub(crate) objective: &'a mut FrameObjective,
    pub(crate) map: &'a mut GaussianMap,
    pub(crate) frames: &'a mut [FrameEstimate],
    pub(crate) responses: &'a mut [CameraResponse<f32>],
    /// The frame whose pose and tone stay as they are: the first that was mapped.
    pub(crate) gauge_frame: usize,
    /// How the keyframe's exposure is sampled.
    pub(crate) sampling: Sampling,
}

fn adam() -> Adam {
    Adam::new(AdamSettings { epsilon: EPSILON, ..AdamSettings::default() })
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
            responses: BTreeMap::new(),
            frames: BTreeMap::new(),
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
    pub(crate) fn step(&mut self, sight: &mut Sight<'_>, keyframe: &Keyframe) -> Evaluation {
        let estimate = &sight.frames[keyframe.frame];
        let mapping = &sight.config.mapping;
        let curve = sight.config.formation.tone.then(|| sight.responses[estimate.response].curve());
        let variables = FrameVariables {
            exposure: Exposure {
                shutter: estimate.shutter,
                sampling: sight.sampling,
                readout: estimate.readout,
                depth_pose: estimate.depth_is_apart().then(|| estimate.depth_pose()),
            },
            tone: curve.as_ref().map(|curve| Tone { frame: estimate.tone, curve }),
        };
        self.gradient.reset(sight.map.len());
        let mut evaluation = sight.objective.map(
            sight.map,
            &keyframe.observation,
            &variables,
            mapping.ssim_share,
            (mapping.image_weight, mapping.depth_weight),
            &mut self.gradient,
        );
        self.step_map(sight.config, sight.map);
        if curve.is_some() {
            self.step_tone(sight, keyframe.frame, &evaluation);
            self.step_response(sight, keyframe.frame, &mut evaluation);
        }
        let moves = mapping.pose_rotation_rate > 0.0 || mapping.pose_translation_rate > 0.0;
        if keyframe.frame != sight.gauge_frame && moves {
            self.step_pose(sight, keyframe.frame, &evaluation);
        }
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

    fn frame(&mut self, index: usize) -> &mut FrameOptimizer {
        self.frames.entry(index).or_insert_with(|| FrameOptimizer {
            tone: adam(),
            translation: adam(),
            rotation: adam(),
        })
    }

    /// Exposure and white balance; the gauge frame keeps both, which fixes the gauge.
    fn step_tone(&mut self, sight: &mut Sight<'_>, frame: usize, evaluation: &Evaluation) {
        if frame == sight.gauge_frame {
            return;
        }
        let mut gradient = evaluation.tone.to_array();
        mask_white_balance(sight.config.formation.white_balance, &mut gradient);
        let tone = &mut sight.frames[frame].tone;
        let mut values = tone.to_array();
        self.frame(frame).tone.step(&mut values, &gradient, sight.config.mapping.tone_rate);
        *tone = FrameTone::from_array(values);
    }

    fn step_response(&mut self, sight: &mut Sight<'_>, frame: usize, evaluation: &mut Evaluation) {
        let Some(d_curve) = &mut evaluation.curve else { return };
        let formation = &sight.config.formation;
        let index = sight.frames[frame].response;
        let response = &mut sight.responses[index];
        if formation.response_prior > 0.0 && formation.response_scope == ResponseScope::Sequence {
            let prior = ResponsePrior::new(response);
            prior.value_and_gradient(&response.curve(), formation.response_prior, d_curve);
        }
        let d_nodes = response.pull_back(d_curve);
        let curves = response.nodes.len();
        let optimizers =
            self.responses.entry(index).or_insert_with(|| (0..curves).map(|_| adam()).collect());
        let rate = sight.config.mapping.response_rate * NODE_STEP;
        for ((nodes, d), adam) in response.nodes.iter_mut().zip(&d_nodes).zip(optimizers) {
            adam.step(nodes, d, rate);
        }
    }

    /// Start and end pose, each by a tangent of its own.
    fn step_pose(&mut self, sight: &mut Sight<'_>, frame: usize, evaluation: &Evaluation) {
        let rates = &sight.config.mapping;
        let optimizer = self.frame(frame);
        let gradient = evaluation.shutter.to_array().map(|g| g as f32);
        let pick = |from: [usize; 6]| from.map(|i| gradient[i]);
        let (mut translation, mut rotation) = ([0.0; 6], [0.0; 6]);
        let rate = rates.pose_translation_rate;
        optimizer.translation.step(&mut translation, &pick([0, 1, 2, 6, 7, 8]), rate);
        let rate = rates.pose_rotation_rate;
        optimizer.rotation.step(&mut rotation, &pick([3, 4, 5, 9, 10, 11]), rate);
        let side = |at: usize| Tangent {
            translation: Vec3::new(translation[at], translation[at + 1], translation[at + 2])
                .cast(),
            rotation: Vec3::new(rotation[at], rotation[at + 1], rotation[at + 2]).cast(),
        };
        let step = ShutterTangent::<f64> { start: side(0), end: side(3) };
        sight.frames[frame].shutter = sight.frames[frame].shutter.retract(&step);
    }
}

//! State that every kind of session keeps.

use crate::config::{Config, FormationConfig};
use crate::mapping::{Keyframe, MappingContext};
use crate::reconstruction::{FrameEstimate, Map, Reconstruction};
use crate::warning::Warning;
use i2slam_compute::{CancellationToken, Random};
use i2slam_formation::{CameraResponse, NodeSpacing};
use i2slam_geometry::{Camera, Image};
use std::fmt::Display;
use std::sync::Arc;

/// Mean of a picture in [0, 1] below which it is black, about one 8-bit code value.
const MIN_MEAN_VALUE: f32 = 0.004;

/// Estimates, keyframes and responses of a session, and what mapping needs besides.
pub(super) struct SessionState {
    pub(super) frames: Vec<FrameEstimate>,
    pub(super) keyframes: Vec<Keyframe>,
    pub(super) responses: Vec<CameraResponse<f32>>,
    /// Mask of the pixels that the camera recorded; `None`: all.
    pub(super) valid_mask: Option<Arc<Image<bool>>>,
    pub(super) warnings: Vec<Warning>,
    pub(super) cancellation: CancellationToken,
    random: Random,
}

impl SessionState {
    pub(super) fn new(config: &Config) -> Self {
        Self {
            frames: Vec::new(),
            keyframes: Vec::new(),
            responses: vec![initial_response(config)],
            valid_mask: None,
            warnings: Vec::new(),
            cancellation: CancellationToken::default(),
            random: Random::new(config.seed),
        }
    }

    /// The state for mapping with the first `keyframes`.
    pub(super) fn mapping_context<'a>(
        &'a mut self,
        config: &'a Config,
        camera: &'a Camera<f64>,
        keyframes: usize,
    ) -> MappingContext<'a> {
        MappingContext {
            config,
            camera,
            frames: &mut self.frames,
            keyframes: &self.keyframes[..keyframes],
            responses: &mut self.responses,
            valid_mask: self.valid_mask.as_deref(),
            random: &mut self.random,
            warnings: &mut self.warnings,
            cancellation: &self.cancellation,
        }
    }

    pub(super) fn warn(&mut self, index: usize, text: impl Display) {
        self.warnings.push(Warning::of_frame(index, text));
    }

    pub(super) fn reconstruction(
        &self,
        config: &Config,
        camera: &Camera<f64>,
        map: Map,
        rolling_shutter_readout: f64,
    ) -> Reconstruction {
        Reconstruction {
            config: config.clone(),
            camera: *camera,
            frames: self.frames.clone(),
            map,
            responses: self.responses.clone(),
            rolling_shutter_readout,
        }
    }
}

/// The camera response before the first frame.
fn initial_response(config: &Config) -> CameraResponse<f32> {
    let FormationConfig { response_curves, response_start, .. } = config.formation;
    let spacing = match config.parameters.frames.response_node_power {
        1.0 => NodeSpacing::Uniform,
        power => NodeSpacing::Power(f64::from(power)),
    };
    CameraResponse::new(response_curves, response_start, spacing)
}

/// Why a picture shows nothing that could be mapped, if so: it is black or not a number, or of one
/// colour within a step of eight bits, as a camera without signal gives it.
pub(super) fn blank_reason(colour: &Image<f32>) -> Option<&'static str> {
    let mean = colour.data.iter().sum::<f32>() / colour.data.len().max(1) as f32;
    if mean.is_nan() || mean < MIN_MEAN_VALUE {
        return Some("its picture is black");
    }
    let is_uniform = |channel: usize| {
        let (low, high) = colour
            .plane(channel)
            .iter()
            .fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), &v| (l.min(v), h.max(v)));
        high - low < 1.5 / 255.0
    };
    (0..colour.channels).all(is_uniform).then_some("its picture is of one colour")
}

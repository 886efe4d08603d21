//! Estimates of a session, and what mapping needs besides.

use crate::config::{Config, FormationConfig};
use crate::mapping::{Keyframe, LensVignetting, MappingContext};
use crate::reconstruction::{FrameEstimate, Map, Reconstruction, UnitOfLength};
use crate::warning::Warning;
use i2slam_compute::{CancellationToken, Random};
use i2slam_formation::{CameraResponse, NodeSpacing, Vignetting, WhiteBalanceModel};
use i2slam_geometry::{Camera, Image};
use i2slam_storage::ScratchStore;
use std::fmt::Display;
use std::path::Path;
use std::sync::Arc;

/// Share of pictures in the memory of a run: the map, its renders, points and tracks take the rest.
const PICTURE_SHARE: f64 = 1.0 / 6.0;

/// Estimates, keyframes and responses of a session, and what mapping needs besides.
pub(super) struct SessionState {
    pub(super) frames: Vec<FrameEstimate>,
    pub(super) keyframes: Vec<Keyframe>,
    pub(super) responses: Vec<CameraResponse<f32>>,
    /// Whether the response was found from pictures, and is no longer stepped.
    pub(super) has_found_response: bool,
    /// Powers of the response's channels over one that all have in common.
    pub(super) channel_powers: [f64; 3],
    /// True if white balance is constant, false if it changes; `None` until pictures have told. It is no
    /// longer stepped then.
    pub(super) has_constant_white_balance: Option<bool>,
    /// Vignetting, where it was found.
    pub(super) vignetting: Option<LensVignetting>,
    /// Mask of the pixels that the camera recorded; `None`: all.
    pub(super) valid_mask: Option<Arc<Image<bool>>>,
    pub(super) warnings: Vec<Warning>,
    pub(super) cancellation: CancellationToken,
    /// Pictures of keyframes.
    pub(super) scratch: Arc<ScratchStore>,
    random: Random,
}

impl SessionState {
    pub(super) fn new(config: &Config) -> Self {
        Self {
            frames: Vec::new(),
            keyframes: Vec::new(),
            responses: vec![initial_response(config)],
            has_found_response: false,
            channel_powers: [1.0; 3],
            has_constant_white_balance: None,
            vignetting: None,
            valid_mask: None,
            warnings: Vec::new(),
            cancellation: CancellationToken::default(),
            scratch: scratch_store(config, &std::env::temp_dir()),
            random: Random::new(config.seed),
        }
    }

    /// The state for mapping.
    pub(super) fn mapping_context<'a>(
        &'a mut self,
        config: &'a Config,
        camera: &'a Camera<f64>,
    ) -> MappingContext<'a> {
        let white_balance = self.white_balance(config);
        MappingContext {
            config,
            camera,
            frames: &mut self.frames,
            keyframes: &self.keyframes,
            responses: &mut self.responses,
            has_found_response: self.has_found_response,
            channel_powers: self.channel_powers,
            has_found_white_balance: self.has_constant_white_balance.is_some(),
            white_balance,
            vignetting: self.vignetting.as_ref().map(LensVignetting::at_pixels),
            valid_mask: self.valid_mask.as_deref(),
            random: &mut self.random,
            warnings: &mut self.warnings,
            cancellation: &self.cancellation,
        }
    }

    /// White balance of frames: that of the configuration, until it proves constant.
    pub(super) fn white_balance(&self, config: &Config) -> WhiteBalanceModel {
        match self.has_constant_white_balance {
            Some(true) => WhiteBalanceModel::Fixed,
            Some(false) | None => config.formation.white_balance,
        }
    }

    pub(super) fn warn(&mut self, index: usize, text: impl Display) {
        self.warnings.push(Warning::of_frame(index, text));
    }

    /// Warns of keyframes that were not found in the map.
    pub(super) fn warn_of_keyframes_not_found(&mut self) {
        let lost = self.frames.iter().filter(|f| f.keyframe && !f.tracked);
        self.warnings.extend(lost.map(|f| {
            let text =
                "not found in the map: its pose is that of the front end, refined with the map";
            Warning::of_frame(f.index, text)
        }));
    }

    /// Warns of pictures that could not be read back.
    pub(super) fn warn_of_scratch(&mut self) {
        let failure = self.scratch.failure();
        self.warnings.extend(failure.map(|reason| {
            format!(
                "pictures that had left memory could not be read back ({reason}), and the map was \
                 made with black ones instead: check the disk, or allow more `memory`"
            )
            .into()
        }));
    }

    pub(super) fn reconstruction(
        &self,
        config: &Config,
        camera: &Camera<f64>,
        map: Map,
        rolling_shutter_readout: f64,
    ) -> Reconstruction {
        let estimates = (self.frames.as_slice(), self.responses.as_slice());
        let lens = (self.lens_vignetting(), rolling_shutter_readout);
        reconstruction((config, camera), estimates, map, lens)
    }

    /// Loss of light towards the corners, as far as it is known.
    pub(super) fn lens_vignetting(&self) -> Vignetting<f32> {
        self.vignetting.as_ref().map(LensVignetting::lens).unwrap_or_default()
    }
}

/// A copy of settings, camera, frames and responses with a map.
pub(super) fn reconstruction(
    (config, camera): (&Config, &Camera<f64>),
    (frames, responses): (&[FrameEstimate], &[CameraResponse<f32>]),
    map: Map,
    (vignetting, rolling_shutter_readout): (Vignetting<f32>, f64),
) -> Reconstruction {
    Reconstruction {
        config: config.clone(),
        camera: *camera,
        frames: frames.to_vec(),
        online_trajectory: Vec::new(),
        map,
        responses: responses.to_vec(),
        vignetting,
        rolling_shutter_readout,
        unit_of_length: UnitOfLength::of_pictures(config),
    }
}

/// Memory for the pictures of past frames, others in a file in a folder.
pub(crate) fn scratch_store(config: &Config, folder: &Path) -> Arc<ScratchStore> {
    ScratchStore::new((PICTURE_SHARE * 1e9 * config.memory) as usize, folder)
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

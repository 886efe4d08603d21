//! What a session starts from.

use crate::config::{Config, FormationConfig, ResponseStart};
use i2slam_formation::{CameraResponse, NodeSpacing, StartCurve};
use i2slam_radiance::gaussian::{ColourActivation, GaussianMap, RasterSettings, Shape};

/// An empty map: log-radiance, or SplaTAM's raw colours with `tone` off.
pub(super) fn empty_map(config: &Config) -> GaussianMap {
    let shape = if config.map.isotropic { Shape::Isotropic } else { Shape::Anisotropic };
    let activation = match config.formation.tone {
        true => ColourActivation::Exponential,
        false => ColourActivation::Linear,
    };
    GaussianMap::new(shape, activation)
}

/// The response before any frame was seen.
pub(super) fn response(config: &Config) -> CameraResponse<f32> {
    let FormationConfig { response_curves, response_start, response_node_power, .. } =
        config.formation;
    let start = match response_start {
        ResponseStart::Srgb => StartCurve::Srgb,
        ResponseStart::Gamma22 => StartCurve::Gamma22,
        ResponseStart::Identity => StartCurve::Identity,
        ResponseStart::Shoulder => StartCurve::Shoulder,
    };
    let spacing = match response_node_power {
        1.0 => NodeSpacing::Uniform,
        power => NodeSpacing::Power(f64::from(power)),
    };
    CameraResponse::new(response_curves, start, spacing)
}

/// The rasteriser's settings.
pub(crate) fn raster_settings(config: &Config) -> RasterSettings {
    RasterSettings { screen_variance: config.map.screen_variance, ..RasterSettings::default() }
}

//! What a session starts from.

use crate::config::{Config, FormationConfig, MapKind, ResponseStart};
use crate::mapping::{
    FieldMapper, GaussianMapper, Mapper, PosedField, PosedGaussians, PosedMapper,
};
use i2slam_formation::{CameraResponse, NodeSpacing, StartCurve};
use i2slam_geometry::Camera;

/// A map that nothing is known of yet.
pub(super) fn mapper(config: &Config, camera: &Camera<f64>) -> Box<dyn Mapper> {
    match config.map.kind {
        MapKind::Gaussian => Box::new(GaussianMapper::new(config, camera)),
        MapKind::HashGrid => Box::new(FieldMapper::new(camera)),
    }
}

/// The same for keyframes that come with poses, of a video of `frame_rate` frames per second.
pub(super) fn posed_mapper(
    config: &Config,
    camera: &Camera<f64>,
    frame_rate: f64,
) -> Box<dyn PosedMapper> {
    match config.map.kind {
        MapKind::Gaussian => Box::new(PosedGaussians::new(config, camera, frame_rate)),
        MapKind::HashGrid => Box::new(PosedField::new(camera, frame_rate)),
    }
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

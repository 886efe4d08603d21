//! `state.json` and `camera.json`: what the tables do not hold.

use i2slam::formation::tone::NODES;
use i2slam::formation::{CameraResponse, NodeSpacing, StartCurve};
use i2slam::geometry::Camera;
use serde::{Deserialize, Serialize};

/// Version of the folder's layout.
pub(crate) const FORMAT: u32 = 1;

/// The free numbers of the camera responses.
#[derive(Serialize, Deserialize)]
pub(crate) struct State {
    pub(crate) format: u32,
    pub(crate) responses: Vec<ResponseState>,
    /// First to last row [s].
    #[serde(default)]
    pub(crate) rolling_shutter_readout: f64,
}

#[derive(Serialize, Deserialize)]
pub(crate) struct ResponseState {
    start: StartCurve,
    /// Exponent of the node spacing; none is uniform.
    node_power: Option<f64>,
    nodes: Vec<Vec<f32>>,
}

impl State {
    pub(crate) fn of(responses: &[CameraResponse<f32>], rolling_shutter_readout: f64) -> Self {
        let responses = responses.iter().map(ResponseState::of).collect();
        Self { format: FORMAT, responses, rolling_shutter_readout }
    }
}

impl ResponseState {
    fn of(response: &CameraResponse<f32>) -> Self {
        let node_power = match response.spacing() {
            NodeSpacing::Uniform => None,
            NodeSpacing::Power(power) => Some(power),
        };
        Self { start: response.start(), node_power, nodes: response.nodes.clone() }
    }

    /// The response, or what is wrong with it.
    pub(crate) fn response(self) -> Result<CameraResponse<f32>, String> {
        let spacing = self.node_power.map_or(NodeSpacing::Uniform, NodeSpacing::Power);
        let curves = self.nodes.len();
        if !matches!(curves, 1 | 3) || self.nodes.iter().any(|n| n.len() != NODES) {
            return Err(format!("a camera response needs 1 or 3 curves of {NODES} nodes"));
        }
        let mut response = CameraResponse::new(curves, self.start, spacing);
        response.nodes = self.nodes;
        Ok(response)
    }
}

/// The camera of the pictures under `renders/`, readable as a dataset's `camera.json`.
#[derive(Serialize, Deserialize)]
pub(crate) struct CameraFile {
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Where pixel (0, 0) has its centre.
    pixel_centre: f64,
    distortion: [f64; 5],
    depth_scale: f64,
}

impl CameraFile {
    pub(crate) fn of(camera: &Camera<f64>) -> Self {
        let &Camera { width, height, fx, fy, cx, cy } = camera;
        let depth_scale = f64::from(super::DEPTH_UNITS_PER_METRE);
        Self { width, height, fx, fy, cx, cy, pixel_centre: 0.5, distortion: [0.0; 5], depth_scale }
    }

    pub(crate) fn camera(self) -> Result<Camera<f64>, String> {
        let shift = 0.5 - self.pixel_centre;
        let Self { width, height, fx, fy, cx, cy, .. } = self;
        let numbers = [fx, fy, cx, cy, shift];
        if width == 0
            || height == 0
            || fx <= 0.0
            || fy <= 0.0
            || numbers.iter().any(|v| !v.is_finite())
        {
            return Err("has no usable camera".to_owned());
        }
        Ok(Camera { width, height, fx, fy, cx: cx + shift, cy: cy + shift })
    }
}

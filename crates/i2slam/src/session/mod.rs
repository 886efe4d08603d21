//! Sessions: frames or keyframes go in one by one, a reconstruction comes out.

mod backend;
mod frame_tracker;
mod keyframe;
mod online;
mod runtime_estimate;

pub use keyframe::KeyframeSession;
pub use online::Session;
pub use runtime_estimate::RuntimeEstimate;

use crate::config::{Config, FormationConfig, MapKind};
use crate::mapping::{
    FieldMapper, GaussianMapper, JointFieldMapper, JointGaussianMapper, JointMapper, Mapper,
};
use i2slam_formation::{CameraResponse, NodeSpacing};
use i2slam_geometry::Camera;
use i2slam_radiance::hashgrid::SettingsError;

/// A map that nothing is known of yet.
fn mapper(config: &Config, camera: &Camera<f64>) -> Box<dyn Mapper> {
    match config.map.kind {
        MapKind::Gaussian => Box::new(GaussianMapper::new(config, camera)),
        MapKind::HashGrid => Box::new(FieldMapper::new(camera)),
    }
}

/// The same for keyframes that come with poses, of a video of `frame_rate` frames per second.
fn posed_mapper(config: &Config, camera: &Camera<f64>, frame_rate: f64) -> Box<dyn JointMapper> {
    match config.map.kind {
        MapKind::Gaussian => Box::new(JointGaussianMapper::new(config, camera, frame_rate)),
        MapKind::HashGrid => Box::new(JointFieldMapper::new(camera, frame_rate)),
    }
}

/// The response before any frame was seen.
fn response(config: &Config) -> CameraResponse<f32> {
    let FormationConfig { response_curves, response_start, .. } = config.formation;
    let spacing = match config.parameters.frames.response_node_power {
        1.0 => NodeSpacing::Uniform,
        power => NodeSpacing::Power(f64::from(power)),
    };
    CameraResponse::new(response_curves, response_start, spacing)
}

/// Mean picture value under which a frame says nothing about the map's radiance.
const MIN_MEAN_BRIGHTNESS: f32 = 0.004;

/// What can go wrong while a frame is processed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// The frame does not fit the camera of the session.
    #[error(
        "frame {index}: its {what} is {actual:?} pixels, expected {expected:?}: all frames of a \
         sequence must have one size"
    )]
    Size {
        /// Position in the associated stream.
        index: usize,
        /// Colour or depth.
        what: &'static str,
        /// Width and height of the frame.
        actual: (usize, usize),
        /// Width and height of the camera.
        expected: (usize, usize),
    },
    /// A picture does not hold the numbers that its size asks for.
    #[error(
        "frame {index}: its {what} holds {values} numbers in {channels} channels, expected \
         {expected} channels of its size"
    )]
    Channels {
        /// Position in the associated stream.
        index: usize,
        /// Colour or depth.
        what: &'static str,
        /// Numbers that it holds.
        values: usize,
        /// Channels that it is said to have.
        channels: usize,
        /// Channels that it should have.
        expected: usize,
    },
    /// A keyframe came with a time that is no time.
    #[error("frame {index}: its time stamp is not finite")]
    Stamp {
        /// Position in the associated stream.
        index: usize,
    },
    /// A keyframe came with a pose that is no pose.
    #[error("frame {index}: its pose holds a number that is not finite")]
    Pose {
        /// Position in the associated stream.
        index: usize,
    },
    /// The map cannot be started with its settings: no further frame can be tracked.
    #[error("the map cannot be started: {source}")]
    Map {
        /// The setting.
        source: SettingsError,
    },
}

#[cfg(test)]
mod tests;

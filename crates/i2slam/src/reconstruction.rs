//! Results of a session: poses, tone, map and responses of a sequence.

use crate::config::Config;
use i2slam_compute::median;
use i2slam_formation::{CameraResponse, FrameTone, ResponseCurve, ShutterPoses, Vignetting};
use i2slam_geometry::{Camera, Pose, StampedPose, Tangent};
use i2slam_radiance::gaussian::{ColourActivation, GaussianMap, Shape};
use i2slam_radiance::hashgrid::HashGridMap;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Unweighted terms of eq. 12 at the end of tracking a frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Mean absolute colour difference over valid pixels.
    pub image: f64,
    /// Mean absolute depth difference [m] over valid pixels.
    pub depth: f64,
    /// Trajectory loss, eq. 15; zero after second-order tracking, which has a prior in its place.
    pub trajectory: f64,
}

/// Convergence and deviations of a pose. Where poses stay as the front end found them (`default`),
/// these are of its adjustment ([`i2slam_odometry::PoseDeviation`]), against the frames within a
/// quarter of a second; otherwise of second-order tracking. Default for first-order tracking and
/// unaligned frames.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Convergence {
    /// Whether the adjustment ended within a deviation of its minimum and the frame's picture
    /// is sound, or the last step of tracking was below 0.02 px.
    pub converged: bool,
    /// Steps of tracking tried, over all pyramid levels.
    pub iterations: usize,
    /// Standard deviation of the position at mid-exposure [m], root of the summed variances of its
    /// coordinates. That of tracking is formal, for independent residual noise per pixel.
    pub position_deviation: Option<f64>,
    /// Standard deviation of the rotation [rad], likewise.
    pub rotation_deviation: Option<f64>,
}

/// Everything estimated about one frame.
#[derive(Clone, Debug)]
pub struct FrameEstimate {
    /// Position in the associated stream of the dataset.
    pub index: usize,
    /// Time of the colour picture [s].
    pub timestamp: f64,
    /// World-from-camera poses at shutter open and close.
    pub shutter: ShutterPoses<f64>,
    /// Time from the first to the last row [exposures]; 0 for a global shutter.
    pub readout: f64,
    /// Camera motion from mid-exposure to the time of the depth picture; zero if simultaneous.
    pub depth_offset: Tangent<f64>,
    /// Exposure and white balance.
    pub tone: FrameTone<f32>,
    /// Index among the responses of the reconstruction.
    pub response: usize,
    /// Whether the frame is a keyframe of mapping.
    pub keyframe: bool,
    /// Whether it was tracked but not mapped: by `mapping.hold_out`, or between posed keyframes.
    pub held_out: bool,
    /// Whether tracking succeeded; otherwise the pose is predicted.
    pub tracked: bool,
    /// True if tone and motion during the exposure were estimated; otherwise the pose alone is known, as in
    /// runs that ended early: tone is that of the frame before, blur length and losses are 0.
    pub refined: bool,
    /// Losses at the end of tracking.
    pub losses: Losses,
    /// Convergence of tracking.
    pub convergence: Convergence,
    /// Blur length: median over pixels of the image motion during exposure [px].
    pub blur_length: f64,
    /// Wall time of tracking [s].
    pub tracking_seconds: f64,
    /// Wall time of mapping [s].
    pub mapping_seconds: f64,
    /// Gaussians in the map after this frame.
    pub gaussians: usize,
}

impl FrameEstimate {
    /// A frame at known shutter poses: global shutter, default tone, tracked, not mapped.
    pub(crate) fn at_pose(index: usize, timestamp: f64, shutter: ShutterPoses<f64>) -> Self {
        Self {
            index,
            timestamp,
            shutter,
            readout: 0.0,
            depth_offset: Tangent::zero(),
            tone: FrameTone::default(),
            response: 0,
            keyframe: false,
            held_out: false,
            tracked: true,
            refined: true,
            losses: Losses::default(),
            convergence: Convergence::default(),
            blur_length: 0.0,
            tracking_seconds: 0.0,
            mapping_seconds: 0.0,
            gaussians: 0,
        }
    }

    /// World-from-camera at mid-exposure.
    pub fn middle(&self) -> Pose<f64> {
        self.shutter.middle()
    }

    /// World-from-camera at mid-exposure, with its time.
    pub(crate) fn stamped_pose(&self) -> StampedPose {
        StampedPose { timestamp: self.timestamp, world_from_camera: self.middle() }
    }

    /// Whether the camera moved by more than 1 mm or 1 mrad between colour and depth picture.
    pub(crate) fn depth_is_apart(&self) -> bool {
        let lead = self.depth_offset;
        lead.translation.norm() > 1e-3 || lead.rotation.norm() > 1e-3
    }

    /// World-from-camera when the depth picture was taken.
    pub fn depth_pose(&self) -> Pose<f64> {
        self.middle().retract(self.depth_offset)
    }
}

/// A radiance map.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::large_enum_variant, reason = "a run has one map, most often of Gaussians")]
pub enum Map {
    /// 3D Gaussians.
    Gaussians(GaussianMap<f32>),
    /// A radiance field in a hash grid.
    HashGrid(Box<HashGridMap>),
}

impl Default for Map {
    /// A map without Gaussians.
    fn default() -> Self {
        Self::Gaussians(GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential))
    }
}

impl Map {
    /// Whether there is nothing to render: no Gaussians, as of a hash grid that was never started.
    pub fn is_empty(&self) -> bool {
        matches!(self, Self::Gaussians(map) if map.is_empty())
    }

    /// Number of Gaussians; 0 for a hash grid.
    pub fn gaussians(&self) -> usize {
        match self {
            Self::Gaussians(map) => map.len(),
            Self::HashGrid(_) => 0,
        }
    }
}

impl fmt::Display for Map {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Gaussians(map) if map.len() == 1 => write!(f, "1 Gaussian"),
            Self::Gaussians(map) => write!(f, "{} Gaussians", map.len()),
            Self::HashGrid(map) => {
                let p = map.field.parameters();
                let numbers = p.table.len() + p.density.len() + p.colour.len();
                write!(f, "a hash grid of {:.1} million numbers", numbers as f64 * 1e-6)
            }
        }
    }
}

/// Unit of length of poses, depth and map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum UnitOfLength {
    /// That of the depth pictures.
    #[default]
    Metre,
    /// That of the keyframes of another program, whose world it is, too.
    Keyframes,
    /// Arbitrary: pictures alone do not tell the scale.
    Unknown,
}

impl UnitOfLength {
    /// That of a run whose poses no file gives.
    pub fn of_pictures(config: &Config) -> Self {
        if config.is_rgb() { Self::Unknown } else { Self::Metre }
    }
}

/// A reconstructed sequence.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Settings of the run.
    pub config: Config,
    /// The camera of the processed frames.
    pub camera: Camera<f64>,
    /// One estimate per processed frame, in order of time.
    pub frames: Vec<FrameEstimate>,
    /// Poses at mid-exposure as they were known when their frames came, seen from the first of them,
    /// with depth in metres and otherwise in a unit of their own; empty unless poses are those of
    /// visual odometry with a known camera.
    pub online_trajectory: Vec<StampedPose>,
    /// The map, in the frame of the first camera at mid-exposure.
    pub map: Map,
    /// Camera responses: one, or one per frame.
    pub responses: Vec<CameraResponse<f32>>,
    /// Vignetting of the lens; zero where none was found.
    pub vignetting: Vignetting<f32>,
    /// Readout time of a picture, set or estimated [s]; 0 for a global shutter.
    pub rolling_shutter_readout: f64,
    /// Unit of length of all of these.
    pub unit_of_length: UnitOfLength,
}

impl Reconstruction {
    /// The trajectory at mid-exposure.
    pub fn trajectory(&self) -> Vec<StampedPose> {
        self.frames.iter().map(FrameEstimate::stamped_pose).collect()
    }

    /// Median exposure and white balance, and the response of the middle frame, if there are any.
    pub fn typical_tone(&self) -> Option<(FrameTone<f32>, ResponseCurve<f32>)> {
        if !self.config.formation.tone || self.frames.is_empty() {
            return None;
        }
        let typical = |i: usize| {
            let mut values: Vec<f32> = self.frames.iter().map(|f| f.tone.to_array()[i]).collect();
            median(&mut values).unwrap_or(0.0)
        };
        let response = self.responses.get(self.frames[self.frames.len() / 2].response)?;
        Some((FrameTone::from_array(std::array::from_fn(typical)), response.curve()))
    }

    /// A virtual frame of a still camera with the typical tone.
    pub fn virtual_frame(&self, index: usize, world_from_camera: Pose<f64>) -> FrameEstimate {
        let tone = self.typical_tone().map_or_else(FrameTone::default, |(tone, _)| tone);
        let response = self.frames.get(self.frames.len() / 2).map_or(0, |f| f.response);
        FrameEstimate {
            tone,
            response,
            gaussians: self.map.gaussians(),
            ..FrameEstimate::at_pose(index, 0.0, ShutterPoses::still(world_from_camera))
        }
    }
}

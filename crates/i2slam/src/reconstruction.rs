//! What a session leaves behind: poses, tone, map and response of a sequence.

use crate::config::Config;
use i2slam_formation::{CameraResponse, FrameTone, ResponseCurve, ShutterPoses};
use i2slam_geometry::{Camera, Pose, StampedPose, Tangent};
use i2slam_radiance::gaussian::{ColourActivation, GaussianMap, Shape};
use i2slam_radiance::hashgrid::HashGridMap;
use std::fmt;

/// The three terms of eq. 12 at the end of a frame's tracking, unweighted.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Losses {
    /// Mean absolute difference of pictures, over the pixels that count.
    pub image: f64,
    /// Mean absolute difference of depth [m], over the pixels that count.
    pub depth: f64,
    /// Trajectory loss, eq. 15; zero after second-order tracking, which has a prior in its place.
    pub trajectory: f64,
}

/// How second-order tracking of a frame ended. First-order tracking and frames that were not
/// aligned leave it empty.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Convergence {
    /// Whether the last step was too short to matter (0.02 px).
    pub converged: bool,
    /// Steps tried, over all levels of the pictures.
    pub iterations: usize,
    /// Formal standard deviation of the position at mid-exposure [m]: root of the summed variances
    /// of its three coordinates, of the residuals' noise alone, taking pixels to be independent.
    pub position_deviation: Option<f64>,
    /// The same of the rotation [rad].
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
    /// Motion from mid-exposure to the moment of the depth picture, in the camera's frame; zero
    /// where both were taken together.
    pub depth_lead: Tangent<f64>,
    /// Exposure and white balance.
    pub tone: FrameTone<f32>,
    /// Which of the reconstruction's responses forms this frame.
    pub response: usize,
    /// Whether the frame entered the mapping window for good.
    pub keyframe: bool,
    /// Whether the map never saw the frame, by `mapping.hold_out` or because it lies between
    /// keyframes that came with poses: it was tracked alone.
    pub held_out: bool,
    /// Whether tracking converged (otherwise the pose is an extrapolation).
    pub tracked: bool,
    /// Losses at the end of tracking.
    pub losses: Losses,
    /// How the descent ended.
    pub convergence: Convergence,
    /// Median length of the streak that a pixel draws during the exposure [px].
    pub blur_length: f64,
    /// Wall time of tracking [s].
    pub tracking_seconds: f64,
    /// Wall time of mapping [s].
    pub mapping_seconds: f64,
    /// Gaussians in the map after this frame.
    pub gaussians: usize,
}

impl FrameEstimate {
    /// A frame of which only the pose is known: global shutter, no gains, tracked, not mapped.
    pub(crate) fn posed(index: usize, timestamp: f64, shutter: ShutterPoses<f64>) -> Self {
        Self {
            index,
            timestamp,
            shutter,
            readout: 0.0,
            depth_lead: Tangent::zero(),
            tone: FrameTone::default(),
            response: 0,
            keyframe: false,
            held_out: false,
            tracked: true,
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

    /// Whether the camera moved noticeably (a millimetre, a milliradian) between the two pictures.
    pub(crate) fn depth_is_apart(&self) -> bool {
        let lead = self.depth_lead;
        lead.translation.norm() > 1e-3 || lead.rotation.norm() > 1e-3
    }

    /// World-from-camera when the depth picture was taken.
    pub fn depth_pose(&self) -> Pose<f64> {
        self.middle().retract(self.depth_lead)
    }
}

/// A radiance map as a run leaves it.
#[derive(Clone, Debug, PartialEq)]
pub enum Map {
    /// 3D Gaussians.
    Gaussians(GaussianMap<f32>),
    /// A radiance field in a hash grid.
    HashGrid(Box<HashGridMap>),
}

impl Default for Map {
    /// A map of nothing: no Gaussians.
    fn default() -> Self {
        Self::Gaussians(GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential))
    }
}

impl Map {
    /// Number of Gaussians; 0 of a map that has none.
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

/// A reconstructed sequence.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// Every setting of the run.
    pub config: Config,
    /// The camera of the processed frames.
    pub camera: Camera<f64>,
    /// One estimate per processed frame, in order of time.
    pub frames: Vec<FrameEstimate>,
    /// The map, in the frame of the first camera at mid-exposure.
    pub map: Map,
    /// Camera responses: one, or one per frame.
    pub responses: Vec<CameraResponse<f32>>,
    /// Time in which the rows of a picture are read, as set or found [s]; 0 for a global shutter.
    pub rolling_shutter_readout: f64,
}

impl Reconstruction {
    /// The trajectory at mid-exposure.
    pub fn trajectory(&self) -> Vec<StampedPose> {
        self.frames
            .iter()
            .map(|f| StampedPose { timestamp: f.timestamp, world_from_camera: f.middle() })
            .collect()
    }
    /// Median exposure and white balance, and the response of the middle frame; `None` where the
    /// map stores picture values (`tone` off) or there is no frame yet.
    pub fn typical_tone(&self) -> Option<(FrameTone<f32>, ResponseCurve<f32>)> {
        if !self.config.formation.tone || self.frames.is_empty() {
            return None;
        }
        let median = |i: usize| {
            let mut values: Vec<f32> = self.frames.iter().map(|f| f.tone.to_array()[i]).collect();
            values.sort_by(f32::total_cmp);
            values[values.len() / 2]
        };
        let response = self.responses.get(self.frames[self.frames.len() / 2].response)?;
        Some((FrameTone::from_array(std::array::from_fn(median)), response.curve()))
    }

    /// A frame that was never taken: a camera standing still at `world_from_camera`, with the
    /// median exposure and white balance of the run and the response of its middle frame.
    pub fn imagined_frame(&self, index: usize, world_from_camera: Pose<f64>) -> FrameEstimate {
        let tone = self.typical_tone().map_or_else(FrameTone::default, |(tone, _)| tone);
        let response = self.frames.get(self.frames.len() / 2).map_or(0, |f| f.response);
        FrameEstimate {
            tone,
            response,
            gaussians: self.map.gaussians(),
            ..FrameEstimate::posed(index, 0.0, ShutterPoses::still(world_from_camera))
        }
    }
}

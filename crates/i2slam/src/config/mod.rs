//! Every number of a run, with its unit, range and default; read from and written to TOML.

mod lines;
mod meaning;
mod parameters;
mod presets;
mod read;
mod validate;

pub use lines::line_of_key;
pub use parameters::{
    FieldParameters, FrameParameters, GaussianParameters, KeyframedParameters, Parameters,
    TrackingParameters,
};
pub use presets::PRESET_NAMES;
pub use read::ConfigError;

pub use i2slam_formation::{Quadrature, StartCurve, WhiteBalanceModel};

use serde::{Deserialize, Serialize};

/// All settings of a session.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Config {
    /// Name of the preset these values started from.
    pub preset: String,
    /// Seed of every random choice; the same seed gives the same bytes.
    pub seed: u64,
    /// What is done to the pictures before anything else.
    pub input: InputConfig,
    /// How a frame is formed from radiance.
    pub formation: FormationConfig,
    /// The map's representation.
    pub map: MapConfig,
    /// The radiance field of a map of that kind.
    pub hashgrid: HashGridConfig,
    /// Keyframes that come with poses.
    pub keyframed: KeyframedConfig,
    /// How the pose of a frame is found.
    pub tracking: TrackingConfig,
    /// How the map is built.
    pub mapping: MappingConfig,
    /// Values of the method that the preset decides and files do not hold.
    #[serde(skip)]
    pub parameters: Parameters,
}

/// What is done to the pictures before anything else.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InputConfig {
    /// Pixels cut off on every side before scaling: dark borders left by calibration.
    pub crop_border: usize,
    /// Frames closer in time than this to the one before are left out [s].
    pub minimum_gap: f64,
    /// Use the depth pictures' own time stamps: depth is compared where the camera was then.
    /// Off: depth belongs to the best pose of the exposure (eq. 14).
    pub depth_stamps: bool,
    /// Added to the depth pictures' time stamps [s].
    pub depth_delay: f64,
    /// Time in which the rows of a colour picture are read [s]: row r of H is exposed around
    /// `time stamp + readout ((r + ½)/H - ½)`. Positive if the top row comes first, 0 for a global
    /// shutter. Poses are those of the middle row; depth is taken at one moment.
    pub rolling_shutter_readout: f64,
    /// Find the readout while tracking, from `rolling_shutter_readout` on.
    pub optimise_rolling_shutter: bool,
}

/// The image-formation module: its switches and parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FormationConfig {
    /// Average virtual cameras over the exposure (off: one camera at mid-exposure).
    pub blur: bool,
    /// Exposure, white balance and camera response (off: the map stores picture values).
    pub tone: bool,
    /// Regularise start and end pose by the global trajectory (eqs. 15 to 17).
    pub trajectory_loss: bool,
    /// Virtual cameras over the exposure (N_cam of eq. 6), at least 1. Where they are re-projected
    /// and `blur_per_camera` sets their number, up to 2 N - 1.
    pub virtual_cameras: usize,
    /// Where they lie within the exposure. Rays of a radiance field that is mapped lie anywhere in
    /// equal parts of it, drawn anew in every step: there, and so in `run --rgb` on a field, this
    /// says nothing.
    pub quadrature: Quadrature,
    /// Blur length per virtual camera [px]: a frame uses no more cameras than its blur needs.
    /// Zero always uses `virtual_cameras`.
    pub blur_per_camera: f32,
    /// How the average over the exposure is computed.
    pub blur_model: BlurModel,
    /// One gain per channel, or one gain in all.
    pub white_balance: WhiteBalanceModel,
    /// One camera response for the sequence, or one for each frame.
    pub response_scope: ResponseScope,
    /// Curves of the response: 1 (monochrome) or 3.
    pub response_curves: usize,
    /// The curve that a response starts from.
    pub response_start: StartCurve,
}

/// How the average over the exposure is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BlurModel {
    /// One render per virtual camera (eqs. 5 and 6).
    Exact,
    /// One sharp render at mid-exposure, re-projected to the virtual cameras by its depth.
    Image,
    /// `image`, and beyond 40 px of motion while the picture is taken `exact`, unless the shutter
    /// rolls.
    Auto,
}

impl InputConfig {
    /// Whether rows are, or may be, read in turn.
    pub fn is_rolling(&self) -> bool {
        self.rolling_shutter_readout != 0.0 || self.optimise_rolling_shutter
    }
}

/// How many camera responses a sequence has.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResponseScope {
    /// A camera has one response.
    Sequence,
    /// One for each frame, started from the previous frame's (the paper's CRF^i).
    Frame,
}

/// The map's representation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MapConfig {
    /// What the map consists of.
    pub kind: MapKind,
    /// One standard deviation per Gaussian instead of three and a rotation.
    pub isotropic: bool,
    /// Most Gaussians the map may hold.
    pub capacity: usize,
}

/// What a map consists of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MapKind {
    /// 3D Gaussians.
    Gaussian,
    /// A radiance field in a multi-resolution hash grid.
    HashGrid,
}

/// A radiance field in a hash grid. Its keyframes and the rates of frames are those of `mapping`,
/// whose window is the number of keyframes in a step.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct HashGridConfig {
    /// Half edge of the cube around the first camera that is mapped [m]; zero takes it from the
    /// first frame's depth and enlarges it where a frame sees farther.
    pub bound: f32,
    /// Binary logarithm of the largest number of entries of a grid.
    pub log2_table: u32,
    /// Cells of the finest grid [m].
    pub finest_cell: f32,
    /// Rays of a step, about; with keyframes that have poses, pixels of a step, each of which takes
    /// a ray for every virtual camera.
    pub rays: usize,
    /// Steps per mapping round.
    pub iterations: usize,
    /// Steps of the round that starts the map.
    pub first_iterations: usize,
    /// Steps after the last frame, over all keyframes; the rate falls tenfold during them.
    pub final_iterations: usize,
}

/// Keyframes that come with poses (`run --rgb`) and are refined together with the map. Lengths are
/// in the unit of the poses, which is the metre only if their source knows it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeyframedConfig {
    /// Distance that a keyframe without depth is assumed to see.
    pub reach: f32,
    /// Coordinates in which the poses of a field's keyframes are stepped; without `formation.blur`
    /// always `off`.
    pub preconditioning: Preconditioning,
    /// Whether the pictures of keyframes from files without depth are tracked as a video, which
    /// gives them dense depth and, where it fits the pictures clearly better, other initial poses.
    pub refine_imported: bool,
}

/// Coordinates in which poses are stepped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preconditioning {
    /// Their own: lengths and angles.
    Off,
    /// Those of `P = (JᵀJ + damping)^(-1/2)`, J being that of the picture (CamP).
    Picture,
    /// The same scaled so that a step is as long as without, in the root mean square of its twelve
    /// numbers: a map that is still smooth does not make it longer. What the picture hardly shows
    /// is damped like the mean translation or rotation.
    Pose,
}

/// How the pose of a frame is found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrackingConfig {
    /// The optimiser.
    pub method: TrackingMethod,
    /// Adam steps per frame (after the second-order alignment, with that method).
    pub iterations: usize,
    /// λ_traj of eq. 12.
    pub trajectory_weight: f32,
}

/// The optimiser of tracking.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum TrackingMethod {
    /// First-order analysis by synthesis, as SplaTAM and the paper.
    Adam,
    /// Gauss-Newton on the re-projected model image, then Adam.
    SecondOrder,
}

/// How the map is built.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MappingConfig {
    /// Frames between two mapping rounds.
    pub interval: usize,
    /// Adam steps per round.
    pub iterations: usize,
    /// Time after which a round ends early [s]; zero never does. A run with a limit does not give
    /// the same bytes twice.
    pub seconds_per_frame: f32,
    /// Whether a frame is mapped while the next is tracked, against the map before it. Results do
    /// not depend on the number of threads either way.
    pub beside_tracking: bool,
    /// Adam steps of the round that starts the map.
    pub first_iterations: usize,
    /// Steps after the last frame, over all keyframes.
    pub final_iterations: usize,
    /// Every how many frames one is held out: tracked, but never mapped, for `eval --protocol
    /// held-out`. At least 2; zero holds none out.
    pub hold_out: usize,
    /// Keyframes in the window, current frame included.
    pub window: usize,
    /// Least number of frames from one keyframe to the next.
    pub keyframe_interval: usize,
    /// Motion of the picture since the last keyframe from which a new one is due, as a share of
    /// its width; zero takes every `keyframe_interval`-th frame.
    pub keyframe_motion: f32,
    /// λ_depth (a mean over pixels).
    pub depth_weight: f32,
    /// Place Gaussians where the sensor has no depth too, at a guess.
    pub fill_depth: bool,
}

impl MappingConfig {
    /// Whether the frame or keyframe that comes `number`-th is held out; the first, 0, never is.
    pub(crate) fn holds_out(&self, number: usize) -> bool {
        self.hold_out > 0 && number > 0 && number.is_multiple_of(self.hold_out)
    }
}

//! Settings of a run and the presets that they start from, read from and written to TOML.
//!
//! [`Config`] holds what a user may want to turn. Values of the method that presets differ in are
//! [`Parameters`]; values that all presets share are constants beside the code that uses them.

mod file;
mod hold_out;
mod parameters;
mod presets;
mod ranges;
mod validate;

pub use file::line_of_key;
pub(crate) use hold_out::HoldOut;
pub use parameters::{
    FieldParameters, FrameParameters, GaussianParameters, KeyframedParameters, Parameters,
    TrackingParameters,
};
pub use presets::PRESET_NAMES;
pub use ranges::{MAX_MEMORY, MIN_MEMORY};

pub use i2slam_formation::{Quadrature, StartCurve, WhiteBalanceModel};

use serde::{Deserialize, Serialize};
use std::ops::RangeInclusive;
use std::path::PathBuf;

/// Steps after the last frame for each keyframe: many views need fewer of each. Few keyframes have 25 at most,
/// more gain 0.03 to 0.2 dB.
const FINAL_STEPS_PER_KEYFRAME: RangeInclusive<usize> = 5..=25;
/// Steps of fewer than 80 keyframes, if these get 25 each at most.
const FINAL_STEPS_OF_FEW: usize = 400;

/// Declares a section of settings. The doc comments of its keys are the help in printed presets.
macro_rules! section {
    (
        $(#[doc = $about:literal])+
        $name:ident {
            $($(#[doc = $help:literal])+ $key:ident: $type:ty,)+
        }
        $(not in files {
            $(#[doc = $hidden_help:literal])+ $hidden:ident: $hidden_type:ty,
        })?
    ) => {
        $(#[doc = $about])+
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(deny_unknown_fields)]
        pub struct $name {
            $($(#[doc = $help])+ pub $key: $type,)+
            $($(#[doc = $hidden_help])+ #[serde(skip)] pub $hidden: $hidden_type,)?
        }

        impl $name {
            /// Keys with the lines of their doc comments.
            const HELP: &'static [(&'static str, &'static [&'static str])] =
                &[$((stringify!($key), &[$($help),+])),+];
        }
    };
}

section! {
    /// All settings of a run.
    Config {
        /// The preset these values started from; it decides all values that are no settings.
        preset: String,
        /// Seed of every random choice; the same seed gives the same bytes.
        seed: u64,
        /// Memory of a run, about [GB]: pictures of past frames take a sixth of it, and those not used for
        /// longest wait in a scratch file. No result depends on it.
        memory: f64,
        /// Pictures before they are tracked.
        input: InputConfig,
        /// Image formation: how a picture comes from radiance.
        formation: FormationConfig,
        /// Representation of the map.
        map: MapConfig,
        /// A radiance field in a hash grid (`map.kind` `hashgrid`). Its keyframes are those of
        /// `mapping`, whose window is the number of keyframes in a step.
        hashgrid: HashGridConfig,
        /// Keyframes that come with poses (`run --rgb`) and are refined together with the map.
        keyframed: KeyframedConfig,
        /// Tracking of frames with depth.
        tracking: TrackingConfig,
        /// Mapping with Gaussians, and keyframes of every map.
        mapping: MappingConfig,
    }
    not in files {
        /// Values of the method that the preset decides.
        parameters: Parameters,
    }
}

section! {
    /// Pictures before they are tracked.
    InputConfig {
        /// Pixels cut off on every side before scaling: dark borders left by calibration. Paper:
        /// 24 px of ScanNet's colour and 12 px of its depth, here one border; SplaTAM: 8 px of TUM.
        crop_border: usize,
        /// Frames closer in time than this to the last kept one are left out [s]. SplaTAM: 1/32.
        minimum_gap: f64,
        /// Compare depth where the camera was when its picture was taken, by the depth pictures' own
        /// time stamps. Off: depth belongs to the best pose of the exposure (eq. 14).
        depth_stamps: bool,
        /// Added to the depth pictures' time stamps [s].
        depth_delay: f64,
        /// Time in which the rows of a colour picture are read [s]: row r of H is exposed around
        /// `time stamp + readout ((r + ½)/H - ½)`. Positive if the top row comes first. 0: `default` and
        /// `default-rgb` measure it and write what they found here, the paper's presets take the rows as
        /// read at once. Poses are those of the middle row; depth is taken at one moment.
        rolling_shutter_readout: f64,
        /// Find the readout while frames are tracked against the map, from `rolling_shutter_readout` on. Not
        /// needed where the front end gives the poses.
        optimise_rolling_shutter: bool,
    }
}

section! {
    /// Image formation: how a picture comes from radiance.
    FormationConfig {
        /// Average virtual cameras over the exposure. Off: one camera at mid-exposure.
        blur: bool,
        /// Exposure, white balance and camera response. Off: the map stores picture values.
        tone: bool,
        /// Loss of light towards the corners, found from surfaces that several keyframes see. Needs `tone`.
        vignetting: bool,
        /// Regularise start and end pose by the trajectory of frames (eqs. 15 to 17).
        trajectory_loss: bool,
        /// Virtual cameras over the exposure (N_cam of eq. 6). Where they are re-projected and
        /// `blur_per_camera` sets their number, up to 2 N - 1. Paper: 5.
        virtual_cameras: usize,
        /// Placement of virtual cameras in the exposure: `endpoints` includes shutter open and close
        /// (eq. 6), `midpoints` takes the middles of equal parts, which keeps the width of a streak.
        /// Without effect on radiance fields, whose rays are drawn in equal parts.
        quadrature: Quadrature,
        /// Blur length per virtual camera [px]: a frame uses no more cameras than its blur needs. 0
        /// always uses `virtual_cameras`, as the paper.
        blur_per_camera: f32,
        /// Computation of the average: `exact` renders every virtual camera (eqs. 5 and 6), `image`
        /// re-projects one sharp render by its depth, `auto` is `image`, and `exact` beyond 40 px of
        /// blur unless the shutter rolls.
        blur_model: BlurModel,
        /// Free gains: `per-channel` (red and blue; green is 1), `one-gain` for all channels, or
        /// `fixed`, where brightness is the exposure alone. Paper: one gain on ScanNet and synthetic
        /// scenes. `default` and `default-rgb` on Gaussians: red and blue are one for all frames where
        /// pictures show no change of them.
        white_balance: WhiteBalanceModel,
        /// One camera response for the `sequence`, or one for each `frame` (the paper's CRF^i).
        response_scope: ResponseScope,
        /// Curves of the response: 1 (monochrome) or 3. Paper: 1 on synthetic scenes.
        response_curves: usize,
        /// Start of the response: `srgb`, `identity`, or `shoulder`
        /// (sRGB with a soft shoulder, as cameras and tone-mapped video have). The paper leaves it
        /// open.
        response_start: StartCurve,
    }
}

section! {
    /// Representation of the map.
    MapConfig {
        /// `gaussian`: 3D Gaussians, or `hashgrid`: a radiance field in a multi-resolution hash
        /// grid.
        kind: MapKind,
        /// One standard deviation per Gaussian, as SplaTAM. Off: flat Gaussians, each for a
        /// rectangle of pixels over which colour and surface are plain, split where the map is wrong. With
        /// `tracking.method` `second-order` frames that are tracked against the map have balls.
        isotropic: bool,
        /// Colours of flat Gaussians that depend on the direction they are seen from, where keyframes
        /// show that they do: gloss.
        view_dependent: bool,
        /// Largest number of Gaussians; a full map merges similar neighbours.
        capacity: usize,
    }
}

section! {
    /// A radiance field in a hash grid.
    HashGridConfig {
        /// Half edge of the cube around the first camera that is mapped [m]. 0 takes it from the
        /// first frame's depth and enlarges it where a frame sees farther.
        bound: f32,
        /// Binary logarithm of the largest number of entries of a grid. torch-ngp: 19.
        log2_table: u32,
        /// Edge of the cells of the finest grid [m].
        finest_cell: f32,
        /// Rays of a step, about; with keyframes that have poses, pixels of a step, each of which
        /// takes a ray for every virtual camera. torch-ngp: 4096.
        rays: usize,
        /// Steps per mapping round.
        iterations: usize,
        /// Steps of the round that starts the map.
        first_iterations: usize,
        /// Steps after the last frame, over all keyframes; the learning rate falls tenfold during
        /// them.
        final_iterations: usize,
    }
}

section! {
    /// Keyframes that come with poses. Lengths are in the unit of the poses, which is the metre only
    /// if their source knows it.
    KeyframedConfig {
        /// Distance that a keyframe without depth is assumed to see. NeRF-SLAM: 4.
        reach: f32,
        /// Coordinates in which the poses of a field's keyframes are stepped: `off` for lengths and
        /// angles, `picture` for those in which all change the picture alike (CamP, as the paper),
        /// `pose` for the same with steps as long as without. Without `formation.blur` always `off`.
        preconditioning: Preconditioning,
        /// Track the pictures of imported keyframes without depth as a video, which gives them dense
        /// depth and, where it fits the pictures clearly better, other initial poses.
        refine_imported: bool,
    }
}

section! {
    /// Tracking of frames with depth.
    TrackingConfig {
        /// `adam`: first-order analysis by synthesis, as SplaTAM and the paper; `second-order`:
        /// Gauss-Newton on the re-projected model image, then `iterations` steps of Adam.
        method: TrackingMethod,
        /// Adam steps per frame. SplaTAM: 100 on ScanNet, 200 on TUM; paper: 200 on synthetic scenes.
        iterations: usize,
        /// λ_traj of eq. 12 in first-order tracking. Paper: 1e6 on ScanNet, 1e4 on synthetic scenes
        /// ("learning rate for the trajectory regularizer", read as λ_traj); TUM as ScanNet.
        trajectory_weight: f32,
    }
}

section! {
    /// Mapping.
    MappingConfig {
        /// Frames between two mapping rounds. SplaTAM: 1; paper: 5 on synthetic scenes.
        interval: usize,
        /// Adam steps per round. SplaTAM and paper: 30.
        iterations: usize,
        /// Time after which a round ends early [s]; 0 never does. A run with a limit does not give
        /// the same bytes twice.
        seconds_per_frame: f32,
        /// Adam steps of the round that starts the map.
        first_iterations: usize,
        /// Most steps after the last frame. There are 5 of each keyframe, or 400 of few (25 of each at most);
        /// frames of a film are keyframes of the map, too, as long as each gets 5. SplaTAM: none.
        final_iterations: usize,
        /// Hold out every n-th frame, of imported keyframes every n-th of these: tracked, but never mapped,
        /// for `eval --protocol held-out`. At least 2; 0 holds none out.
        hold_out: usize,
        /// Numbers of single frames that are held out too, as lists of benchmarks give them.
        hold_out_frames: Vec<usize>,
        /// Keyframes in the window, current frame included. SplaTAM: 10 on ScanNet, 20 on TUM, 24 on
        /// Replica.
        window: usize,
        /// Smallest number of frames from one keyframe to the next. SplaTAM: 5.
        keyframe_interval: usize,
        /// Motion of the picture since the last keyframe from which a new one is due, over the
        /// picture's width; a due keyframe waits for a sharp frame. 0 takes every
        /// `keyframe_interval`-th frame, as SplaTAM.
        keyframe_motion: f32,
        /// λ_depth of Gaussians, a mean over pixels; λ_img is 0.5. SplaTAM: 1.
        depth_weight: f32,
        /// Keyframes place Gaussians also where the sensor has no depth, at inpainted depth. SplaTAM:
        /// off.
        fill_depth: bool,
    }
}

/// Computation of the average over the exposure.
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
    /// Whether the shutter rolls, or its readout is to be found.
    pub fn is_rolling(&self) -> bool {
        self.rolling_shutter_readout != 0.0 || self.optimise_rolling_shutter
    }
}

/// Number of camera responses of a sequence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ResponseScope {
    /// One for all frames.
    Sequence,
    /// One for each frame, started from the previous frame's (the paper's CRF^i).
    Frame,
}

/// Representation of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MapKind {
    /// 3D Gaussians.
    Gaussian,
    /// A radiance field in a multi-resolution hash grid.
    HashGrid,
}

/// Coordinates in which poses are stepped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Preconditioning {
    /// Their own: lengths and angles.
    Off,
    /// Those of `P = (JᵀJ + damping)^(-1/2)`, J being that of the picture (CamP).
    Picture,
    /// Those of `Picture`, scaled so that a step keeps the root mean square of its twelve numbers: a
    /// map that is still smooth does not lengthen it. Directions that the picture hardly shows are
    /// damped like the mean translation or rotation.
    Pose,
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

impl Config {
    /// Keyframes that Gaussians are fitted to in a film of so many frames whose path has `keyframes`: more
    /// than it needs, for each shows the surface once more, at other places within its pixels and by
    /// another exposure. The paper's presets have none of their own.
    pub(crate) fn fitted_keyframes(&self, keyframes: usize, frames: usize) -> usize {
        if self.map.kind != MapKind::Gaussian || self.tracking.method == TrackingMethod::Adam {
            return keyframes;
        }
        keyframes.max(frames.min(self.mapping.final_iterations / FINAL_STEPS_PER_KEYFRAME.start()))
    }
}

impl MappingConfig {
    /// True if the frame or keyframe of this index that comes `number`-th is held out; the first, 0,
    /// only where it is named.
    pub(crate) fn holds_out(&self, number: usize, index: usize) -> bool {
        let is_due = self.hold_out > 0 && number > 0 && number.is_multiple_of(self.hold_out);
        is_due || self.hold_out_frames.contains(&index)
    }

    /// True if no frame is held out.
    pub fn maps_all(&self) -> bool {
        self.hold_out == 0 && self.hold_out_frames.is_empty()
    }

    /// Steps after the last frame over so many keyframes.
    pub(crate) fn final_steps(&self, keyframes: usize) -> usize {
        let [least, most] = [FINAL_STEPS_PER_KEYFRAME.start(), FINAL_STEPS_PER_KEYFRAME.end()]
            .map(|steps| steps * keyframes);
        self.final_iterations.min(FINAL_STEPS_OF_FEW.clamp(least, most))
    }
}

/// Errors of settings.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConfigError {
    /// No preset has this name.
    #[error("no preset is called `{name}`: choose one of {}", PRESET_NAMES.join(", "))]
    UnknownPreset {
        /// The name.
        name: String,
    },
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// Cause.
        source: std::io::Error,
    },
    /// The text is not TOML.
    #[error("{origin}: {message}")]
    Malformed {
        /// File name.
        origin: String,
        /// Message of the parser.
        message: String,
    },
    /// A key that no setting has.
    #[error("{origin}, line {line}: no setting is called `{key}`{hint}: `{section}` has {known}")]
    UnknownKey {
        /// File name.
        origin: String,
        /// Line, counted from 1.
        line: usize,
        /// The key with its section.
        key: String,
        /// `, did you mean ...?` where another setting has a name that is alike.
        hint: Box<str>,
        /// Section it stands in.
        section: String,
        /// The keys of that section.
        known: String,
    },
    /// A key of an earlier version whose value is no setting any more.
    #[error("{place}{key} is no longer a setting: the preset decides it")]
    RemovedKey {
        /// File name and line, with `: `.
        place: String,
        /// Key with section.
        key: String,
    },
    /// A value of another type, or none of the names that a setting takes.
    #[error("{place}{key}: {message}")]
    WrongValue {
        /// File name and line, with `: `.
        place: String,
        /// Key with section.
        key: String,
        /// Message of the parser.
        message: String,
    },
    /// A value outside its range.
    #[error("{place}{key} = {value} is out of range: {expected}")]
    OutOfRange {
        /// File name and line, with `: `; empty without a file.
        place: String,
        /// Key with section.
        key: &'static str,
        /// Its value.
        value: String,
        /// Allowed values.
        expected: String,
    },
    /// A value that needs more memory than the machine has.
    #[error("{place}{key} = {value} needs about {memory}")]
    TooMuchMemory {
        /// File name and line, with `: `; empty without a file.
        place: String,
        /// Key with section.
        key: &'static str,
        /// Its value.
        value: String,
        /// Memory that it needs, that of the machine, and a change that needs less.
        memory: String,
    },
}

impl ConfigError {
    /// The key at fault, with its section.
    pub fn key(&self) -> Option<&str> {
        match self {
            Self::UnknownKey { key, .. }
            | Self::RemovedKey { key, .. }
            | Self::WrongValue { key, .. } => Some(key),
            Self::OutOfRange { key, .. } | Self::TooMuchMemory { key, .. } => Some(key),
            _ => None,
        }
    }
}

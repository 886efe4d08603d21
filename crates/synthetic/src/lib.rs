//! Test sequences with known truth.
//!
//! * [`synthesise`] renders a procedural room, seen by a hand-held camera with motion blur,
//!   automatic exposure and a camera response, or photographs around a still life, from a [`Spec`].
//! * [`degrade`] puts faults of depth, sensor noise, exposure steps, a moving object, and dropped,
//!   covered, grey, frozen or shuffled frames on an existing sequence.
//!
//! Both write the TUM layout, which `i2slam_dataset::Sequence` opens. Everything is the same
//! bytes for the same seed and any number of threads. Formulas are in docs/synthetic.md.

mod camera_path;
mod degrade;
mod depth_noise;
mod error;
mod lens;
mod light;
mod motion;
mod render;
mod rgb;
mod rng;
mod scene;
mod sensor;
mod spec;
mod stills;
mod synthesise;
mod texture;
mod write;

pub use degrade::{Degradation, DegradationCounts, DepthDegradation, ExposureStep, degrade};
pub use depth_noise::KinectNoise;
pub use error::SyntheticError;
pub use lens::vignetting_at;
pub use sensor::{
    AutoExposure, Response, Sensor, ShutterRule, raw_exposure_value, white_balance_at,
};
pub use spec::{
    CameraSpec, DepthSpec, ExposureSpec, GlossSpec, LensSpec, LightSpec, MotionSpec, NoiseSpec,
    OutputSpec, RoomSpec, SHIPPED as SHIPPED_SPECS, Spec, StillsSpec, WhiteBalanceSpec,
};
pub use synthesise::{Stage, synthesise};
pub use write::Summary;

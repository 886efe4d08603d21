//! Sharp 3D maps in high dynamic range and camera paths from blurred video, with a depth camera or
//! without.
//!
//! ```no_run
//! use i2slam::{RunOptions, reconstruct};
//!
//! let options = RunOptions::with_depth(); // or colour_alone() for a video
//! let sequence = options.open_sequence("rgbd_dataset_freiburg1_desk".as_ref())?;
//! let outcome = reconstruct(&sequence, &options, ())?;
//! println!("{}", outcome.reconstruction.map);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod config;
pub mod keyframes;
mod mapping;
pub mod objective;
mod reconstruction;
pub mod run;
mod session;
mod tracking;
mod viewer;
mod warning;

pub use config::{Config, ConfigError};
pub use i2slam_compute::CancellationToken;
pub use i2slam_dataset as dataset;
pub use i2slam_formation as formation;
pub use i2slam_geometry as geometry;
pub use i2slam_odometry::{OdometryError, TrackingStatus};
pub use i2slam_radiance as radiance;
pub use reconstruction::{Convergence, FrameEstimate, Losses, Map, Reconstruction, UnitOfLength};
pub use run::{Observer, PoseSource, RunError, RunOptions, RunOutcome, reconstruct};
pub use session::{
    MappingPanicked, OnlineError, OnlineSession, OnlineUpdate, RuntimeEstimate, Session,
    SessionError,
};
pub use viewer::{LightMeter, OptimisedPose, Viewer};
pub use warning::Warning;

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

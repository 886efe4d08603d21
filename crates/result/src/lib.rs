//! The result folder: everything that a run leaves on disk, its report, and how it is read back.
//! The files are documented in `docs/result-folder.md`.

mod archive;
mod error;
pub mod export;
mod folder;
mod frame_files;
pub mod html;
mod input;
mod map;
mod metrics;
mod numbers;
mod pictures;
pub mod plot;
pub mod report;
mod sensor_lines;
mod tables;
#[cfg(test)]
mod tests;
mod viewer;

pub use error::ResultError;
pub use folder::{
    NAMES, is_trajectory_edited, load, load_metrics, remove_renders, save, save_metrics,
    save_trajectory,
};
pub use frame_files::FrameFiles;
pub use i2slam::UnitOfLength;
pub use input::RunInput;
pub use metrics::Metrics;
pub use pictures::{
    DEPTH_UNITS_PER_METRE, RenderKind, save_render, write_depth, write_picture, write_radiance,
};
pub use sensor_lines::{depth_registration_line, rolling_shutter_line};
pub use tables::{online_trajectory, trajectory_line, unit_of_trajectory};
pub use viewer::{NoViewer, VIEWER_FILE, ViewerPage};

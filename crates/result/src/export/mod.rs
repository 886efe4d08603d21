//! Results in the formats of other programs; one file per format.
//!
//! A [`Scene`] is what leaves: the reconstruction, cut to what was asked for, and the rotation that
//! levels it. Files hold the levelled world, whose axes are those of a camera that looks straight ahead
//! (x right, y down, z forward), apart from formats that have an up of their own ([`Axes`]).

mod axes;
pub(crate) mod blended_colours;
pub mod colmap;
pub mod compressed_ply;
mod error;
pub mod glb;
mod gltf;
mod ground;
mod harmonics;
mod html;
pub(crate) mod level;
pub mod mesh;
pub mod nerfstudio;
pub mod ply;
mod scene;
mod screen_filter;
mod seed_points;
mod seen;
mod smooth_path;
pub mod splat;
mod tables;
pub mod video;
mod view_path;
mod views;
mod watch;

pub use axes::Axes;
pub use error::ExportError;
pub use html::html;
pub use level::Up;
pub use scene::{CropBox, Scene, Selection};
pub use tables::{CSV_COLUMNS, LEVELLED, csv, tum};
pub use views::LoadTaken;
pub use watch::Watch;

/// The mark in every file by which this program knows its own exports.
pub const MARK: &str = "i2slam export";

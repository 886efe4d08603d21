//! The files of a sequence.

mod folder;
mod picture;
mod readme;

pub(crate) use folder::{Folder, pose_numbers};
pub(crate) use picture::{DEPTH_SCALE, write_depth, write_picture, write_radiance};
pub use readme::Summary;
pub(crate) use readme::{camera_json, readme};

//! The result folder: what a run leaves on disk, and how it is read back. Its files are
//! documented in `docs/result-folder.md`.

mod archive;
mod error;
mod input;
mod load;
mod map;
mod metrics;
mod pictures;
mod ply;
mod remove;
mod renders;
pub mod report;
mod save;
mod state;
mod storage;
mod table;
#[cfg(test)]
mod tests;

pub use error::ExportError;
pub use input::Input;
pub use load::load;
pub use metrics::{Metrics, UnitOfLength};
pub use pictures::{DEPTH_UNITS_PER_METRE, write_depth, write_picture, write_radiance};
pub use remove::{FolderContents, Layout, remove_renders};
pub use renders::{RenderKind, save_render};
pub use save::{save, save_metrics, save_trajectory};
pub use storage::{Disk, ResultFolder, Storage};

//! COLMAP's sparse models: cameras, images and points, as text or binary.
//!
//! Poses are `camera_from_world` (quaternion w x y z, then translation) with OpenCV's axes; pixel
//! centres lie at one half. Points are in the unit of the poses, metres only if the model was
//! scaled.

mod binary;
mod camera;
mod text;

pub(crate) use camera::{ModelCamera, shared_camera};

use super::poses::pose_from_wxyz;
use crate::DatasetError;
use crate::camera::Calibration;
use i2slam_geometry::{Pose, Vec3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Folders in which models usually lie.
const MODEL_FOLDERS: [&str; 5] = ["", "sparse/0", "sparse", "colmap/sparse/0", "dense/sparse"];

/// A model on disk, not yet read.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Model {
    pub(crate) folder: PathBuf,
    is_binary: bool,
}

/// An image of the model.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ModelImage {
    pub(crate) id: u32,
    pub(crate) camera: u32,
    pub(crate) name: String,
    pub(crate) world_from_camera: Pose<f64>,
}

/// A point of the model.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ModelPoint {
    pub(crate) position: Vec3<f64>,
    /// Mean reprojection error [px]; -1 if not computed.
    pub(crate) error: f64,
    /// Ids of the images that observe it.
    pub(crate) images: Vec<u32>,
}

/// Finds a model in `path` or a usual folder below it: binary before text, unless `text_first`.
pub(crate) fn find(path: &Path, text_first: bool) -> Option<Model> {
    let folders = MODEL_FOLDERS.iter().map(|place| path.join(place));
    folders.into_iter().find_map(|folder| {
        let has = |end: &str| {
            ["cameras", "images"].iter().all(|name| folder.join(format!("{name}.{end}")).is_file())
        };
        let is_binary = has("bin") && !(text_first && has("txt"));
        (is_binary || has("txt")).then_some(Model { folder, is_binary })
    })
}

impl Model {
    /// Path of `cameras`, `images` or `points3D`.
    pub(crate) fn file(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.{}", if self.is_binary { "bin" } else { "txt" }))
    }

    pub(crate) fn cameras(&self) -> Result<BTreeMap<u32, ModelCamera>, DatasetError> {
        let file = self.file("cameras");
        if self.is_binary { binary::cameras(&file) } else { text::cameras(&file) }
    }

    pub(crate) fn images(&self) -> Result<Vec<ModelImage>, DatasetError> {
        let file = self.file("images");
        if self.is_binary { binary::images(&file) } else { text::images(&file) }
    }

    /// Reads the points; empty if there is no file.
    pub(crate) fn points(&self) -> Result<Vec<ModelPoint>, DatasetError> {
        let file = self.file("points3D");
        match (file.is_file(), self.is_binary) {
            (false, _) => Ok(Vec::new()),
            (true, true) => binary::points(&file),
            (true, false) => text::points(&file),
        }
    }
}

/// Calibration of the only camera in a `cameras.txt` or `cameras.bin`.
pub(super) fn read_camera(file: &Path) -> Result<Calibration, DatasetError> {
    let is_binary = file.extension().is_some_and(|ending| ending == "bin");
    let cameras = if is_binary { binary::cameras(file)? } else { text::cameras(file)? };
    camera::single_camera(file, &cameras)
}

/// Converts `camera_from_world` (quaternion w x y z, translation) to `world_from_camera`.
fn parse_pose(q: [f64; 4], t: [f64; 3]) -> Result<Pose<f64>, String> {
    if q.iter().chain(&t).any(|v| !v.is_finite()) {
        return Err(format!("the pose {q:?} {t:?} is not finite, expected qw qx qy qz tx ty tz"));
    }
    pose_from_wxyz(q, t).map(Pose::inverse)
}

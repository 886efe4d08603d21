//! COLMAP's sparse models: cameras, images and points, as text or binary.
//!
//! Poses are `camera_from_world` (quaternion w x y z, then translation) with OpenCV's axes; pixel
//! centres lie at one half. Points are in the unit of the poses, which is no metre unless somebody
//! has scaled the model.

mod binary;
mod camera;
mod pictures;
mod points;
mod text;

use super::keyframe::{DepthSource, KeyframePose, Pictures, Source};
use super::placed::{Found, LeftOut, all_frames, at_positions, left_out};
use super::sparse::SparseDepth;
use super::{Depth, Kind, Options};
use crate::calibration::Calibration;
use crate::trajectory_file::{UNIT_TOLERANCE, not_unit};
use crate::{DatasetError, Sequence};
use camera::ModelCamera;
use i2slam_geometry::{Pose, Rotation, Vec3};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Where models lie in the folders that COLMAP and its users make.
const PLACES: [&str; 5] = ["", "sparse/0", "sparse", "colmap/sparse/0", "dense/sparse"];

/// The folder of a model and how it is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Model {
    folder: PathBuf,
    is_binary: bool,
}

/// An image of the model.
#[derive(Clone, Debug, PartialEq)]
struct ModelImage {
    id: u32,
    camera: u32,
    name: String,
    world_from_camera: Pose<f64>,
}

/// A point of the model.
#[derive(Clone, Debug, PartialEq)]
struct ModelPoint {
    position: Vec3<f64>,
    /// Mean reprojection error [px].
    error: f64,
    /// The images that see it.
    images: Vec<u32>,
}

/// The model in `path` or in a folder below it where models usually lie: binary before text, unless
/// text is asked for.
pub(super) fn find(path: &Path, text_first: bool) -> Option<Model> {
    let folders = PLACES.iter().map(|place| path.join(place));
    folders.into_iter().find_map(|folder| {
        let has = |end: &str| {
            ["cameras", "images"].iter().all(|name| folder.join(format!("{name}.{end}")).is_file())
        };
        let is_binary = has("bin") && !(text_first && has("txt"));
        (is_binary || has("txt")).then_some(Model { folder, is_binary })
    })
}

impl Model {
    fn file(&self, name: &str) -> PathBuf {
        self.folder.join(format!("{name}.{}", if self.is_binary { "bin" } else { "txt" }))
    }

    fn cameras(&self) -> Result<BTreeMap<u32, ModelCamera>, DatasetError> {
        let file = self.file("cameras");
        if self.is_binary { binary::cameras(&file) } else { text::cameras(&file) }
    }

    fn images(&self) -> Result<Vec<ModelImage>, DatasetError> {
        let file = self.file("images");
        if self.is_binary { binary::images(&file) } else { text::images(&file) }
    }

    /// Without its file a model has no points.
    fn points(&self) -> Result<Vec<ModelPoint>, DatasetError> {
        let file = self.file("points3D");
        match (file.is_file(), self.is_binary) {
            (false, _) => Ok(Vec::new()),
            (true, true) => binary::points(&file),
            (true, false) => text::points(&file),
        }
    }
}

/// The one camera in COLMAP's `cameras.txt` or `cameras.bin`.
pub(crate) fn camera_of(file: &Path) -> Result<Calibration, DatasetError> {
    let is_binary = file.extension().is_some_and(|ending| ending == "bin");
    let cameras = if is_binary { binary::cameras(file)? } else { text::cameras(file)? };
    camera::only(file, &cameras)
}

/// The pose of an image: w x y z, then the translation, `camera_from_world`.
fn pose(q: [f64; 4], t: [f64; 3]) -> Result<Pose<f64>, String> {
    if q.iter().chain(&t).any(|v| !v.is_finite()) {
        return Err(format!("the pose {q:?} {t:?} is not finite, expected qw qx qy qz tx ty tz"));
    }
    if let Some(reason) = not_unit(q, UNIT_TOLERANCE) {
        return Err(reason);
    }
    let rotation = Rotation::from_wxyz(q[0], q[1], q[2], q[3]).ok_or("the quaternion is zero")?;
    Ok(Pose::new(rotation, Vec3::from_array(t)).inverse())
}

/// Opens a model with the pictures of a sequence, by default `images/` beside it or above.
pub(super) fn open(
    model: &Model,
    pictures: Option<&Path>,
    options: &Options,
) -> Result<Found, DatasetError> {
    let (cameras, images) = (model.cameras()?, model.images()?);
    let camera = camera::of_all(&model.file("cameras"), &cameras, &images)?;
    let folder =
        pictures.map_or_else(|| pictures::beside(&model.folder), |p| Ok(p.to_path_buf()))?;
    let open = all_frames(options, options.depth == Depth::Pictures);
    let sequence = pictures::open(&folder, camera, &open)?;
    let depth = match options.depth {
        Depth::Imported => sparse(model, &cameras, &images, options)?,
        Depth::None | Depth::Pictures => DepthSource::pictures_if_wanted(options)?,
    };
    let mut warnings = sequence.warnings.clone();
    let (keyframes, left_out) = placed(&folder, &images, &sequence, &mut warnings);
    let source = Source { pictures: Pictures::Sequence(Box::new(sequence)), depth };
    let path = model.folder.clone();
    Ok(Found { kind: Kind::Colmap, path, source, keyframes, left_out, warnings })
}

/// The images that have a picture, in order of these.
fn placed(
    folder: &Path,
    images: &[ModelImage],
    pictures: &Sequence,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, LeftOut) {
    let places = pictures::places(folder, images, pictures);
    let poses = images
        .iter()
        .zip(&places)
        .enumerate()
        .filter_map(|(record, (image, at))| Some((record, (*at)?, image.world_from_camera)));
    let keyframes = at_positions(poses, pictures);
    let first = images.iter().zip(&places).find(|(_, place)| place.is_none());
    let first =
        first.map_or_else(String::new, |(image, _)| format!(", the first is {}", image.name));
    let reason = format!("images of the model are looked for by name{first}");
    let why = format!("no picture of that name{first}");
    let left_out = left_out(images.len(), &keyframes, pictures, reason, &why, warnings);
    (keyframes, left_out)
}

/// The depth of the model's points.
fn sparse(
    model: &Model,
    cameras: &BTreeMap<u32, ModelCamera>,
    images: &[ModelImage],
    options: &Options,
) -> Result<DepthSource, DatasetError> {
    let points = model.points()?;
    if points.is_empty() {
        return Ok(DepthSource::None);
    }
    let (points, seen) = points::with_covariance(&points, cameras, images);
    let max_depth = options.open.max_depth.unwrap_or(f64::INFINITY);
    Ok(DepthSource::Sparse(Box::new(SparseDepth { points, seen, max_depth })))
}

//! Keyframes of a COLMAP model.

use super::posed_images::{
    ReadKeyframes, UnmatchedCounts, all_frames, at_positions, count_unmatched,
};
use super::source::{DepthSource, KeyframePose};
use super::sparse_depth::{SparseDepth, with_covariance};
use super::{ImportDepth, ImportFormat, ImportOptions};
use crate::camera::{Calibration, FormatDefaults};
use crate::formats::colmap::{Model, ModelCamera, ModelImage, shared_camera};
use crate::formats::{DetectedLayout, list_images_below};
use crate::sequence::{DEFAULT_FRAME_RATE, name_of};
use crate::{DatasetError, OpenOptions, Sequence};
use std::collections::{BTreeMap, HashMap};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Opens a model with the images of a sequence, by default `images/` beside it or above.
pub(super) fn open(
    model: &Model,
    pictures: Option<&Path>,
    options: &ImportOptions,
) -> Result<ReadKeyframes, DatasetError> {
    let (cameras, images) = (model.cameras()?, model.images()?);
    let camera = shared_camera(&model.file("cameras"), &cameras, &images)?;
    let folder =
        pictures.map_or_else(|| find_image_folder(&model.folder), |p| Ok(p.to_path_buf()))?;
    let open = all_frames(options, options.depth == ImportDepth::Pictures);
    let sequence = open_images(&folder, camera, &open)?;
    let depth = match options.depth {
        ImportDepth::Imported => sparse_depth(model, &cameras, &images, options)?,
        ImportDepth::None | ImportDepth::Pictures => DepthSource::images_if_requested(options)?,
    };
    let mut warnings = sequence.warnings.clone();
    let matched = match_by_name(&folder, &images, &sequence, &mut warnings);
    let kind = (ImportFormat::Colmap, model.folder.as_path());
    Ok(ReadKeyframes::of_sequence(kind, (sequence, depth), matched, warnings))
}

/// Matches the images of the model with those of the sequence by name, in order of the latter.
fn match_by_name(
    folder: &Path,
    images: &[ModelImage],
    pictures: &Sequence,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, UnmatchedCounts) {
    let positions = find_images(folder, images, pictures);
    let poses = images
        .iter()
        .zip(&positions)
        .enumerate()
        .filter_map(|(record, (image, at))| Some((record, (*at)?, image.world_from_camera)));
    let keyframes = at_positions(poses, pictures);
    let first = images.iter().zip(&positions).find(|(_, position)| position.is_none());
    let first =
        first.map_or_else(String::new, |(image, _)| format!(", the first is {}", image.name));
    let reason = format!("images of the model are looked for by name{first}");
    let why = format!("no picture of that name{first}");
    let unmatched = count_unmatched(images.len(), &keyframes, pictures, reason, &why, warnings);
    (keyframes, unmatched)
}

/// Sparse depth of the model's points.
fn sparse_depth(
    model: &Model,
    cameras: &BTreeMap<u32, ModelCamera>,
    images: &[ModelImage],
    options: &ImportOptions,
) -> Result<DepthSource, DatasetError> {
    let points = model.points()?;
    if points.is_empty() {
        return Ok(DepthSource::None);
    }
    let (points, observed) = with_covariance(&points, cameras, images);
    let max_depth = options.open.max_depth.unwrap_or(f64::INFINITY);
    Ok(DepthSource::Sparse(Box::new(SparseDepth { points, observed, max_depth })))
}

/// Finds `images/` beside the model or up to three folders above.
fn find_image_folder(model: &Path) -> Result<PathBuf, DatasetError> {
    let whole = model.canonicalize().unwrap_or_else(|_| model.to_path_buf());
    let folders = whole.ancestors().take(4).map(|folder| folder.join("images"));
    folders.into_iter().find(|folder| folder.is_dir()).ok_or_else(|| {
        let reason = "no folder images/ beside the model or above it: name the folder of the \
                      pictures";
        DatasetError::file(model, reason)
    })
}

/// Opens a sequence, a folder of images or its subfolders, with the camera of the model.
fn open_images(
    folder: &Path,
    calibration: Calibration,
    options: &OpenOptions,
) -> Result<Sequence, DatasetError> {
    if !folder.exists() {
        return Err(DatasetError::MissingFolder { path: folder.to_path_buf() });
    }
    let (listing, defaults) = match DetectedLayout::detect(folder, options.colour_only) {
        Ok(source) => (source.list(folder, options, DEFAULT_FRAME_RATE)?, source.defaults()),
        Err(error @ DatasetError::UnknownLayout { .. }) if options.colour_only => {
            let below = list_images_below(folder, DEFAULT_FRAME_RATE);
            (below.ok_or(error)?, FormatDefaults::TUM)
        }
        Err(error) => return Err(error),
    };
    let format = defaults.with_depth_on_colour_camera().with_given_scale(options.depth_scale);
    let calibration = Calibration { format, ..calibration };
    Sequence::from_listing(name_of(folder), listing, calibration, options, DEFAULT_FRAME_RATE)
}

/// Position in the sequence of every image of the model: by its whole name in `folder`, or as the end
/// of exactly one path, else by its file name if that is unique in model and sequence.
fn find_images(folder: &Path, images: &[ModelImage], pictures: &Sequence) -> Vec<Option<usize>> {
    let mut named: HashMap<&OsStr, Vec<usize>> = HashMap::new();
    for (at, entry) in pictures.entries.iter().enumerate() {
        named.entry(entry.colour.file_name().unwrap_or_default()).or_default().push(at);
    }
    let mut shared: HashMap<&OsStr, usize> = HashMap::new();
    for name in images.iter().filter_map(|image| Path::new(&image.name).file_name()) {
        *shared.entry(name).or_default() += 1;
    }
    let position = |image: &ModelImage| {
        let name = Path::new(&image.name);
        let file = name.file_name()?;
        let candidates = named.get(file)?;
        let path = |at: usize| &pictures.entries[at].colour;
        let candidates = || candidates.iter().copied();
        let exact = candidates().find(|&at| *path(at) == folder.join(name));
        let alone = |fits: &dyn Fn(usize) -> bool| {
            let mut fitting = candidates().filter(|&at| fits(at));
            fitting.next().filter(|_| fitting.next().is_none())
        };
        exact
            .or_else(|| alone(&|at| path(at).ends_with(name)))
            .or_else(|| alone(&|_| true).filter(|_| shared[file] == 1))
    };
    images.iter().map(position).collect()
}

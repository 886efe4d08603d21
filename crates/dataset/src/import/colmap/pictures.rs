//! The pictures of a model, by name.

use super::ModelImage;
use crate::calibration::Calibration;
use crate::layouts::Source;
use crate::sequence::{DEFAULT_FRAME_RATE, name_of};
use crate::{DatasetError, OpenOptions, Sequence};
use std::path::{Path, PathBuf};

/// `images/` beside the model or up to three folders above.
pub(super) fn beside(model: &Path) -> Result<PathBuf, DatasetError> {
    let whole = model.canonicalize().unwrap_or_else(|_| model.to_path_buf());
    let places = whole.ancestors().take(4).map(|folder| folder.join("images"));
    places.into_iter().find(|folder| folder.is_dir()).ok_or_else(|| {
        let reason = "no folder images/ beside the model or above it: name the folder of the \
                      pictures";
        DatasetError::metadata(model, reason)
    })
}

/// The pictures of a sequence or folder, seen by the camera of the model.
pub(super) fn open(
    folder: &Path,
    calibration: Calibration,
    options: &OpenOptions,
) -> Result<Sequence, DatasetError> {
    if !folder.exists() {
        return Err(DatasetError::MissingFolder { path: folder.to_path_buf() });
    }
    let source = Source::recognise(folder, options.colour_only)?;
    let listing = source.list(folder, options, DEFAULT_FRAME_RATE)?;
    let traits = source.traits().for_another_camera();
    let calibration = Calibration {
        depth_scale: options.depth_scale.unwrap_or(traits.depth_scale),
        grid: traits.grid,
        invalid_depth: traits.invalid_depth,
        ..calibration
    };
    Sequence::of(name_of(folder), listing, calibration, options, DEFAULT_FRAME_RATE)
}

/// For every image of the model the place of its picture: by its whole name, which may have
/// folders, else by that of its file.
pub(super) fn places(images: &[ModelImage], pictures: &Sequence) -> Vec<Option<usize>> {
    let place = |image: &ModelImage| {
        let name = Path::new(&image.name);
        let ends = |name: &Path| pictures.entries.iter().position(|e| e.colour.ends_with(name));
        ends(name).or_else(|| ends(Path::new(name.file_name()?)))
    };
    images.iter().map(place).collect()
}

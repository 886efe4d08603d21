//! The pictures of a model, by name.

use super::ModelImage;
use crate::calibration::{Calibration, Traits};
use crate::layouts::{self, Source};
use crate::sequence::{DEFAULT_FRAME_RATE, name_of};
use crate::{DatasetError, OpenOptions, Sequence};
use std::collections::HashMap;
use std::ffi::OsStr;
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

/// The pictures of a sequence or folder, or in folders below it, seen by the camera of the model.
pub(super) fn open(
    folder: &Path,
    calibration: Calibration,
    options: &OpenOptions,
) -> Result<Sequence, DatasetError> {
    if !folder.exists() {
        return Err(DatasetError::MissingFolder { path: folder.to_path_buf() });
    }
    let (listing, traits) = match Source::recognise(folder, options.colour_only) {
        Ok(source) => (source.list(folder, options, DEFAULT_FRAME_RATE)?, source.traits()),
        Err(error @ DatasetError::UnknownLayout { .. }) if options.colour_only => {
            let below = layouts::pictures_below(folder, DEFAULT_FRAME_RATE);
            (below.ok_or(error)?, Traits::default())
        }
        Err(error) => return Err(error),
    };
    let traits = traits.for_another_camera();
    let calibration = Calibration {
        depth_scale: options.depth_scale.unwrap_or(traits.depth_scale),
        grid: traits.grid,
        invalid_depth: traits.invalid_depth,
        ..calibration
    };
    Sequence::of(name_of(folder), listing, calibration, options, DEFAULT_FRAME_RATE)
}

/// For every image of the model the place of its picture: by its whole name in `folder`, or at the
/// end of one path, else by that of its file if no other image and no other picture has it.
pub(super) fn places(
    folder: &Path,
    images: &[ModelImage],
    pictures: &Sequence,
) -> Vec<Option<usize>> {
    let mut named: HashMap<&OsStr, Vec<usize>> = HashMap::new();
    for (at, entry) in pictures.entries.iter().enumerate() {
        named.entry(entry.colour.file_name().unwrap_or_default()).or_default().push(at);
    }
    let mut shared: HashMap<&OsStr, usize> = HashMap::new();
    for name in images.iter().filter_map(|image| Path::new(&image.name).file_name()) {
        *shared.entry(name).or_default() += 1;
    }
    let place = |image: &ModelImage| {
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
    images.iter().map(place).collect()
}

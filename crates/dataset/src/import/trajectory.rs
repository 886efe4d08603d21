//! A trajectory in the TUM format with the pictures of a sequence.

use super::keyframe::{DepthSource, Source};
use super::placed::{Found, by_time, open_pictures};
use super::{Depth, Kind, Options};
use crate::DatasetError;
use crate::trajectory_file::read_unit_trajectory;
use std::path::Path;

/// Opens the poses of `file` with `pictures`, by default the folder that the file lies in.
pub(super) fn open(
    file: &Path,
    pictures: Option<&Path>,
    options: &Options,
) -> Result<Found, DatasetError> {
    let poses = read_unit_trajectory(file)?;
    let beside = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = pictures.unwrap_or(beside.unwrap_or(Path::new(".")));
    let with_depth = options.depth == Depth::Pictures;
    let sequence = open_pictures(folder, options, with_depth)?;
    let mut warnings = sequence.warnings.clone();
    let (keyframes, left_out) = by_time(&poses, &sequence, options, &mut warnings);
    let depth = if with_depth { DepthSource::Pictures } else { DepthSource::None };
    let source = Source { pictures: Box::new(sequence), depth };
    let path = file.to_path_buf();
    Ok(Found { kind: Kind::Trajectory, path, source, keyframes, left_out, warnings })
}

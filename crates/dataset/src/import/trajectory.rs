//! A trajectory in the TUM format with the pictures of a sequence.

use super::keyframe::{DepthSource, Pictures, Source};
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
    let depth = DepthSource::pictures_if_wanted(options)?;
    let sequence = open_pictures(folder, options, options.depth == Depth::Pictures)?;
    let mut warnings = sequence.warnings.clone();
    let (keyframes, left_out) =
        by_time(poses.into_iter().enumerate().collect(), &sequence, options, &mut warnings);
    let source = Source { pictures: Pictures::Sequence(Box::new(sequence)), depth };
    let path = file.to_path_buf();
    Ok(Found { kind: Kind::Trajectory, path, source, keyframes, left_out, warnings })
}

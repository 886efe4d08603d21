//! nerfstudio's `transforms.json`: pictures, poses and perhaps depth of one file.

use super::keyframe::{DepthSource, Pictures, Source};
use super::placed::{Found, all_frames, by_time};
use super::{Depth, Kind, Options};
use crate::layouts::{self, Scene};
use crate::{DatasetError, Sequence};
use std::path::Path;

/// Opens the file, whose pictures and depths lie where it says, whatever `pictures` names.
pub(super) fn open(
    file: &Path,
    pictures: Option<&Path>,
    options: &Options,
) -> Result<Found, DatasetError> {
    let scene = Scene::open(file, false)?;
    let with_depth = options.depth != Depth::None && scene.has_depth();
    if options.depth == Depth::Pictures && !with_depth {
        let reason = "no frame has a depth_file_path, and depth pictures are asked for";
        return Err(DatasetError::metadata(file, reason));
    }
    let source = layouts::Source::Nerfstudio(scene);
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let sequence = Sequence::from_source(folder, &source, &all_frames(options, with_depth))?;
    let mut warnings = sequence.warnings.clone();
    let whole = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_path_buf());
    if let Some(other) = pictures.filter(|other| !whole(folder).starts_with(whole(other))) {
        warnings.push(format!(
            "the pictures are those that {} names, not those of {}",
            file.display(),
            other.display()
        ));
    }
    let poses = sequence.poses.iter().copied().enumerate().collect();
    let (keyframes, mut left_out) = by_time(poses, &sequence, options, &mut warnings);
    left_out.reason = "the other frames have no transform_matrix that is finite and rigid".into();
    let depth = if with_depth { DepthSource::pictures(options)? } else { DepthSource::None };
    let source = Source { pictures: Pictures::Sequence(Box::new(sequence)), depth };
    let path = file.to_path_buf();
    Ok(Found { kind: Kind::Nerfstudio, path, source, keyframes, left_out, warnings })
}

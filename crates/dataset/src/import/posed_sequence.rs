//! Keyframes of a nerfstudio file or a TUM trajectory, with the images of a sequence.

use super::posed_images::{ReadKeyframes, all_frames, match_by_time, open_images};
use super::source::{DepthSource, ImageSource, KeyframeSource};
use super::{ImportDepth, ImportFormat, ImportOptions};
use crate::formats::nerfstudio::TransformsFile;
use crate::formats::{DetectedLayout, read_unit_trajectory};
use crate::{DatasetError, Sequence};
use std::path::Path;

/// Opens a `transforms.json`. It names its images itself; a warning if `pictures` is another folder.
pub(super) fn open_nerfstudio(
    file: &Path,
    pictures: Option<&Path>,
    options: &ImportOptions,
) -> Result<ReadKeyframes, DatasetError> {
    let transforms = TransformsFile::open(file, false)?;
    let with_depth = options.depth != ImportDepth::None && transforms.has_depth();
    if options.depth == ImportDepth::Pictures && !with_depth {
        let reason = "no frame has a depth_file_path, and depth pictures are asked for";
        return Err(DatasetError::metadata(file, reason));
    }
    let layout = DetectedLayout::Nerfstudio(transforms);
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new("."));
    let sequence = Sequence::from_layout(folder, &layout, &all_frames(options, with_depth))?;
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
    let (keyframes, mut unmatched) = match_by_time(poses, &sequence, options, &mut warnings);
    unmatched.reason = "the other frames have no transform_matrix that is finite and rigid".into();
    let depth = if with_depth { DepthSource::images(options)? } else { DepthSource::None };
    let source = KeyframeSource { images: ImageSource::Sequence(Box::new(sequence)), depth };
    let path = file.to_path_buf();
    Ok(ReadKeyframes {
        format: ImportFormat::Nerfstudio,
        path,
        source,
        keyframes,
        unmatched,
        warnings,
    })
}

/// Opens a trajectory with the images of `pictures`, by default of the folder it lies in.
pub(super) fn open_trajectory(
    file: &Path,
    pictures: Option<&Path>,
    options: &ImportOptions,
) -> Result<ReadKeyframes, DatasetError> {
    let poses = read_unit_trajectory(file)?;
    let beside = file.parent().filter(|folder| !folder.as_os_str().is_empty());
    let folder = pictures.unwrap_or(beside.unwrap_or(Path::new(".")));
    let depth = DepthSource::images_if_requested(options)?;
    let sequence = open_images(folder, options, options.depth == ImportDepth::Pictures)?;
    let mut warnings = sequence.warnings.clone();
    let (keyframes, unmatched) =
        match_by_time(poses.into_iter().enumerate().collect(), &sequence, options, &mut warnings);
    let source = KeyframeSource { images: ImageSource::Sequence(Box::new(sequence)), depth };
    let path = file.to_path_buf();
    Ok(ReadKeyframes {
        format: ImportFormat::Trajectory,
        path,
        source,
        keyframes,
        unmatched,
        warnings,
    })
}

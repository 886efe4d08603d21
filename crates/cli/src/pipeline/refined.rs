//! Keyframes from files that are followed through their pictures.

use super::path::{PATH_SIDE, watch};
use crate::failure::Failure;
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::OpenOptions;
use i2slam::dataset::import::Files;
use i2slam::keyframes::{
    Import, ImportOptions, Intrinsics, KeyframeSource, Native, NativeError, NativeFailure,
    PictureError, Refined, SequencePicture, import,
};
use std::path::Path;

/// The keyframes of files with what their pictures tell of poses and depth; none if they come with
/// depth, or their pictures are no video that can be followed, which is said.
pub(super) fn refined(
    path: &Path,
    pictures: &Path,
    options: &ImportOptions,
    source: &Import,
    progress: &Progress,
) -> Result<Option<Box<dyn KeyframeSource>>, Failure> {
    let files = source.files();
    if files.has_depth {
        return Ok(None);
    }
    let larger = import(path, Some(pictures), &large(options, files))?;
    let large = larger.files();
    let load = |place: usize| picture(large, place);
    let camera = Intrinsics::Known(large.camera);
    let found = Native::find(camera, large.len(), load, &watch(progress, None));
    let found = match found {
        Ok(found) => found,
        Err(NativeError::NoPath { failure: NativeFailure::Ended, .. }) => {
            progress.note("ended while the pictures were followed: poses stay as they came");
            return Ok(None);
        }
        Err(failure) => {
            progress.note(&format!("poses are taken as they came, without depth: {failure}"));
            return Ok(None);
        }
    };
    let own = files.clone();
    let load = move |place: usize| picture(&own, place);
    let poses = files.keyframes.iter().map(|keyframe| keyframe.world_from_camera).collect();
    let refined = Refined::new(files.camera, poses, &found, load, interrupt::stop());
    let Some(refined) = refined else {
        progress.note("poses are taken as they came, without depth: the pictures show no path");
        return Ok(None);
    };
    progress.note(&refined.told());
    Ok(Some(Box::new(refined)))
}

/// The same pictures, smaller ones as large as the path is best found in if they were recorded so large.
fn large(options: &ImportOptions, files: &Files) -> ImportOptions {
    let open = match files.camera.width.max(files.camera.height) < PATH_SIDE {
        true => OpenOptions { scale: 1.0, max_side: Some(PATH_SIDE), ..options.open.clone() },
        false => options.open.clone(),
    };
    ImportOptions { open, ..options.clone() }
}

fn picture(files: &Files, place: usize) -> Result<SequencePicture, PictureError> {
    let keyframe = files.load(place)?;
    let (index, timestamp) = (keyframe.index, keyframe.timestamp);
    Ok(SequencePicture { index, timestamp, colour: keyframe.colour })
}

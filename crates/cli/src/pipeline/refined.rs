//! Keyframes from files that are followed through their pictures.

use super::path::{PATH_SIDE, odometry_progress};
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::Frame;
use i2slam::dataset::import::Files;
use i2slam::keyframes::{
    Intrinsics, KeyframeSource, MonocularError, MonocularSource, OdometryError, PictureError,
    RefinedImport,
};

/// The keyframes of files with what their pictures tell of poses and depth; none if they come with
/// depth, or their pictures are no video that can be followed, which is said.
pub(super) fn refined(files: &Files, progress: &Progress) -> Option<Box<dyn KeyframeSource>> {
    if files.has_depth {
        return None;
    }
    let large = files.at_least(PATH_SIDE);
    let load = |place: usize| picture(&large, place);
    let camera = Intrinsics::Known(large.camera);
    let found =
        MonocularSource::find(camera, large.len(), load, &odometry_progress(progress, None));
    let found = match found {
        Ok(found) => found,
        Err(MonocularError::NoPath { failure: OdometryError::Cancelled, .. }) => {
            progress.note("ended while the pictures were followed: poses stay as they came");
            return None;
        }
        Err(failure) => {
            progress.note(&format!("poses are taken as they came, without depth: {failure}"));
            return None;
        }
    };
    let own = files.clone();
    let load = move |place: usize| picture(&own, place);
    let poses = files.keyframes.iter().map(|keyframe| keyframe.world_from_camera).collect();
    let refined = RefinedImport::new(files.camera, poses, &found, load, interrupt::cancellation());
    let Some(refined) = refined else {
        progress.note("poses are taken as they came, without depth: the pictures show no path");
        return None;
    };
    progress.note(&refined.told());
    Some(Box::new(refined))
}

fn picture(files: &Files, place: usize) -> Result<Frame, PictureError> {
    let keyframe = files.load(place)?;
    let (index, timestamp) = (keyframe.index, keyframe.timestamp);
    Ok(Frame::colour_only(index, timestamp, keyframe.colour))
}

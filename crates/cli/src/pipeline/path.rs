//! The search for the path of the camera, and what is seen of it.

use super::estimate::Estimate;
use super::posed::picture;
use super::{Job, camera};
use crate::failure::Failure;
use crate::interrupt;
use crate::progress::Progress;
use i2slam::dataset::{Frame, Sequence};
use i2slam::keyframes::{
    MonocularError, MonocularSource, OdometryError, OdometryProgress, PictureError, Stage,
};
use std::sync::Mutex;

/// Longer side of the pictures in which the path of the camera is found, where they were recorded
/// so large [px]: smaller ones, which a map may be made of, show less exactly where points are.
pub(super) const PATH_SIDE: usize = 640;

/// The path of the camera through pictures as they are.
pub(super) fn find_path(
    sequence: &Sequence,
    estimate_distortion: bool,
    job: &Job,
    progress: &Progress,
) -> Result<MonocularSource<impl FnMut(usize) -> Result<Frame, PictureError> + use<>>, Failure> {
    let large = sequence.at_least(PATH_SIDE);
    camera::before(sequence, &large).iter().for_each(|line| progress.note(line));
    let intrinsics = camera::intrinsics(&large, estimate_distortion);
    let count = large.len();
    let estimate = Estimate::new(job, sequence);
    let odometry_progress = odometry_progress(progress, Some(estimate));
    let load = move |place: usize| picture(&large, place);
    match MonocularSource::find(intrinsics, count, load, &odometry_progress) {
        Err(MonocularError::NoPath { failure: OdometryError::Cancelled, .. }) => {
            let ended = "ended before the path of the camera was found: there is nothing to write";
            progress.note(ended);
            Err(Failure::Interrupted)
        }
        Err(error) => Err(Failure::Failed(format!("no path of the camera was found: {error}"))),
        Ok(found) => Ok(found),
    }
}

/// Shows how far the search is, and early on what the whole job will take, by the estimate if there
/// is one.
pub(super) fn odometry_progress(
    progress: &Progress,
    estimate: Option<Estimate>,
) -> OdometryProgress {
    let shown = Mutex::new((progress.clone(), estimate));
    OdometryProgress::new(interrupt::cancellation(), move |stage, done, of| {
        let Ok(mut shown) = shown.lock() else { return };
        let (progress, estimate) = &mut *shown;
        progress.stage(words(stage), done, of);
        if let (Stage::Tracking { keyframes }, Some(estimate)) = (stage, estimate) {
            let told = estimate.after(done, keyframes);
            told.iter().for_each(|line| progress.note(line));
        }
    })
}

fn words(stage: Stage) -> &'static str {
    match stage {
        Stage::Tracking { .. } => "following points",
        Stage::FocalLength => "looking for the focal length",
        Stage::Registration => "finding the path of the camera",
        Stage::BundleAdjustment => "adjusting the path",
        Stage::RollingShutter => "looking for a rolling shutter",
        Stage::LoopClosure => "looking for places seen again",
    }
}

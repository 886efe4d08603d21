//! Keyframes with poses of another program, refined by visual odometry.

use super::RunOptions;
use super::error::RunError;
use super::input::{Input, KnownPath};
use super::observer::RunContext;
use super::odometry::{ODOMETRY_SIDE, odometry_progress};
use crate::config::MapKind;
use crate::keyframes::{
    BoxedLoader, ImportDepth, ImportOptions, Intrinsics, KeyframeSource, MonocularError,
    MonocularSource, OdometryError, PictureError, RefinedImport, import,
};
use i2slam_dataset::import::ImportedKeyframes;
use i2slam_dataset::{DepthPicture, Frame};
use i2slam_geometry::Pose;
use std::path::Path;
use std::sync::Arc;

/// Opens the keyframes of another program in the pictures of a dataset.
pub(super) fn open(
    (keyframes, pictures): (&Path, &Path),
    import_options: &ImportOptions,
    options: &RunOptions,
    context: &RunContext,
) -> Result<Input<'static>, RunError> {
    let source = import(keyframes, Some(pictures), import_options)?;
    let (count, frame_rate) = (source.files().len(), source.files().frame_rate);
    let refines =
        import_options.depth != ImportDepth::None && options.config.keyframed.refine_imported;
    let refined = if refines { refined(source.files(), context) } else { None };
    source.files().warnings.iter().for_each(|warning| context.warn(warning.as_str()));
    let is_without_depth = refined.is_none() && !source.files().has_depth;
    let begins_on_depth = options.config.map.kind == MapKind::Gaussian;
    if is_without_depth && begins_on_depth && !context.cancellation.is_cancelled() {
        return Err(RunError::NoDepth);
    }
    let camera_source = source.files().camera_source.clone();
    Ok(match refined {
        None => Input::keyframes(Box::new(source), camera_source, count, frame_rate),
        Some(Refined::Keyframes(refined)) => {
            Input::keyframes(refined, camera_source, count, frame_rate)
        }
        Some(Refined::Path(path)) => {
            let pictures = source.files().clone();
            let between = path.non_keyframes(move |place| imported_picture(&pictures, place));
            let (between, keyframes) = (Box::new(between), path.remaining());
            let files = source.files();
            let by_index = |(place, stamp, pose): (usize, f64, Pose<f64>)| {
                Some((files.keyframes.get(place)?.index, stamp, pose))
            };
            let poses = path.trajectory().into_iter().filter_map(by_index).collect();
            let path = path.with_dense_depth(context.cancellation.clone());
            Input {
                between,
                frames_given: count,
                path: KnownPath { poses, ..KnownPath::default() },
                ..Input::keyframes(Box::new(path), camera_source, keyframes, frame_rate)
            }
        }
    })
}

/// Imported keyframes as visual odometry makes them.
enum Refined {
    /// The keyframes, with its poses or dense depth.
    Keyframes(Box<dyn KeyframeSource>),
    /// Its own path: no pose of a single moment explains rows that were exposed one after the other.
    Path(Box<MonocularSource<BoxedLoader>>),
}

/// Imported keyframes with poses refined by visual odometry, where these come without depth with its
/// dense depth in place of that of a few points, too; none if they come with dense depth that was computed
/// with poses, or if no path is found in their pictures, which is noted.
fn refined(files: &ImportedKeyframes, context: &RunContext) -> Option<Refined> {
    if files.has_variance && !files.has_sparse_depth {
        return None;
    }
    let kept = match (files.has_sparse_depth, files.has_depth) {
        (true, _) => "the imported poses stay as they are, with depth at their points alone",
        (false, true) => "the imported poses stay as they are",
        (false, false) => "the imported poses stay as they are, without depth",
    };
    let note = |line: &str| context.observer.note(line);
    let large = files.at_least(ODOMETRY_SIDE);
    let load = |place: usize| imported_picture(&large, place);
    let camera = Intrinsics::Known(large.camera);
    let poses: Vec<Pose<f64>> = files.keyframes.iter().map(|k| k.world_from_camera).collect();
    let progress = odometry_progress(context, None);
    let found = match MonocularSource::find_near((camera, &poses), large.len(), load, &progress) {
        Ok(found) => found,
        Err(MonocularError::NoPath { failure: OdometryError::Cancelled, .. }) => {
            note("ended during visual odometry: the imported poses stay as they are");
            return None;
        }
        Err(failure) => {
            context.warn(format!("{kept}: {failure}"));
            return None;
        }
    };
    let own = files.clone();
    let load: BoxedLoader = Box::new(move |place| imported_picture(&own, place));
    if found.reconstruction().rolling_shutter_readout != 0.0 {
        let size = (files.camera.width, files.camera.height);
        let Some(found) = found.near(&poses) else {
            context.warn(format!("{kept}: odometry found too few of them"));
            return None;
        };
        note(
            "the pictures show a rolling shutter: poses are those found from them, near the imported ones",
        );
        return Some(Refined::Path(Box::new(found.with_pictures(size, load))));
    }
    let refined =
        RefinedImport::new(files.camera, poses, &found, load, context.cancellation.clone());
    let Some(refined) = refined else {
        context.warn(format!("{kept}: odometry found too few of them"));
        return None;
    };
    match refined.is_unchecked() {
        true => context.warn(refined.summary()),
        false => note(&refined.summary()),
    }
    Some(Refined::Keyframes(Box::new(refined)))
}

fn imported_picture(files: &ImportedKeyframes, place: usize) -> Result<Frame, PictureError> {
    let keyframe = files.load(place)?;
    let (index, timestamp) = (keyframe.index, keyframe.timestamp);
    let measured = keyframe.depth.filter(|_| !files.has_sparse_depth);
    let depth = measured.map(|depth| DepthPicture { image: Arc::new(depth), timestamp });
    Ok(Frame { depth, ..Frame::colour_only(index, timestamp, keyframe.colour) })
}

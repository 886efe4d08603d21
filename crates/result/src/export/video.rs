//! A flight as a video, along the smoothed path of the camera or through given views, encoded by ffmpeg.

use super::error::ExportError;
use super::scene::Scene;
use super::smooth_path::smooth_path;
use super::view_path::path_through;
use super::watch::Watch;
use crate::pictures::interleaved_bytes;
use i2slam::LightMeter;
use i2slam::dataset::{VideoEncoder, VideoFormat};
use i2slam::formation::AutoExposureFit;
use i2slam::geometry::{Pose, StampedPose};
use i2slam_storage::write_file;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::path::{Path, PathBuf};

/// Pictures per second.
const RATE: u32 = 30;
/// Longest video \[s\]: stamps in other units than seconds span more.
const MAX_SECONDS: f64 = 6.0 * 3600.0;

/// What was written.
#[derive(Clone, Copy, Debug)]
pub struct Video {
    /// Number of pictures.
    pub pictures: usize,
    /// Length [s].
    pub seconds: f64,
    /// The controller that chose the exposures, with its errors; `None` where all are typical of the run.
    pub exposure: Option<AutoExposureFit>,
}

/// Writes the video with a comment: as long as the recording, or through `views` of the result's world, whose
/// times rise. Pictures are exposed as the camera would have done it, where the run's frames tell how; white
/// balance and response are typical of the run.
///
/// # Errors
/// [`ExportError::Refused`] of poses that span more than six hours, and of photographs without `views`;
/// [`ExportError::Video`] if ffmpeg is missing or fails; those of the system;
/// [`ExportError::Cancelled`].
pub fn write(
    scene: &Scene,
    out: &Path,
    views: Option<&[StampedPose]>,
    comment: &str,
    watch: &Watch<'_>,
) -> Result<Video, ExportError> {
    scene.require_map()?;
    let path = path(scene, views)?;
    let reconstruction = &scene.reconstruction;
    let size = (reconstruction.camera.width, reconstruction.camera.height);
    // ffmpeg goes back to the beginning of a file when it ends, which a stream does not let it.
    let scratch = Scratch::new();
    let format = VideoFormat { size, rate: RATE, comment };
    let mut encoder = VideoEncoder::start(&scratch.0, format)?;
    let mut meter = reconstruction.light_meter();
    let exposure = fit_exposure(scene, &mut meter, watch)?;
    let mut camera = exposure.map(|fit| fit.controller.follow());
    let mut viewer = reconstruction.viewer();
    for (done, pose) in path.iter().enumerate() {
        watch.step("rendering", done, path.len())?;
        let mut frame = reconstruction.virtual_frame(done, *pose);
        frame.timestamp = done as f64 / f64::from(RATE);
        if let Some(camera) = &mut camera {
            meter.expose(&mut frame, camera);
        }
        encoder.add(&interleaved_bytes(&viewer.sharp(&frame)))?;
    }
    encoder.finish()?;
    write_file(out, |out| io::copy(&mut i2slam_storage::open(&scratch.0)?, out).map(drop))?;
    let (pictures, seconds) = (path.len(), path.len() as f64 / f64::from(RATE));
    Ok(Video { pictures, seconds, exposure })
}

/// A pose for each picture.
fn path(scene: &Scene, views: Option<&[StampedPose]>) -> Result<Vec<Pose<f64>>, ExportError> {
    if views.is_none() && scene.is_unordered {
        let why =
            "photographs have no order of time in which to fly through them: give views (--poses)";
        return Err(ExportError::refused(why));
    }
    let times: Vec<f64> = match views {
        Some(views) => views.iter().map(|view| view.timestamp).collect(),
        None => scene.frames.iter().map(|frame| frame.timestamp).collect(),
    };
    check_span(&times)?;
    let poses = || -> Vec<_> { scene.frames.iter().map(|frame| frame.middle()).collect() };
    Ok(match views {
        Some(views) => path_through(views, f64::from(RATE)),
        None => smooth_path(&times, &poses(), f64::from(RATE)),
    })
}

/// Refuses times [s] that span more than a video may be long.
fn check_span(times: &[f64]) -> Result<(), ExportError> {
    let span = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
    if span <= MAX_SECONDS {
        return Ok(());
    }
    Err(ExportError::refused(format!(
        "the poses span {span:.0} s, more than the {MAX_SECONDS:.0} s that a video may be long: time stamps \
         are in seconds"
    )))
}

/// The camera of the run, where exposure is to follow and does.
fn fit_exposure(
    scene: &Scene,
    meter: &mut LightMeter<'_>,
    watch: &Watch<'_>,
) -> Result<Option<AutoExposureFit>, ExportError> {
    if scene.constant_exposure {
        return Ok(None);
    }
    let fit = meter.fit(|done, total| watch.step("metering", done, total))?;
    Ok(fit.filter(|fit| fit.better_than_constant().is_some()))
}

/// A new name for a file that is removed in the end.
struct Scratch(PathBuf);

impl Scratch {
    fn new() -> Self {
        let number = RandomState::new().hash_one(std::process::id());
        Self(std::env::temp_dir().join(format!("i2slam-{number:016x}.mp4")))
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // It may never have been made.
        drop(std::fs::remove_file(&self.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::Selection;
    use crate::tests::example;
    use i2slam::formation::{Meter, ShutterPoses};
    use i2slam::geometry::{Pose, Rotation, Vec3};
    use i2slam::radiance::gaussian::{ColourActivation, Gaussian, GaussianMap, Shape};
    use i2slam::{CancellationToken, Map, Reconstruction};

    /// A wall that is brighter towards the right, and a camera that turns along it and exposes by the median.
    fn exposed_wall() -> Reconstruction {
        let mut wall = example(40);
        let mut map = GaussianMap::new(Shape::Isotropic, ColourActivation::Exponential);
        for (row, column) in (-10..=10).flat_map(|row| (-20..=20).map(move |column| (row, column)))
        {
            let (x, y) = (0.1 * column as f32, 0.1 * row as f32);
            map.push(Gaussian {
                mean: [x, y, 1.0],
                log_scale: [-2.8; 3],
                rotation: [1.0, 0.0, 0.0, 0.0],
                opacity_logit: 3.0,
                colour: [2.0 * x; 3],
            });
        }
        wall.map = Map::Gaussians(map);
        for (i, frame) in wall.frames.iter_mut().enumerate() {
            let turn = Vec3::new(0.0, 0.5 * (0.4 * i as f64).sin(), 0.0);
            frame.shutter = ShutterPoses::still(Pose::new(Rotation::exp(turn), Vec3::zero()));
        }
        let mut meter = wall.light_meter();
        let lights: Vec<_> = wall.frames.iter().map(|frame| meter.read(frame.middle())).collect();
        drop(meter);
        for (frame, light) in wall.frames.iter_mut().zip(lights) {
            frame.tone.log_exposure = -light.expect("a wall").get(Meter::Median) as f32;
        }
        wall
    }

    #[test]
    fn exposure_follows_unless_it_is_to_be_constant() {
        let watch =
            Watch { progress: &|_, _, _| {}, cancellation: CancellationToken::when(|| false) };
        let fit = |run: Reconstruction, constant_exposure: bool| {
            let selection = Selection { constant_exposure, ..Selection::default() };
            let scene = Scene::new(run, &selection).expect("a scene");
            fit_exposure(&scene, &mut scene.reconstruction.light_meter(), &watch).expect("a fit")
        };
        let found = fit(exposed_wall(), false).expect("exposure follows the wall");
        assert!(found.controller.slope < -0.9 && found.error < 0.1, "{found:?}");
        assert_eq!(fit(exposed_wall(), true), None);
        let mut constant = exposed_wall();
        constant.frames.iter_mut().for_each(|frame| frame.tone.log_exposure = 0.3);
        assert_eq!(fit(constant, false), None);
    }
}

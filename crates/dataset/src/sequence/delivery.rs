//! The size of delivered frames; reopening a sequence at another size or with another camera.

use super::Sequence;
use super::checks::coverage_warning;
use super::frames::FrameLoader;
use crate::camera::{Distortion, ESTIMATED_SOURCE};
use crate::image::{RecordingCameras, Resampler};
use crate::video::Video;
use crate::{DatasetError, EstimatedCamera, OpenOptions};
use i2slam_geometry::Camera;
use std::sync::Arc;

/// Smallest side of delivered frames [px].
const MIN_SIDE: usize = 8;

impl Sequence {
    /// Enlarges frames to a longer side of `side` [px], at most the recorded size; never smaller than
    /// before. [`warnings`](Self::warnings) are those of the new size alone.
    #[must_use]
    pub fn at_least(&self, side: usize) -> Self {
        let loader = &self.loader;
        let border = loader.resampler.border();
        let whole = self.cameras.grid.cropped(border);
        let now = self.camera.width.max(self.camera.height);
        let share = (side.max(now) as f64 / whole.width.max(whole.height) as f64).min(1.0);
        let scaled = |side: usize| (side as f64 * share).round() as usize;
        let size = (scaled(whole.width), scaled(whole.height));
        if size.0 <= self.camera.width {
            return Self { warnings: Vec::new(), ..self.clone() };
        }
        let video = loader.video.as_deref();
        let (resampler, video) = delivery(&self.cameras, &self.lens, border, size, video);
        self.with_loader(FrameLoader { resampler, video, ..FrameLoader::clone(loader) })
    }

    /// The sequence with frames delivered by another loader.
    fn with_loader(&self, loader: FrameLoader) -> Self {
        Self {
            camera: loader.resampler.camera,
            valid_mask: loader.resampler.valid_mask.clone().map(Arc::new),
            warnings: coverage_warning(&loader.resampler).into_iter().collect(),
            loader: Arc::new(loader),
            ..self.clone()
        }
    }

    /// The estimated camera of recorded images, from that of the delivered frames: pinhole `found`
    /// with the assumed principal point, and lens `k1 k2`.
    pub fn estimated_camera(&self, found: &Camera<f64>, distortion: [f64; 2]) -> EstimatedCamera {
        let colour = &self.cameras.colour;
        let (x, y) = (found.fx / self.camera.fx, found.fy / self.camera.fy);
        let intrinsics = [colour.fx * x, colour.fy * y, colour.cx - 0.5, colour.cy - 0.5];
        EstimatedCamera { intrinsics, distortion }
    }

    /// Replaces the camera and undistorts accordingly, as opening with
    /// [`OpenOptions::estimated_camera`] does. [`warnings`](Self::warnings) are those of the new
    /// camera alone.
    #[must_use]
    pub fn with_estimated_camera(&self, camera: &EstimatedCamera) -> Self {
        let cameras = estimated_cameras(camera, &self.cameras);
        let loader = &self.loader;
        let resampler = loader.resampler.with_camera(&cameras, &camera.lens());
        Self {
            camera_source: ESTIMATED_SOURCE.to_owned(),
            camera_is_guess: false,
            cameras,
            lens: camera.lens(),
            ..self.with_loader(FrameLoader { resampler, ..FrameLoader::clone(loader) })
        }
    }
}

/// The recording cameras with estimated intrinsics in place of the assumed ones.
fn estimated_cameras(estimated: &EstimatedCamera, assumed: &RecordingCameras) -> RecordingCameras {
    let [fx, fy, cx, cy] = estimated.intrinsics;
    let colour = Camera { fx, fy, cx: cx + 0.5, cy: cy + 0.5, ..assumed.colour };
    let resized = |camera: &Camera<f64>| colour.resized(camera.width, camera.height);
    RecordingCameras { colour, depth: resized(&assumed.depth), grid: resized(&assumed.grid) }
}

/// The resampler for frames of a size, and the video they come from, if any. Without a border
/// ffmpeg scales the colour of a video, which saves bandwidth of the pipe; depth must not be averaged.
pub(super) fn delivery(
    cameras: &RecordingCameras,
    lens: &Distortion,
    border: usize,
    delivered: (usize, usize),
    video: Option<&Video>,
) -> (Resampler, Option<Arc<Video>>) {
    let whole = (cameras.colour.width, cameras.colour.height);
    let (resampler, read) = match video {
        Some(_) if border == 0 => {
            (Resampler::of_scaled_colour(cameras, lens, delivered), delivered)
        }
        _ => (Resampler::new(cameras, lens, border, delivered), whole),
    };
    (resampler, video.map(|video| Arc::new(video.with_size(read))))
}

/// Width and height of the frames delivered on `grid`, cropped and scaled [px].
pub(crate) fn delivered_size(
    grid: &Camera<f64>,
    options: &OpenOptions,
) -> Result<(usize, usize), DatasetError> {
    let cropped = grid.cropped(options.crop_border);
    let longest = cropped.width.max(cropped.height);
    let max_scale = options.max_side.map_or(1.0, |side| side as f64 / longest as f64);
    let scale = options.scale.min(max_scale);
    let scaled = |side: usize| (side as f64 * scale).round() as usize;
    let (width, height) = (scaled(cropped.width), scaled(cropped.height));
    if width.min(height) >= MIN_SIDE {
        return Ok((width, height));
    }
    let reason = format!(
        "a border of {} and a scale of {} leave {width}x{height} px of {}x{}, expected at least \
         {MIN_SIDE} a side",
        options.crop_border, scale, grid.width, grid.height
    );
    Err(DatasetError::option("crop_border, scale", reason))
}

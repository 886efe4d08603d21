//! The size of delivered frames, and the same frames at another one.

use crate::checks::cover_warning;
use crate::distortion::Distortion;
use crate::prepare::Preparation;
use crate::resample::{Recorded, Resampler};
use crate::video::Video;
use crate::{DatasetError, OpenOptions, Sequence};
use i2slam_geometry::Camera;
use std::sync::Arc;

/// Delivered frames must have at least this many pixels a side.
const MIN_SIDE: usize = 8;

impl Sequence {
    /// The same frames with a longer side of `side` [px], or as large as they were recorded where
    /// that is less; never smaller than they are. [`warnings`](Self::warnings) are those of that
    /// size alone.
    #[must_use]
    pub fn at_least(&self, side: usize) -> Self {
        let before = &self.preparation;
        let border = before.resampler.border();
        let whole = self.recorded.grid.cropped(border);
        let now = self.camera.width.max(self.camera.height);
        let share = (side.max(now) as f64 / whole.width.max(whole.height) as f64).min(1.0);
        let scaled = |side: usize| (side as f64 * share).round() as usize;
        let size = (scaled(whole.width), scaled(whole.height));
        if size.0 <= self.camera.width {
            return Self { warnings: Vec::new(), ..self.clone() };
        }
        let video = before.video.as_deref();
        let (resampler, video) = resampled(&self.recorded, &self.lens, border, size, video);
        Self {
            camera: resampler.camera,
            covered: resampler.covered.clone().map(Arc::new),
            warnings: cover_warning(&resampler).into_iter().collect(),
            preparation: Arc::new(Preparation { resampler, video, ..Preparation::clone(before) }),
            ..self.clone()
        }
    }
}

/// What turns recorded pictures into frames of a size, and the video that they come from, if any:
/// it is scaled where it is decoded, which spares the pipe, unless a border is cut off.
pub(crate) fn resampled(
    recorded: &Recorded,
    lens: &Distortion,
    border: usize,
    delivered: (usize, usize),
    video: Option<&Video>,
) -> (Resampler, Option<Arc<Video>>) {
    let read = match video {
        Some(_) if border == 0 => recorded.resized(delivered),
        _ => *recorded,
    };
    let video = video.map(|v| Arc::new(v.delivering((read.colour.width, read.colour.height))));
    (Resampler::new(&read, lens, border, delivered), video)
}

/// Size of the frames from the grid `recorded` that they are delivered on, cropped and scaled.
pub(crate) fn delivered_size(
    recorded: &Camera<f64>,
    options: &OpenOptions,
) -> Result<(usize, usize), DatasetError> {
    let cropped = recorded.cropped(options.crop_border);
    let longest = cropped.width.max(cropped.height);
    let most = options.max_side.map_or(1.0, |side| side as f64 / longest as f64);
    let scale = options.scale.min(most);
    let scaled = |side: usize| (side as f64 * scale).round() as usize;
    let (width, height) = (scaled(cropped.width), scaled(cropped.height));
    if width.min(height) >= MIN_SIDE {
        return Ok((width, height));
    }
    let reason = format!(
        "a border of {} and a scale of {} leave {width}x{height} px of {}x{}, expected at least \
         {MIN_SIDE} a side",
        options.crop_border, scale, recorded.width, recorded.height
    );
    Err(DatasetError::Option { name: "crop_border, scale", reason })
}

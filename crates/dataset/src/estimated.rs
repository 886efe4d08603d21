//! A camera and its lens that the pictures themselves told, and pictures freed of that lens.

use crate::checks::cover_warning;
use crate::distortion::Distortion;
use crate::prepare::Preparation;
use crate::resample::Recorded;
use crate::{OpenOptions, Sequence};
use i2slam_geometry::Camera;
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// A camera with a lens that was found in the pictures of a sequence.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EstimatedCamera {
    /// `[fx, fy, cx, cy]` of the recorded colour pictures [px], pixel centres at integers as in
    /// OpenCV and TUM.
    pub intrinsics: [f64; 4],
    /// Radial distortion `k1 k2` as in OpenCV.
    pub distortion: [f64; 2],
}

impl EstimatedCamera {
    /// The lens.
    pub(crate) fn lens(&self) -> Distortion {
        let [k1, k2] = self.distortion;
        Distortion { radial: [k1, k2, 0.0], ..Distortion::default() }
    }

    /// The camera in place of the one that recorded the same pictures.
    fn recorded(&self, assumed: &Recorded) -> Recorded {
        let [fx, fy, cx, cy] = self.intrinsics;
        let colour = Camera { fx, fy, cx: cx + 0.5, cy: cy + 0.5, ..assumed.colour };
        let like = |camera: &Camera<f64>| colour.resized(camera.width, camera.height);
        Recorded { colour, depth: like(&assumed.depth), grid: like(&assumed.grid) }
    }

    /// Whether the numbers are those of a camera.
    pub(crate) fn is_sensible(&self) -> bool {
        let [fx, fy, ..] = self.intrinsics;
        let mut all = self.intrinsics.iter().chain(&self.distortion);
        all.all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0
    }
}

impl Sequence {
    /// What was found of a sequence whose [camera is a guess](Self::camera_is_guess): the pinhole
    /// camera `found` of the delivered frames, its principal point as assumed, and the lens
    /// `k1 k2` that bends them.
    pub fn estimated_camera(&self, found: &Camera<f64>, distortion: [f64; 2]) -> EstimatedCamera {
        let colour = &self.recorded.colour;
        let (x, y) = (found.fx / self.camera.fx, found.fy / self.camera.fy);
        let intrinsics = [colour.fx * x, colour.fy * y, colour.cx - 0.5, colour.cy - 0.5];
        EstimatedCamera { intrinsics, distortion }
    }

    /// The same frames by another camera: the lens is removed as that of a calibrated camera is.
    /// The same as opening with [`OpenOptions::estimated_camera`], without reading the lists again;
    /// [`warnings`](Self::warnings) are those of the new camera alone.
    #[must_use]
    pub fn with_estimated_camera(&self, camera: &EstimatedCamera) -> Self {
        let recorded = camera.recorded(&self.recorded);
        let before = &self.preparation;
        let (size, _) = before.resampler.recorded_sizes();
        let is_whole = size == (recorded.colour.width, recorded.colour.height);
        let read = if is_whole { recorded } else { recorded.resized(size) };
        let resampler = before.resampler.with_camera(&read, &camera.lens());
        Self {
            camera_source: ESTIMATED.to_owned(),
            camera_is_guess: false,
            camera: resampler.camera,
            covered: resampler.covered.clone().map(Arc::new),
            warnings: cover_warning(&resampler).into_iter().collect(),
            recorded,
            lens: camera.lens(),
            preparation: Arc::new(Preparation { resampler, ..Preparation::clone(before) }),
            ..self.clone()
        }
    }
}

/// Where an estimated camera comes from, in words.
pub(crate) const ESTIMATED: &str = "the pictures themselves";

impl OpenOptions {
    /// Why an estimated camera cannot be used, if so.
    pub(crate) fn wrong_estimate(&self) -> Option<String> {
        let wrong = self.estimated_camera.filter(|camera| !camera.is_sensible())?;
        Some(format!("{wrong:?}"))
    }
}

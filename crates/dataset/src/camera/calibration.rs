//! Intrinsics, lens and depth scale of the recording camera.

use super::{Distortion, ExifHints, FieldOfView};
use i2slam_geometry::Camera;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Relation between the pixel grids of colour and depth images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum DepthGrid {
    /// Depth is registered to colour, pixel by pixel.
    Registered,
    /// Depth has colour's field of view at another size; frames are delivered on colour's grid.
    ResizedToColour,
    /// Frames are delivered on depth's grid, with the depth camera's `[fx, fy, cx, cy]` [px];
    /// `None`: colour's intrinsics, resized.
    OwnCamera(Option<[f64; 4]>),
}

/// Properties shared by all sequences of a format.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FormatDefaults {
    /// Depth image value of one metre.
    pub(crate) depth_scale: f64,
    /// True where neither the format nor a file says so.
    pub(crate) is_scale_assumed: bool,
    /// Frames a second.
    pub(crate) frame_rate: Option<f64>,
    /// Relation between colour and depth pixels.
    pub(crate) grid: DepthGrid,
    /// Depth image value that means "no reading", beside 0.
    pub(crate) invalid_depth: Option<u16>,
}

impl FormatDefaults {
    /// TUM RGB-D.
    pub(crate) const TUM: Self = Self {
        depth_scale: 5000.0,
        is_scale_assumed: false,
        frame_rate: None,
        grid: DepthGrid::Registered,
        invalid_depth: None,
    };

    /// Whatever says nothing else.
    pub(crate) const PLAIN: Self = Self { is_scale_assumed: true, ..Self::TUM };

    /// With the scale of depth that the user gives, if any.
    pub(crate) fn with_given_scale(self, given: Option<f64>) -> Self {
        match given {
            Some(depth_scale) => Self { depth_scale, is_scale_assumed: false, ..self },
            None => self,
        }
    }

    /// Defaults for a colour camera given by the user: depth intrinsics then follow from it.
    pub(crate) fn with_depth_on_colour_camera(self) -> Self {
        let grid = match self.grid {
            DepthGrid::OwnCamera(_) => DepthGrid::OwnCamera(None),
            other => other,
        };
        Self { grid, ..self }
    }
}

/// Calibration of the recording camera.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Calibration {
    /// `[fx, fy, cx, cy]` of the colour camera [px], pixel centres at one half. Ignored if there
    /// is a `field_of_view`.
    pub(crate) intrinsics: [f64; 4],
    /// Field of view instead of intrinsics in pixels.
    pub(crate) field_of_view: Option<FieldOfView>,
    /// Whether the camera is assumed rather than given.
    pub(crate) is_guess: bool,
    /// Lens distortion.
    pub(crate) distortion: Distortion,
    /// Width and height of colour images [px], if known.
    pub(crate) size: Option<(usize, usize)>,
    /// Depth scale, frame rate and pixel grid.
    pub(crate) format: FormatDefaults,
    /// Description of the source, for messages: a file, a flag or a dataset name.
    pub(crate) source: String,
}

impl Calibration {
    /// From `[fx, fy, cx, cy]` with pixel centres at integers.
    pub(crate) fn from_opencv(
        k: [f64; 4],
        distortion: Distortion,
        source: &str,
        format: FormatDefaults,
    ) -> Self {
        Self {
            intrinsics: [k[0], k[1], k[2] + 0.5, k[3] + 0.5],
            field_of_view: None,
            is_guess: false,
            distortion,
            size: None,
            format,
            source: source.to_owned(),
        }
    }

    /// Camera without distortion whose principal point is the image centre.
    pub(crate) fn from_view(view: FieldOfView, source: String, defaults: FormatDefaults) -> Self {
        let found = Self::from_opencv([0.0; 4], Distortion::default(), &source, defaults);
        Self { field_of_view: Some(view), ..found }
    }

    /// A usual field of view, where the camera is not known.
    pub(crate) fn assumed(defaults: FormatDefaults) -> Self {
        let view = FieldOfView::ASSUMED;
        let found = Self::from_view(view, format!("a guess, {view}"), defaults);
        Self { is_guess: true, ..found }
    }

    /// Replaces camera and lens by estimated ones.
    pub(crate) fn replaced_by(self, camera: &EstimatedCamera) -> Self {
        let [fx, fy, cx, cy] = camera.intrinsics;
        Self {
            intrinsics: [fx, fy, cx + 0.5, cy + 0.5],
            field_of_view: None,
            is_guess: false,
            distortion: camera.lens(),
            size: None,
            source: ESTIMATED_SOURCE.to_owned(),
            ..self
        }
    }

    /// Replaces an assumed field of view by that in the EXIF data of the first image, if any.
    pub(crate) fn refined_by_exif(self, image: Option<&Path>) -> Self {
        let view = image.filter(|_| self.is_guess).and_then(|image| ExifHints::read(image).view);
        match view {
            Some(view) => {
                let source = format!("the EXIF data of the first picture, {view}");
                Self { field_of_view: Some(view), source, ..self }
            }
            None => self,
        }
    }

    /// Pinhole camera of colour images of a size [px].
    pub(crate) fn camera(&self, (width, height): (usize, usize)) -> Camera<f64> {
        let [fx, fy, cx, cy] = match self.field_of_view {
            None => self.intrinsics,
            Some(view) => {
                let f = view.focal_length(width, height);
                [f, f, 0.5 * width as f64, 0.5 * height as f64]
            }
        };
        Camera { width, height, fx, fy, cx, cy }
    }
}

/// Whether the principal point lies in the middle half of the image along both axes.
pub(crate) fn has_central_principal_point(camera: &Camera<f64>) -> bool {
    let is_central = |at: f64, size: usize| (0.25..=0.75).contains(&(at / size as f64));
    is_central(camera.cx, camera.width) && is_central(camera.cy, camera.height)
}

/// Source of an estimated camera in messages.
pub(crate) const ESTIMATED_SOURCE: &str = "the pictures themselves";

/// Camera and lens estimated by self-calibration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct EstimatedCamera {
    /// `[fx, fy, cx, cy]` of the recorded colour images [px], pixel centres at integers as in
    /// OpenCV and TUM.
    pub intrinsics: [f64; 4],
    /// Radial distortion `k1 k2` as in OpenCV.
    pub distortion: [f64; 2],
}

impl EstimatedCamera {
    /// Lens distortion.
    pub(crate) fn lens(&self) -> Distortion {
        let [k1, k2] = self.distortion;
        Distortion { radial: [k1, k2, 0.0], ..Distortion::default() }
    }

    /// Whether all numbers are finite and the focal lengths positive.
    pub(crate) fn is_valid(&self) -> bool {
        let [fx, fy, ..] = self.intrinsics;
        let mut all = self.intrinsics.iter().chain(&self.distortion);
        all.all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0
    }
}

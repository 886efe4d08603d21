//! Options for opening a sequence.

use crate::{DatasetError, EstimatedCamera};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::path::PathBuf;

/// Rule by which depth pictures are given to colour pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DepthPairing {
    /// A depth picture belongs to one colour picture, the two mutually nearest in time. All colour
    /// pictures are frames, those without a depth picture of their own too.
    #[default]
    OneToOne,
    /// Every colour picture takes the nearest depth picture, so that one may serve several; colour
    /// pictures without one are dropped. The association of SplaTAM.
    Nearest,
}

impl DepthPairing {
    /// The rule of results written before there was a choice.
    fn of_earlier_results() -> Self {
        Self::Nearest
    }
}

/// Options for opening a sequence. Start from [`OpenOptions::default`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct OpenOptions {
    /// A camera file to use instead of the folder's `camera.json`: another `camera.json`, a
    /// `transforms.json`, COLMAP's `cameras.txt` or `cameras.bin`, or a line `fx fy cx cy`.
    #[serde(with = "crate::path_text::optional")]
    pub camera: Option<PathBuf>,
    /// `[fx, fy, cx, cy]` [px] of a camera without lens distortion, pixel centres at integers
    /// as in OpenCV and TUM. Takes precedence over camera files.
    pub intrinsics: Option<[f64; 4]>,
    /// Horizontal field of view of a camera without lens distortion, its principal point in the
    /// middle [degrees, above 0, below 180]. Yields to `intrinsics` and `camera`, precedes the
    /// sequence's own calibration.
    pub field_of_view: Option<f64>,
    /// Camera and lens estimated from the images before. Takes precedence over every other camera.
    pub estimated_camera: Option<EstimatedCamera>,
    /// If no calibration is found, assume the field of view of the first image's EXIF data, else a
    /// usual one ([`Sequence::camera_is_guess`](crate::Sequence::camera_is_guess)), instead of
    /// failing. Default false.
    pub guess_camera: bool,
    /// Depth image value of one metre. Precedes the camera file; if neither gives it the layout's, else
    /// 1000 for videos and 5000 for folders.
    pub depth_scale: Option<f64>,
    /// Range of frames, by index in the associated stream. Default all.
    #[serde(with = "range_as_pair")]
    pub frames: Option<Range<usize>>,
    /// Step between frames, from the start of `frames` on; at least 1. Default 1.
    pub stride: usize,
    /// Size of the delivered frames over that of the cropped ones, in `(0, 1]`. Default 1.
    pub scale: f64,
    /// Largest longer side of delivered frames [px]; reduces `scale` if necessary. Default none.
    pub max_side: Option<usize>,
    /// Border removed on every side before scaling [px of the recorded colour image; of depth for
    /// ScanNet and 7-Scenes, which are delivered in the pixels of depth]. Default 0.
    pub crop_border: usize,
    /// Depth beyond this is taken as invalid [m]. Default none.
    pub max_depth: Option<f64>,
    /// The depth image of a frame (and, where the folder has ground truth, its pose) must be closer
    /// in time than this [s]. Default 0.08.
    pub association_tolerance: f64,
    /// Rule by which depth pictures are given to colour pictures. Default
    /// [`OneToOne`](DepthPairing::OneToOne).
    #[serde(default = "DepthPairing::of_earlier_results")]
    pub depth_pairing: DepthPairing,
    /// Frames that follow the last kept one by no more than this are dropped [s]; 0 keeps all.
    /// Default 1/32: the thinning of SplaTAM's TUM loader, which published frame numbers count by.
    /// Frames without time stamps are not thinned.
    pub minimum_gap: f64,
    /// Read colour only: sequences without depth can be opened, and
    /// [`Frame::depth`](crate::Frame::depth) is `None`. Frame numbers do not depend on this option, but
    /// for videos paired by [`Nearest`](DepthPairing::Nearest), whose depth is not looked at then.
    /// Default false.
    pub colour_only: bool,
    /// Apply the EXIF orientation of the first image to sequences of colour images alone. Default
    /// false: images stay as stored, with a warning.
    pub turn_pictures: bool,
}

impl Default for OpenOptions {
    fn default() -> Self {
        Self {
            camera: None,
            intrinsics: None,
            field_of_view: None,
            estimated_camera: None,
            guess_camera: false,
            depth_scale: None,
            frames: None,
            stride: 1,
            scale: 1.0,
            max_side: None,
            crop_border: 0,
            max_depth: None,
            association_tolerance: 0.08,
            depth_pairing: DepthPairing::OneToOne,
            minimum_gap: 1.0 / 32.0,
            colour_only: false,
            turn_pictures: false,
        }
    }
}

/// A range in files: `[first, one after the last]`.
mod range_as_pair {
    use super::*;
    use serde::{Deserializer, Serializer};

    pub(super) fn serialize<S: Serializer>(
        range: &Option<Range<usize>>,
        to: S,
    ) -> Result<S::Ok, S::Error> {
        range.as_ref().map(|range| [range.start, range.end]).serialize(to)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        from: D,
    ) -> Result<Option<Range<usize>>, D::Error> {
        let pair = Option::<[usize; 2]>::deserialize(from)?;
        Ok(pair.map(|[start, end]| start..end))
    }
}

impl OpenOptions {
    /// An error for values outside their documented range.
    pub(crate) fn validate(&self) -> Result<(), DatasetError> {
        let positive = |v: f64| v.is_finite() && v > 0.0;
        let refuse = |name, expected: &str, found: String| {
            Err(DatasetError::option(name, format!("expected {expected}, got {found}")))
        };
        if let Some(k) = self.intrinsics
            && !(k.iter().all(|v| v.is_finite()) && k[0] > 0.0 && k[1] > 0.0)
        {
            return refuse("intrinsics", "finite fx fy cx cy with fx, fy > 0", format!("{k:?}"));
        }
        if let Some(degrees) = self.field_of_view.filter(|&v| !(positive(v) && v < 180.0)) {
            let expected = "an angle above 0 and below 180 degrees";
            return refuse("field_of_view", expected, degrees.to_string());
        }
        if let Some(camera) = self.estimated_camera.filter(|camera| !camera.is_valid()) {
            let expected = "finite numbers with fx, fy > 0";
            return refuse("estimated_camera", expected, format!("{camera:?}"));
        }
        if let Some(scale) = self.depth_scale.filter(|&v| !positive(v)) {
            return refuse("depth_scale", "a positive number", scale.to_string());
        }
        if let Some(depth) = self.max_depth.filter(|&v| !positive(v)) {
            return refuse("max_depth", "a positive number of metres", depth.to_string());
        }
        if self.stride == 0 {
            return refuse("stride", "1 or more", "0".into());
        }
        if !(positive(self.scale) && self.scale <= 1.0) {
            return refuse("scale", "a number above 0, at most 1", self.scale.to_string());
        }
        if !positive(self.association_tolerance) {
            let found = self.association_tolerance.to_string();
            return refuse("association_tolerance", "a positive number of seconds", found);
        }
        if !(self.minimum_gap.is_finite() && self.minimum_gap >= 0.0) {
            let found = self.minimum_gap.to_string();
            return refuse("minimum_gap", "seconds, 0 or more", found);
        }
        Ok(())
    }
}

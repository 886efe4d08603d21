//! What to read of a sequence, and how.

use crate::{DatasetError, EstimatedCamera};
use std::ops::Range;
use std::path::PathBuf;

/// How a sequence is opened. Start from [`OpenOptions::default`].
#[derive(Clone, Debug, PartialEq)]
pub struct OpenOptions {
    /// A camera file to use instead of the folder's `camera.json`: another `camera.json`, a
    /// `transforms.json`, COLMAP's `cameras.txt` or `cameras.bin`, or a line `fx fy cx cy`.
    pub camera: Option<PathBuf>,
    /// `[fx, fy, cx, cy]` [px] of a camera without lens distortion, pixel centres at integers
    /// as in OpenCV and TUM. Goes before every camera file.
    pub intrinsics: Option<[f64; 4]>,
    /// Horizontal field of view of a camera without lens distortion, its principal point in the
    /// middle [degrees, above 0, below 180]. Goes behind `intrinsics` and `camera`, before what
    /// the sequence tells.
    pub field_of_view: Option<f64>,
    /// Camera and lens that were found in the pictures before. Goes before every other camera.
    pub estimated_camera: Option<EstimatedCamera>,
    /// Where nothing is known of the camera, take what the first picture's EXIF data tell, else a
    /// usual field of view ([`Sequence::camera_is_guess`](crate::Sequence::camera_is_guess)),
    /// instead of an error. Default false.
    pub guess_camera: bool,
    /// Depth image value of one metre. Goes before the camera file; 5000 if neither says.
    pub depth_scale: Option<f64>,
    /// Which frames, by their place in the associated stream. Default all.
    pub frames: Option<Range<usize>>,
    /// Every how many frames, counted from the start of `frames`; at least 1. Default 1.
    pub stride: usize,
    /// Size of the delivered frames over that of the cropped ones, in `(0, 1]`. Default 1.
    pub scale: f64,
    /// The longer side of delivered frames is at most this [px]; `scale` is made smaller if it
    /// must be. Default none.
    pub max_side: Option<usize>,
    /// Border removed on every side before scaling [px of the recorded colour image; of depth for
    /// ScanNet and 7-Scenes, which are delivered in the pixels of depth]. Default 0.
    pub crop_border: usize,
    /// Depth beyond this is taken as invalid [m]. Default none.
    pub max_depth: Option<f64>,
    /// A depth image (and, where the folder has ground truth, a pose) must be closer in time
    /// than this [s]. Default 0.08.
    pub association_tolerance: f64,
    /// Frames that follow the last kept one by no more than this are left out [s]; 0 keeps all.
    /// Default 1/32: the thinning of SplaTAM's TUM loader, on which published frame numbers
    /// rest. Frames without time stamps are not thinned.
    pub minimum_gap: f64,
    /// Only colour is wanted: sequences without depth images open too, and depth is never read
    /// ([`Frame::depth`](crate::Frame::depth) is 0 everywhere). Where there are lists or names of
    /// depth images they still decide which frames there are, so that a frame has the same number
    /// with and without depth. Default false.
    pub colour_only: bool,
    /// Pictures alone, which no depth and no pose lies beside, are shown as the EXIF data of the
    /// first one ask: turned or mirrored. Default false: as they are stored, with a warning.
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
            minimum_gap: 1.0 / 32.0,
            colour_only: false,
            turn_pictures: false,
        }
    }
}

impl OpenOptions {
    /// Refuses numbers outside their documented range.
    pub(crate) fn validate(&self) -> Result<(), DatasetError> {
        let positive = |v: f64| v.is_finite() && v > 0.0;
        let refuse = |name, expected: &str, found: String| {
            Err(DatasetError::Option { name, reason: format!("expected {expected}, got {found}") })
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
        if let Some(found) = self.wrong_estimate() {
            return refuse("estimated_camera", "finite numbers with fx, fy > 0", found);
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

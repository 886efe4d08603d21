//! Cameras: intrinsics, lens distortion, orientation, and EXIF hints about them.

mod calibration;
mod distortion;
mod exif_hints;
mod orientation;

pub use calibration::EstimatedCamera;
pub(crate) use calibration::{
    Calibration, DepthGrid, ESTIMATED_SOURCE, FormatDefaults, has_central_principal_point,
};
pub(crate) use distortion::Distortion;
pub(crate) use exif_hints::{ExifHints, FieldOfView};
pub(crate) use orientation::Orientation;

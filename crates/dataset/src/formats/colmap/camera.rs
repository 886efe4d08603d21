//! COLMAP's camera models: pinholes with Brown-Conrady distortion.

use super::ModelImage;
use crate::DatasetError;
use crate::camera::{Calibration, Distortion, FormatDefaults};
use std::collections::BTreeMap;
use std::path::Path;

/// Relative difference of parameters up to which cameras count as one.
const SAME_CAMERA_TOLERANCE: f64 = 1e-3;

/// Name, id in binary files, and number of parameters of every model (COLMAP 3.x,
/// `sensor/models.h`).
const MODELS: [(&str, i32, usize); 11] = [
    ("SIMPLE_PINHOLE", 0, 3),
    ("PINHOLE", 1, 4),
    ("SIMPLE_RADIAL", 2, 4),
    ("RADIAL", 3, 5),
    ("OPENCV", 4, 8),
    ("OPENCV_FISHEYE", 5, 8),
    ("FULL_OPENCV", 6, 12),
    ("FOV", 7, 5),
    ("SIMPLE_RADIAL_FISHEYE", 8, 4),
    ("RADIAL_FISHEYE", 9, 5),
    ("THIN_PRISM_FISHEYE", 10, 12),
];

/// A camera of the model.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct ModelCamera {
    /// Width and height [px].
    pub(crate) size: (usize, usize),
    /// `[fx, fy, cx, cy]` [px], pixel centres at one half.
    pub(crate) k: [f64; 4],
    pub(crate) lens: Distortion,
}

/// Name and number of parameters of a model by its id.
pub(super) fn model_by_id(number: i32) -> Result<(&'static str, usize), String> {
    let model = MODELS.iter().find(|model| model.1 == number);
    model.map(|model| (model.0, model.2)).ok_or_else(|| unsupported(&format!("number {number}")))
}

fn unsupported(model: &str) -> String {
    format!(
        "camera model {model} is not supported, expected SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, \
         RADIAL, OPENCV or FULL_OPENCV: undistort the images first (colmap image_undistorter)"
    )
}

impl ModelCamera {
    /// From a model's name and parameters; an error message if not supported.
    pub(super) fn new(name: &str, size: (usize, usize), p: &[f64]) -> Result<Self, String> {
        if let Some(&(_, _, count)) = MODELS.iter().find(|model| model.0 == name)
            && count != p.len()
        {
            return Err(format!("{} parameters of {name}, expected {count}", p.len()));
        }
        let (k, lens) = match (name, p) {
            ("SIMPLE_PINHOLE", &[f, cx, cy]) => ([f, f, cx, cy], vec![]),
            ("PINHOLE", &[fx, fy, cx, cy]) => ([fx, fy, cx, cy], vec![]),
            ("SIMPLE_RADIAL", &[f, cx, cy, k1]) => ([f, f, cx, cy], vec![k1, 0.0, 0.0, 0.0]),
            ("RADIAL", &[f, cx, cy, k1, k2]) => ([f, f, cx, cy], vec![k1, k2, 0.0, 0.0]),
            ("OPENCV" | "FULL_OPENCV", &[fx, fy, cx, cy, ref lens @ ..]) => {
                ([fx, fy, cx, cy], lens.to_vec())
            }
            _ => return Err(unsupported(name)),
        };
        let lens = Distortion::from_opencv(&lens);
        let usable = k.iter().all(|v| v.is_finite()) && k[0] > 0.0 && k[1] > 0.0;
        match lens.filter(|_| usable && size.0 > 1 && size.1 > 1) {
            Some(lens) => Ok(Self { size, k, lens }),
            None => Err(format!(
                "camera {p:?} of {}x{} px, expected finite numbers, a focal length above 0 and a \
                 size",
                size.0, size.1
            )),
        }
    }

    fn calibration(&self, file: &Path) -> Calibration {
        let source = file.display().to_string();
        let found = Calibration::from_opencv(self.k, self.lens, &source, FormatDefaults::TUM);
        Calibration { intrinsics: self.k, size: Some(self.size), ..found }
    }

    fn is_same_as(&self, other: &Self) -> bool {
        let numbers = |camera: &Self| {
            let lens = &camera.lens;
            let all = camera.k.iter().map(|v| v / camera.k[0]).chain([camera.k[0].ln()]);
            all.chain(lens.radial)
                .chain(lens.radial_denominator)
                .chain(lens.tangential)
                .collect::<Vec<f64>>()
        };
        let apart = numbers(self).into_iter().zip(numbers(other)).map(|(a, b)| (a - b).abs());
        self.size == other.size && apart.fold(0.0, f64::max) <= SAME_CAMERA_TOLERANCE
    }
}

/// Calibration of the camera that all images share; an error if they use different ones.
pub(crate) fn shared_camera(
    file: &Path,
    cameras: &BTreeMap<u32, ModelCamera>,
    images: &[ModelImage],
) -> Result<Calibration, DatasetError> {
    let refuse = |reason: String| DatasetError::file(file, reason);
    let mut first: Option<(u32, &ModelCamera)> = None;
    for image in images {
        let camera = cameras.get(&image.camera).ok_or_else(|| {
            refuse(format!("no camera {}, which image {} names", image.camera, image.name))
        })?;
        let (number, known) = *first.get_or_insert((image.camera, camera));
        if !known.is_same_as(camera) {
            return Err(refuse(format!(
                "cameras {number} and {} differ, expected one camera for all images: reconstruct \
                 with --ImageReader.single_camera 1",
                image.camera
            )));
        }
    }
    let Some((_, camera)) = first else {
        return Err(DatasetError::empty(&file.with_file_name("images"), "images with poses"));
    };
    Ok(camera.calibration(file))
}

/// Calibration of the only camera in a file.
pub(super) fn single_camera(
    file: &Path,
    cameras: &BTreeMap<u32, ModelCamera>,
) -> Result<Calibration, DatasetError> {
    let first = cameras.values().next();
    let first = first.ok_or_else(|| DatasetError::empty(file, "one camera"))?;
    if cameras.values().any(|camera| !camera.is_same_as(first)) {
        let reason = format!("it has {} cameras that differ, expected one", cameras.len());
        return Err(DatasetError::file(file, reason));
    }
    Ok(first.calibration(file))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lens(name: &str, parameters: &[f64]) -> Distortion {
        ModelCamera::new(name, (48, 32), parameters).expect("a camera").lens
    }

    #[test]
    fn lens_parameters_are_in_colmap_order() {
        let radial = Distortion { radial: [0.1, 0.0, 0.0], ..Distortion::default() };
        assert_eq!(lens("SIMPLE_RADIAL", &[40.0, 24.0, 16.0, 0.1]), radial);
        let radial = Distortion { radial: [0.1, 0.2, 0.0], ..Distortion::default() };
        assert_eq!(lens("RADIAL", &[40.0, 24.0, 16.0, 0.1, 0.2]), radial);
        let k = [40.0, 41.0, 24.0, 16.0];
        let opencv = Distortion { tangential: [0.3, 0.4], ..radial };
        assert_eq!(lens("OPENCV", &[&k[..], &[0.1, 0.2, 0.3, 0.4]].concat()), opencv);
        let full = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8];
        let due = Distortion {
            radial: [0.1, 0.2, 0.5],
            radial_denominator: [0.6, 0.7, 0.8],
            tangential: [0.3, 0.4],
        };
        assert_eq!(lens("FULL_OPENCV", &[&k[..], &full].concat()), due);
    }
}

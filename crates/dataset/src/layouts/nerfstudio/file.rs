//! `transforms.json` as it is written.

use crate::distortion::Distortion;
use serde::Deserialize;
use std::path::PathBuf;

/// Camera models that are pinholes with Brown-Conrady distortion or none.
const MODELS: [&str; 5] = ["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"];

/// The whole file; keys not listed here are for other readers.
#[derive(Deserialize)]
pub(super) struct SceneFile {
    camera_model: Option<String>,
    #[serde(flatten)]
    pub(super) intrinsics: Intrinsics,
    /// Metres of one unit of the depth images.
    pub(super) integer_depth_scale: Option<f64>,
    /// What positions were multiplied by when the file was written.
    pub(super) applied_scale: Option<f64>,
    pub(super) frames: Vec<Shot>,
}

/// One frame.
#[derive(Deserialize)]
pub(super) struct Shot {
    pub(super) file_path: PathBuf,
    pub(super) depth_file_path: Option<PathBuf>,
    /// `world_from_camera` in rows, camera axes as in OpenGL.
    pub(super) transform_matrix: Option<Vec<Vec<f64>>>,
    #[serde(flatten)]
    pub(super) intrinsics: Intrinsics,
}

/// The camera, for all frames or for one. Pixel centres at one half.
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct Intrinsics {
    fl_x: Option<f64>,
    fl_y: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    w: Option<f64>,
    h: Option<f64>,
    /// Horizontal field of view [rad].
    camera_angle_x: Option<f64>,
    k1: Option<f64>,
    k2: Option<f64>,
    k3: Option<f64>,
    k4: Option<f64>,
    p1: Option<f64>,
    p2: Option<f64>,
}

/// A camera without its lens.
pub(super) struct Pinhole {
    /// `[fx, fy, cx, cy]` [px], pixel centres at one half.
    pub(super) k: [f64; 4],
    /// Width and height [px], if they are given.
    pub(super) size: Option<(usize, usize)>,
}

impl Intrinsics {
    /// What is not said here is taken from `all`.
    pub(super) fn or(self, all: &Self) -> Self {
        Self {
            fl_x: self.fl_x.or(all.fl_x),
            fl_y: self.fl_y.or(all.fl_y),
            cx: self.cx.or(all.cx),
            cy: self.cy.or(all.cy),
            w: self.w.or(all.w),
            h: self.h.or(all.h),
            camera_angle_x: self.camera_angle_x.or(all.camera_angle_x),
            k1: self.k1.or(all.k1),
            k2: self.k2.or(all.k2),
            k3: self.k3.or(all.k3),
            k4: self.k4.or(all.k4),
            p1: self.p1.or(all.p1),
            p2: self.p2.or(all.p2),
        }
    }

    /// The pinhole camera; `w` and `h` may be missing.
    pub(super) fn pinhole(&self) -> Result<Pinhole, String> {
        let by_angle = self.camera_angle_x.zip(self.w).map(|(a, w)| 0.5 * w / (0.5 * a).tan());
        let fx = self.fl_x.or(by_angle).ok_or("no fl_x, and no camera_angle_x with w")?;
        let fy = self.fl_y.unwrap_or(fx);
        let cx = self.cx.or(self.w.map(|w| 0.5 * w)).ok_or("neither cx nor w")?;
        let cy = self.cy.or(self.h.map(|h| 0.5 * h)).ok_or("neither cy nor h")?;
        let k = [fx, fy, cx, cy];
        if !(k.iter().all(|v| v.is_finite()) && fx > 0.0 && fy > 0.0) {
            return Err(format!(
                "intrinsics {k:?}, expected finite numbers, fl_x and fl_y above 0"
            ));
        }
        let whole = |v: f64| (v >= 1.0 && v.fract() == 0.0 && v < 1e6).then_some(v as usize);
        let size = self.w.zip(self.h).map(|(w, h)| whole(w).zip(whole(h)).ok_or((w, h)));
        let size = size.transpose().map_err(|(w, h)| format!("w, h are {w}, {h}: no size"))?;
        Ok(Pinhole { k, size })
    }
}

impl SceneFile {
    pub(super) fn check(&self) -> Result<(), String> {
        for (name, value) in [
            ("integer_depth_scale", self.integer_depth_scale),
            ("applied_scale", self.applied_scale),
        ] {
            if let Some(value) = value.filter(|v| !(v.is_finite() && *v > 0.0)) {
                return Err(format!("{name} is {value}, expected a positive number"));
            }
        }
        match &self.camera_model {
            Some(model) if !MODELS.contains(&model.to_uppercase().as_str()) => {
                Err(format!("camera model '{model}' is not supported: expected OPENCV or PINHOLE"))
            }
            _ => Ok(()),
        }
    }

    /// The lens; nerfstudio's k4 belongs to r⁸, which OpenCV's model does not have.
    pub(super) fn distortion(&self, camera: &Intrinsics) -> Result<Distortion, String> {
        let of = |value: Option<f64>| value.unwrap_or(0.0);
        if of(camera.k4) != 0.0 {
            return Err("distortion k4 is not supported, expected k1 k2 p1 p2 k3".into());
        }
        let [k1, k2, k3] = [camera.k1, camera.k2, camera.k3].map(of);
        let lens = Distortion::from_opencv(&[k1, k2, of(camera.p1), of(camera.p2), k3]);
        lens.ok_or_else(|| "a distortion coefficient is not finite".into())
    }
}

//! nerfstudio and instant-ngp: `transforms.json`, with or without depth.

use super::file_pairing::{last_number, stamped_by_name};
use super::poses::pose_from_matrix;
use super::{FrameEntry, Layout, Listing};
use crate::camera::{Calibration, DepthGrid, Distortion, FormatDefaults};
use crate::text::{deserialize_json, is_present, read_text};
use crate::{DatasetError, DepthPairing, OpenOptions};
use i2slam_geometry::Pose;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Depth image value of one metre where the file does not say: millimetres.
const DEFAULT_DEPTH_SCALE: f64 = 1000.0;

/// Relative difference of focal lengths between frames above which a warning is given.
const SAME_INTRINSICS: f64 = 1e-3;

/// A `transforms.json` with its frames, in order of number or name.
pub(crate) struct TransformsFile {
    path: PathBuf,
    json: TransformsJson,
    records: Vec<FrameRecord>,
    /// Whether it was opened for its depth.
    with_depth: bool,
}

/// Path of the folder's `transforms.json`, if it has depth or cannot be read.
pub(super) fn find(folder: &Path) -> Option<PathBuf> {
    let path = folder.join("transforms.json");
    let has_depth = match read_text(&path) {
        Ok(text) => text.contains("depth_file_path"),
        Err(_) => is_present(&path),
    };
    has_depth.then_some(path)
}

/// Reason why a folder's `transforms.json` gives no frames with depth, if there is one.
pub(super) fn unused(folder: &Path) -> Option<String> {
    let path = folder.join("transforms.json");
    let opened = is_present(&path).then(|| TransformsFile::open(&path, true))?;
    opened.err().map(|error| error.to_string())
}

impl TransformsFile {
    /// Reads the file; `with_depth` demands a frame with `depth_file_path`.
    pub(crate) fn open(path: &Path, with_depth: bool) -> Result<Self, DatasetError> {
        let refuse = |reason: String| DatasetError::file(path, reason);
        let mut json: TransformsJson = deserialize_json(&read_text(path)?)
            .map_err(|e| refuse(format!("{e}; expected a transforms.json of nerfstudio")))?;
        json.check().map_err(refuse)?;
        let mut records = std::mem::take(&mut json.frames);
        let is_enough = |record: &FrameRecord| !with_depth || record.depth_file_path.is_some();
        if !records.iter().any(is_enough) {
            let expected = if with_depth { "frames with depth_file_path" } else { "frames" };
            return Err(DatasetError::empty(path, expected));
        }
        records.sort_by_cached_key(|record| {
            (
                last_number(&record.file_path.with_extension("").to_string_lossy()),
                record.file_path.clone(),
            )
        });
        Ok(Self { path: path.to_path_buf(), json, records, with_depth })
    }

    /// Whether any frame has depth.
    pub(crate) fn has_depth(&self) -> bool {
        self.records.iter().any(|record| record.depth_file_path.is_some())
    }

    pub(super) fn defaults(&self) -> FormatDefaults {
        let depth_scale = self.json.integer_depth_scale.map_or(DEFAULT_DEPTH_SCALE, f64::recip);
        FormatDefaults { depth_scale, grid: DepthGrid::ResizedToColour, ..FormatDefaults::TUM }
    }

    /// Calibration of the file, else of its first frame. Pixel centres at one half.
    pub(crate) fn calibration(&self) -> Result<Calibration, DatasetError> {
        let refuse = |reason: String| DatasetError::file(&self.path, reason);
        let intrinsics = self.intrinsics(&self.records[0]);
        let Pinhole { k, size } = intrinsics.pinhole().map_err(refuse)?;
        let distortion = self.json.distortion(&intrinsics).map_err(refuse)?;
        let source = self.path.display().to_string();
        let found = Calibration::from_opencv(k, distortion, &source, self.defaults());
        Ok(Calibration { intrinsics: k, size, ..found })
    }

    fn intrinsics(&self, record: &FrameRecord) -> Intrinsics {
        record.intrinsics.clone().or(&self.json.intrinsics)
    }

    /// Lists the frames at the time stamps in their names, else `index / frame_rate` [s].
    pub(super) fn list(
        &self,
        options: &OpenOptions,
        frame_rate: f64,
    ) -> Result<Listing, DatasetError> {
        let folder = self.path.parent().unwrap_or(Path::new("."));
        let drops = self.with_depth && options.depth_pairing == DepthPairing::Nearest;
        let is_kept = |record: &&FrameRecord| !drops || record.depth_file_path.is_some();
        let records: Vec<&FrameRecord> = self.records.iter().filter(is_kept).collect();
        let colour: Vec<PathBuf> =
            records.iter().map(|record| image_path(folder, &record.file_path)).collect();
        let times = stamped_by_name(&colour);
        let rising = times.filter(|t| t.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let entries = records.iter().zip(colour).enumerate().map(|(index, (record, colour))| {
            let timestamp = rising.as_ref().map_or(index as f64 / frame_rate, |t| t[index].0);
            let depth = record.depth_file_path.as_ref().map(|depth| folder.join(depth));
            FrameEntry::synchronous((index, index), timestamp, colour, depth)
        });
        let mut listing = Listing::new(Layout::Nerfstudio, entries.collect());
        listing.are_times_assumed = rising.is_none();
        listing.drop_without_depth(self.records.len() - records.len(), "no depth_file_path");
        listing.set_poses(|i, _| self.pose(records[i]));
        listing.warnings.extend(self.intrinsics_warning());
        Ok(listing)
    }

    /// Pose converted from OpenGL's camera axes (y up, z backwards) to OpenCV's; positions are
    /// divided by `applied_scale`, so that they have the unit of depth.
    fn pose(&self, record: &FrameRecord) -> Option<Pose<f64>> {
        let rows = record.transform_matrix.as_ref()?;
        let mut m = [0.0; 16];
        m[15] = 1.0;
        for (i, row) in rows.iter().take(3).enumerate() {
            let [x, y, z, t] = row[..] else { return None };
            let scale = self.json.applied_scale.unwrap_or(1.0);
            m[4 * i..4 * i + 4].copy_from_slice(&[x, -y, -z, t / scale]);
        }
        (rows.len() >= 3).then(|| pose_from_matrix(&m)).flatten()
    }

    /// A warning if focal lengths differ between frames.
    fn intrinsics_warning(&self) -> Option<String> {
        let focal =
            |record: &FrameRecord| self.intrinsics(record).pinhole().ok().map(|camera| camera.k[0]);
        let first = focal(&self.records[0])?;
        let apart = self.records.iter().filter_map(focal).map(|f| (f / first - 1.0).abs());
        let most = apart.fold(0.0, f64::max);
        (most > SAME_INTRINSICS).then(|| {
            format!(
                "the focal length changes by up to {:.1} % between frames: that of the first is \
                 taken for all",
                100.0 * most
            )
        })
    }
}

/// Path of an image; instant-ngp omits the extension of PNG files.
fn image_path(folder: &Path, name: &Path) -> PathBuf {
    let path = folder.join(name);
    if path.extension().is_none() && !path.is_file() { path.with_extension("png") } else { path }
}

/// Supported camera models: pinholes with Brown-Conrady distortion or none.
const CAMERA_MODELS: [&str; 5] = ["OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"];

/// Contents of `transforms.json`; unknown keys are ignored.
#[derive(Deserialize)]
struct TransformsJson {
    camera_model: Option<String>,
    #[serde(flatten)]
    pub(super) intrinsics: Intrinsics,
    /// Metres per unit of the depth images.
    pub(super) integer_depth_scale: Option<f64>,
    /// Factor that positions were multiplied by when the file was written.
    pub(super) applied_scale: Option<f64>,
    pub(super) frames: Vec<FrameRecord>,
}

/// One frame of the file.
#[derive(Deserialize)]
pub(super) struct FrameRecord {
    pub(super) file_path: PathBuf,
    pub(super) depth_file_path: Option<PathBuf>,
    /// Row-major `world_from_camera`, camera axes of OpenGL.
    pub(super) transform_matrix: Option<Vec<Vec<f64>>>,
    #[serde(flatten)]
    pub(super) intrinsics: Intrinsics,
}

/// Intrinsics and lens, of all frames or of one: numbers that may be missing.
macro_rules! intrinsics {
    ($($name:ident),+) => {
        /// Intrinsics and lens. Pixel centres at one half; `camera_angle_x` is the horizontal field
        /// of view [rad].
        #[derive(Clone, Debug, Default, Deserialize)]
        pub(super) struct Intrinsics { $($name: Option<f64>),+ }

        impl Intrinsics {
            /// Fills missing values from `all`.
            fn or(self, all: &Self) -> Self {
                Self { $($name: self.$name.or(all.$name)),+ }
            }
        }
    };
}
intrinsics!(fl_x, fl_y, cx, cy, w, h, camera_angle_x, k1, k2, k3, k4, p1, p2);

/// Intrinsics without the lens.
pub(super) struct Pinhole {
    /// `[fx, fy, cx, cy]` [px], pixel centres at one half.
    pub(super) k: [f64; 4],
    /// Width and height [px], if they are given.
    pub(super) size: Option<(usize, usize)>,
}

impl Intrinsics {
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

impl TransformsJson {
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
            Some(model) if !CAMERA_MODELS.contains(&model.to_uppercase().as_str()) => {
                Err(format!("camera model '{model}' is not supported: expected OPENCV or PINHOLE"))
            }
            _ => Ok(()),
        }
    }

    /// Lens distortion; nerfstudio's k4 multiplies r⁸, which OpenCV's model does not have.
    pub(super) fn distortion(&self, camera: &Intrinsics) -> Result<Distortion, String> {
        let or_zero = |value: Option<f64>| value.unwrap_or(0.0);
        if or_zero(camera.k4) != 0.0 {
            return Err("distortion k4 is not supported, expected k1 k2 p1 p2 k3".into());
        }
        let [k1, k2, k3] = [camera.k1, camera.k2, camera.k3].map(or_zero);
        let lens = Distortion::from_opencv(&[k1, k2, or_zero(camera.p1), or_zero(camera.p2), k3]);
        lens.ok_or_else(|| "a distortion coefficient is not finite".into())
    }
}

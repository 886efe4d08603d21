//! Camera files: `camera.json`, one line of numbers, and the files of other programs.

use super::colmap;
use super::nerfstudio::TransformsFile;
use crate::DatasetError;
use crate::camera::{Calibration, Distortion, FormatDefaults};
use crate::image::check_pixels;
use crate::text::{data_lines, deserialize_json, parse_number, read_text};
use i2slam_geometry::Camera;
use serde::Deserialize;
use serde::de::IgnoredAny;
use std::collections::BTreeMap;
use std::path::Path;

/// Names of the Brown-Conrady lens model.
const LENS_MODELS: [&str; 8] = [
    "brown_conrady",
    "brown-conrady",
    "brownconrady",
    "opencv",
    "plumb_bob",
    "radtan",
    "rational_polynomial",
    "none",
];

const EXPECTED_JSON: &str = "expected JSON with the numbers fx, fy, cx, cy, width, height";

/// Reads a camera file of any known kind: `camera.json`, nerfstudio's
/// `transforms.json`, COLMAP's `cameras.txt` or `cameras.bin`, or a line `fx fy cx cy`.
pub(crate) fn read_camera(
    path: &Path,
    defaults: FormatDefaults,
) -> Result<Calibration, DatasetError> {
    // COLMAP's cameras say nothing of depth.
    let of_colmap = || Ok(Calibration { format: defaults, ..colmap::read_camera(path)? });
    if path.extension().is_some_and(|ending| ending == "bin") {
        return of_colmap();
    }
    let text = read_text(path)?;
    if !text.trim_start().starts_with('{') {
        return match data_lines(&text).next().and_then(|(_, line)| line.split(' ').nth(1)) {
            Some(model) if model.starts_with(|c: char| c.is_ascii_uppercase()) => of_colmap(),
            _ => parse_line(path, &text, defaults),
        };
    }
    match serde_json::from_str::<serde_json::Value>(&text) {
        Ok(file) if file.get("frames").is_some() => {
            TransformsFile::open(path, false)?.calibration()
        }
        _ => parse_json(path, &text, defaults),
    }
}

/// `fx fy cx cy [k1 k2 p1 p2 [k3]]` [px] in one line, pixel centres at integers as in TUM's and
/// ETH3D's files.
fn parse_line(
    path: &Path,
    text: &str,
    defaults: FormatDefaults,
) -> Result<Calibration, DatasetError> {
    let expected = "a camera.json, a transforms.json, COLMAP's cameras.txt, or one line fx fy cx cy \
                    [k1 k2 p1 p2 [k3]]";
    let Some((line, content)) = data_lines(text).next() else {
        return Err(DatasetError::empty(path, expected));
    };
    let words = content.split([' ', '\t', ',']).filter(|word| !word.is_empty());
    let numbers: Result<Vec<f64>, _> =
        words.map(|word| parse_number(path, line, "intrinsics", word)).collect();
    let refuse = |reason: String| DatasetError::file(path, reason);
    let numbers = numbers.map_err(|error| refuse(format!("{error}; expected {expected}")))?;
    let (Some(&k), lens) = (numbers.first_chunk::<4>(), numbers.get(4..).unwrap_or_default())
    else {
        return Err(refuse(format!("{} numbers, expected {expected}", numbers.len())));
    };
    let lens = Distortion::from_opencv(lens);
    let lens =
        lens.ok_or_else(|| refuse(format!("{} numbers, expected {expected}", numbers.len())))?;
    if k[0] <= 0.0 || k[1] <= 0.0 {
        return Err(refuse("fx and fy must be positive".into()));
    }
    Ok(Calibration::from_opencv(k, lens, &path.display().to_string(), defaults))
}

fn parse_json(
    path: &Path,
    text: &str,
    defaults: FormatDefaults,
) -> Result<Calibration, DatasetError> {
    let refuse = |reason: String| DatasetError::file(path, reason);
    let file: CameraFile =
        deserialize_json(text).map_err(|e| refuse(format!("{e}; {EXPECTED_JSON}")))?;
    file.check(path)?;
    let keys: BTreeMap<String, IgnoredAny> = serde_json::from_str(text).unwrap_or_default();
    check_spelling(path, &keys)?;
    let expected = "distortion: expected 4, 5 or 8 numbers k1 k2 p1 p2 [k3 [k4 k5 k6]]";
    let distortion = Distortion::from_opencv(&file.distortion);
    let distortion = distortion.ok_or_else(|| refuse(expected.into()))?;
    // Pixel centres at integers, as the constructor expects them.
    let shift = file.pixel_centre();
    let depth_scale = file.depth_scale.unwrap_or(defaults.depth_scale);
    let format = FormatDefaults {
        depth_scale,
        is_scale_assumed: defaults.is_scale_assumed && file.depth_scale.is_none(),
        frame_rate: file.fps.or(defaults.frame_rate),
        ..defaults
    };
    let Some([fx, fy, cx, cy]) = file.intrinsics(path, &keys)? else {
        return Ok(Calibration::assumed(format));
    };
    let k = [fx, fy, cx - shift, cy - shift];
    let found = Calibration::from_opencv(k, distortion, &path.display().to_string(), format);
    Ok(Calibration { size: file.width.zip(file.height), ..found })
}

/// Keys of `camera.json`.
const KEYS: [&str; 12] = [
    "fx",
    "fy",
    "cx",
    "cy",
    "width",
    "height",
    "depth_scale",
    "fps",
    "distortion",
    "distortion_model",
    "pixel_centre",
    "convention",
];

/// Refuses a key that is a missing one but for its case, separators or `center`, and would be ignored.
fn check_spelling(path: &Path, found: &BTreeMap<String, IgnoredAny>) -> Result<(), DatasetError> {
    let plain = |key: &str| {
        let letters: String = key.chars().filter(char::is_ascii_alphanumeric).collect();
        letters.to_lowercase().replace("center", "centre")
    };
    for key in found.keys().filter(|key| !KEYS.contains(&key.as_str())) {
        let is_meant = |known: &&&str| !found.contains_key(**known) && plain(known) == plain(key);
        if let Some(known) = KEYS.iter().find(is_meant) {
            let reason = format!("unknown key '{key}': did you mean '{known}'?");
            return Err(DatasetError::file(path, reason));
        }
    }
    Ok(())
}

/// Contents of `camera.json`; unknown keys are ignored, unless they are [misspelt](check_spelling).
#[derive(Deserialize)]
struct CameraFile {
    fx: Option<f64>,
    fy: Option<f64>,
    cx: Option<f64>,
    cy: Option<f64>,
    width: Option<usize>,
    height: Option<usize>,
    depth_scale: Option<f64>,
    fps: Option<f64>,
    #[serde(default)]
    distortion: Vec<f64>,
    distortion_model: Option<String>,
    pixel_centre: Option<f64>,
    #[serde(default)]
    convention: serde_json::Value,
}

impl CameraFile {
    /// Centre coordinate of pixel (0, 0): 0.5 where the file says so, else 0 as in OpenCV.
    fn pixel_centre(&self) -> f64 {
        self.pixel_centre.unwrap_or_else(|| {
            let words = self.convention.get("pixel_centres").and_then(|v| v.as_str());
            if words.is_some_and(|w| w.contains("0.5")) { 0.5 } else { 0.0 }
        })
    }

    /// `fx fy cx cy` [px]; `None` where the file has a frame rate, depth scale or size alone.
    fn intrinsics(
        &self,
        path: &Path,
        keys: &BTreeMap<String, IgnoredAny>,
    ) -> Result<Option<[f64; 4]>, DatasetError> {
        let of_no_camera = ["fps", "depth_scale", "width", "height", "pixel_centre"];
        if !keys.is_empty() && keys.keys().all(|key| of_no_camera.contains(&key.as_str())) {
            return Ok(None);
        }
        let named = [("fx", self.fx), ("fy", self.fy), ("cx", self.cx), ("cy", self.cy)];
        if let Some((missing, _)) = named.iter().find(|(_, value)| value.is_none()) {
            let reason = format!("missing field `{missing}`; {EXPECTED_JSON}");
            return Err(DatasetError::file(path, reason));
        }
        Ok(Some(named.map(|(_, value)| value.unwrap_or_default())))
    }

    fn check(&self, path: &Path) -> Result<(), DatasetError> {
        let refuse = |reason: String| Err(DatasetError::file(path, reason));
        for (name, value) in
            [("fx", self.fx), ("fy", self.fy), ("depth_scale", self.depth_scale), ("fps", self.fps)]
        {
            if let Some(value) = value.filter(|&v| !(v.is_finite() && v > 0.0)) {
                return refuse(format!("{name} is {value}, expected a positive number"));
            }
        }
        if let Some(size) = self.width.zip(self.height) {
            check_pixels(path, size)?;
        }
        if self.width.is_some() != self.height.is_some() {
            return refuse("expected both width and height, found one".into());
        }
        if let Some(centre) = self.pixel_centre.filter(|&c| c != 0.0 && c != 0.5) {
            return refuse(format!("pixel_centre is {centre}, expected 0 or 0.5"));
        }
        if let Some(model) = &self.distortion_model
            && !LENS_MODELS.contains(&model.to_lowercase().as_str())
        {
            return refuse(format!(
                "lens model '{model}' is not supported: expected Brown-Conrady (plumb_bob)"
            ));
        }
        Ok(())
    }
}

/// The `camera.json` of an undistorted sequence.
///
/// `depth_scale` is the depth image value of one metre, `frame_rate` in frames a second.
pub fn camera_json(camera: &Camera<f64>, depth_scale: f64, frame_rate: f64) -> String {
    let &Camera { width, height, fx, fy, cx, cy } = camera;
    format!(
        "{{\n  \"width\": {width},\n  \"height\": {height},\n  \"fx\": {fx},\n  \"fy\": {fy},\n  \
         \"cx\": {cx},\n  \"cy\": {cy},\n  \"pixel_centre\": 0.5,\n  \
         \"distortion\": [0, 0, 0, 0, 0],\n  \"depth_scale\": {depth_scale},\n  \
         \"fps\": {frame_rate}\n}}\n"
    )
}

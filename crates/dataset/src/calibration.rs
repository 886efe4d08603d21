//! Intrinsics, lens and depth scale: from flags, from `camera.json`, or known by name.

use crate::distortion::Distortion;
use crate::layouts::Source;
use crate::lists::read_text;
use crate::{DatasetError, OpenOptions};
use i2slam_geometry::Camera;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Depth image value of one metre where nothing else is said (TUM RGB-D).
const DEFAULT_DEPTH_SCALE: f64 = 5000.0;

/// The lens models that are Brown-Conrady under some name.
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

/// How the pixels of depth lie to those of colour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum DepthGrid {
    /// Depth has the pixels of colour.
    Colour,
    /// Depth sees what colour sees, in a size of its own; frames are delivered in colour's size.
    Spread,
    /// Frames are delivered in the pixels of depth. Its camera `[fx, fy, cx, cy]` [px] stands
    /// where colour's does; without one it is colour's, resized.
    Depth(Option<[f64; 4]>),
}

/// What a layout says of all its sequences.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Traits {
    /// Depth image value of one metre.
    pub(crate) depth_scale: f64,
    /// Frames a second.
    pub(crate) frame_rate: Option<f64>,
    /// How depth lies to colour.
    pub(crate) grid: DepthGrid,
    /// A depth image value beside 0 that means "no reading".
    pub(crate) invalid_depth: Option<u16>,
}

impl Default for Traits {
    fn default() -> Self {
        let (depth_scale, grid) = (DEFAULT_DEPTH_SCALE, DepthGrid::Colour);
        Self { depth_scale, frame_rate: None, grid, invalid_depth: None }
    }
}

impl Traits {
    /// The same for another colour camera, of which depth has no camera of its own.
    pub(crate) fn for_another_camera(self) -> Self {
        let grid = match self.grid {
            DepthGrid::Depth(_) => DepthGrid::Depth(None),
            other => other,
        };
        Self { grid, ..self }
    }
}

/// What is known of the recording camera.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Calibration {
    /// `[fx, fy, cx, cy]` of the colour camera [px], pixel centres at integers plus one half.
    pub(crate) intrinsics: [f64; 4],
    /// The lens.
    pub(crate) distortion: Distortion,
    /// Width and height of colour [px], where the source says.
    pub(crate) size: Option<(usize, usize)>,
    /// Depth image value of one metre.
    pub(crate) depth_scale: f64,
    /// Frames a second, where the source says.
    pub(crate) frame_rate: Option<f64>,
    /// How depth lies to colour.
    pub(crate) grid: DepthGrid,
    /// A depth image value beside 0 that means "no reading".
    pub(crate) invalid_depth: Option<u16>,
    /// The file or name the calibration comes from, in words.
    pub(crate) source: String,
}

impl Calibration {
    /// Flags go first, then the named file, then the folder's `camera.json`, then what the layout
    /// has of its own, then the folder's name.
    pub(crate) fn find(
        folder: &Path,
        source: &Source,
        options: &OpenOptions,
    ) -> Result<Self, DatasetError> {
        let beside = folder.join("camera.json");
        let traits = source.traits().for_another_camera();
        let mut found = match (&options.intrinsics, &options.camera) {
            (Some(k), _) => {
                Self::from_opencv(*k, Distortion::default(), "the given intrinsics", traits)
            }
            (None, Some(path)) => Self::from_file(path, traits)?,
            (None, None) if beside.is_file() => Self::from_file(&beside, traits)?,
            (None, None) => source
                .calibration()?
                .or_else(|| Self::known(folder))
                .ok_or_else(|| DatasetError::NoCamera { folder: folder.to_path_buf() })?,
        };
        if let Some(scale) = options.depth_scale {
            found.depth_scale = scale;
        }
        Ok(found)
    }

    /// From numbers for pixel centres at integers.
    pub(crate) fn from_opencv(
        k: [f64; 4],
        distortion: Distortion,
        source: &str,
        traits: Traits,
    ) -> Self {
        Self {
            intrinsics: [k[0], k[1], k[2] + 0.5, k[3] + 0.5],
            distortion,
            size: None,
            depth_scale: traits.depth_scale,
            frame_rate: traits.frame_rate,
            grid: traits.grid,
            invalid_depth: traits.invalid_depth,
            source: source.to_owned(),
        }
    }

    /// The published calibration of a TUM RGB-D sequence (colour camera; depth is registered to
    /// it), known by the name of the folder or of the one above it.
    fn known(folder: &Path) -> Option<Self> {
        let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_path_buf());
        let number = [Some(whole.as_path()), whole.parent()]
            .into_iter()
            .flatten()
            .filter_map(|p| p.file_name()?.to_str().map(str::to_lowercase))
            .find_map(|name| freiburg_number(&name))?;
        let (k, lens): ([f64; 4], [f64; 5]) = match number {
            1 => ([517.3, 516.5, 318.6, 255.3], [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
            2 => ([520.9, 521.0, 325.1, 249.7], [0.2312, -0.7849, -0.0033, -0.0001, 0.9172]),
            _ => ([535.4, 539.2, 320.1, 247.6], [0.0; 5]),
        };
        let lens = Distortion::from_opencv(&lens)?;
        let source = format!("the calibration of freiburg{number}");
        let found = Self::from_opencv(k, lens, &source, Traits::default());
        Some(Self { size: Some((640, 480)), frame_rate: Some(30.0), ..found })
    }

    fn from_file(path: &Path, traits: Traits) -> Result<Self, DatasetError> {
        let file: CameraFile = serde_json::from_str(&read_text(path)?).map_err(|e| {
            DatasetError::camera(
                path,
                format!("{e}; expected JSON with the numbers fx, fy, cx, cy, width, height"),
            )
        })?;
        file.check(path)?;
        let distortion = Distortion::from_opencv(&file.distortion).ok_or_else(|| {
            DatasetError::camera(
                path,
                "distortion: expected 4, 5 or 8 numbers k1 k2 p1 p2 [k3 [k4 k5 k6]]",
            )
        })?;
        let shift = 0.5 - file.pixel_centre();
        Ok(Self {
            intrinsics: [file.fx, file.fy, file.cx + shift, file.cy + shift],
            distortion,
            size: file.width.zip(file.height),
            depth_scale: file.depth_scale.unwrap_or(traits.depth_scale),
            frame_rate: file.fps.or(traits.frame_rate),
            grid: traits.grid,
            invalid_depth: traits.invalid_depth,
            source: path.display().to_string(),
        })
    }
}

/// The room number in `...freiburg2...` or in `fr2` standing alone.
fn freiburg_number(name: &str) -> Option<u32> {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric());
    words
        .filter_map(|word| word.strip_prefix("freiburg").or_else(|| word.strip_prefix("fr")))
        .find_map(|rest| match rest {
            "1" => Some(1),
            "2" => Some(2),
            "3" => Some(3),
            _ => None,
        })
}

/// `camera.json` as it is written; keys not listed here are for other readers.
#[derive(Deserialize)]
struct CameraFile {
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
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
    /// Where pixel (0, 0) has its centre: 0.5 where the file says so, else 0 as in OpenCV.
    fn pixel_centre(&self) -> f64 {
        self.pixel_centre.unwrap_or_else(|| {
            let words = self.convention.get("pixel_centres").and_then(|v| v.as_str());
            if words.is_some_and(|w| w.contains("0.5")) { 0.5 } else { 0.0 }
        })
    }

    fn check(&self, path: &Path) -> Result<(), DatasetError> {
        let refuse = |reason: String| Err(DatasetError::camera(path, reason));
        for (name, value) in [
            ("fx", Some(self.fx)),
            ("fy", Some(self.fy)),
            ("depth_scale", self.depth_scale),
            ("fps", self.fps),
        ] {
            if let Some(value) = value.filter(|&v| !(v.is_finite() && v > 0.0)) {
                return refuse(format!("{name} is {value}, expected a positive number"));
            }
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

/// Writes the `camera.json` of an undistorted sequence.
///
/// `depth_scale` is the depth image value of one metre, `frame_rate` in frames a second.
pub fn write_camera(
    path: impl Into<PathBuf>,
    camera: &Camera<f64>,
    depth_scale: f64,
    frame_rate: f64,
) -> Result<(), DatasetError> {
    let path = path.into();
    let numbers = [camera.fx, camera.fy, camera.cx, camera.cy, depth_scale, frame_rate];
    if numbers.iter().any(|v| !v.is_finite()) {
        return Err(DatasetError::camera(&path, "a number to be written is not finite"));
    }
    let [fx, fy, cx, cy, depth_scale, frame_rate] = numbers;
    let (width, height) = (camera.width, camera.height);
    let text = format!(
        "{{\n  \"width\": {width},\n  \"height\": {height},\n  \"fx\": {fx},\n  \"fy\": {fy},\n  \
         \"cx\": {cx},\n  \"cy\": {cy},\n  \"pixel_centre\": 0.5,\n  \
         \"distortion\": [0, 0, 0, 0, 0],\n  \"depth_scale\": {depth_scale},\n  \
         \"fps\": {frame_rate}\n}}\n"
    );
    std::fs::write(&path, text).map_err(|e| DatasetError::write(&path, e))
}

#[cfg(test)]
mod tests {
    use super::freiburg_number;

    #[test]
    fn rooms_are_known_by_name() {
        assert_eq!(freiburg_number("rgbd_dataset_freiburg1_desk"), Some(1));
        assert_eq!(freiburg_number("tum_fr2_xyz"), Some(2));
        assert_eq!(freiburg_number("fr3"), Some(3));
        assert_eq!(freiburg_number("fr4"), None);
        assert_eq!(freiburg_number("fr12"), None);
        assert_eq!(freiburg_number("offr1"), None);
    }
}

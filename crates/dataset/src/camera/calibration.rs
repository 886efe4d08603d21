//! Intrinsics, lens and depth scale: from flags, from `camera.json`, or known by name.

use crate::camera_file::read_camera;
use crate::distortion::Distortion;
use crate::estimated::ESTIMATED;
use crate::guess::{FieldOfView, Told};
use crate::layouts::Source;
use crate::{DatasetError, EstimatedCamera, OpenOptions};
use i2slam_geometry::Camera;
use std::path::{Path, PathBuf};

/// Depth image value of one metre where nothing else is said (TUM RGB-D).
const DEFAULT_DEPTH_SCALE: f64 = 5000.0;

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
    /// `[fx, fy, cx, cy]` of the colour camera [px], pixel centres at integers plus one half. Do
    /// not count where there is a `field_of_view`.
    pub(crate) intrinsics: [f64; 4],
    /// An angle of view in place of intrinsics in pixels.
    pub(crate) field_of_view: Option<FieldOfView>,
    /// Whether nobody gave the camera.
    pub(crate) is_guess: bool,
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
        let mut found = if let Some(k) = options.intrinsics {
            Self::from_opencv(k, Distortion::default(), "the given intrinsics", traits)
        } else if let Some(path) = &options.camera {
            read_camera(path, traits)?
        } else if let Some(degrees) = options.field_of_view {
            let view = FieldOfView::Width(degrees);
            Self::from_view(view, format!("the given field of view of {degrees} degrees"), traits)
        } else if source.is_video() {
            // What lies in the folder of a video need not belong to it.
            Self::guessed(folder, options, traits)?
        } else if beside.is_file() {
            read_camera(&beside, traits)?
        } else {
            match source.calibration()?.or_else(|| Self::known(folder)) {
                Some(found) => found,
                None => Self::guessed(folder, options, traits)?,
            }
        };
        if let Some(scale) = options.depth_scale {
            found.depth_scale = scale;
        }
        if let Some(camera) = &options.estimated_camera {
            found = found.replaced_by(camera);
        }
        Ok(found)
    }

    /// The same with a camera that the pictures told.
    fn replaced_by(self, camera: &EstimatedCamera) -> Self {
        let [fx, fy, cx, cy] = camera.intrinsics;
        Self {
            intrinsics: [fx, fy, cx + 0.5, cy + 0.5],
            field_of_view: None,
            is_guess: false,
            distortion: camera.lens(),
            size: None,
            source: ESTIMATED.to_owned(),
            ..self
        }
    }

    /// What is taken where nothing is known, if that is allowed.
    fn guessed(folder: &Path, options: &OpenOptions, traits: Traits) -> Result<Self, DatasetError> {
        if !options.guess_camera {
            return Err(DatasetError::NoCamera { folder: folder.to_path_buf() });
        }
        let view = FieldOfView::USUAL;
        Ok(Self { is_guess: true, ..Self::from_view(view, format!("a guess, {view}"), traits) })
    }

    /// A camera without distortion, the principal point in the middle of the picture.
    pub(crate) fn from_view(view: FieldOfView, source: String, traits: Traits) -> Self {
        let found = Self::from_opencv([0.0; 4], Distortion::default(), &source, traits);
        Self { field_of_view: Some(view), ..found }
    }

    /// A guess made better by what the first picture says of the camera that took it.
    pub(crate) fn asking(self, picture: Option<&Path>) -> Self {
        let said = picture.filter(|_| self.is_guess).and_then(|picture| Told::by(picture).view);
        match said {
            Some(view) => {
                let source = format!("the EXIF data of the first picture, {view}");
                Self { field_of_view: Some(view), source, ..self }
            }
            None => self,
        }
    }

    /// The colour camera of pictures of a size [px].
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

    /// From numbers for pixel centres at integers.
    pub(crate) fn from_opencv(
        k: [f64; 4],
        distortion: Distortion,
        source: &str,
        traits: Traits,
    ) -> Self {
        Self {
            intrinsics: [k[0], k[1], k[2] + 0.5, k[3] + 0.5],
            field_of_view: None,
            is_guess: false,
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

//! Field of view and orientation from EXIF data.

use super::Orientation;
use exif::{Exif, In, Reader, Tag, Value};
use std::fmt;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Diagonal of a 35 mm film frame, 36x24 mm [mm].
const FILM_DIAGONAL: f64 = 43.266_615;

/// Plausible 35 mm equivalent focal lengths [mm]: from fisheye to telescope.
const PLAUSIBLE_FOCAL: std::ops::RangeInclusive<f64> = 5.0..=2000.0;

/// Field of view of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum FieldOfView {
    /// Across the image width [degrees].
    Width(f64),
    /// Across the longer image side [degrees].
    LongerSide(f64),
    /// 35 mm equivalent focal length, by the diagonal [mm].
    FilmEquivalent(f64),
}

impl FieldOfView {
    /// Assumed where nothing is known: roughly that of phone main cameras and webcams.
    pub(crate) const ASSUMED: Self = Self::LongerSide(60.0);

    /// Focal length for images of a size [px].
    pub(crate) fn focal_length(self, width: usize, height: usize) -> f64 {
        let (width, height) = (width as f64, height as f64);
        let of = |degrees: f64, side: f64| 0.5 * side / (0.5 * degrees.to_radians()).tan();
        match self {
            Self::Width(degrees) => of(degrees, width),
            Self::LongerSide(degrees) => of(degrees, width.max(height)),
            Self::FilmEquivalent(millimetres) => millimetres / FILM_DIAGONAL * width.hypot(height),
        }
    }

    /// 35 mm equivalent focal length, given directly or computed from the sensor's size.
    fn from_exif(exif: &Exif) -> Option<Self> {
        let direct =
            number(exif, Tag::FocalLengthIn35mmFilm).filter(|f| PLAUSIBLE_FOCAL.contains(f));
        let found =
            direct.or_else(|| focal_from_sensor(exif)).filter(|f| PLAUSIBLE_FOCAL.contains(f));
        found.map(Self::FilmEquivalent)
    }
}

impl fmt::Display for FieldOfView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Width(degrees) => write!(f, "{degrees} degrees across the width"),
            Self::LongerSide(degrees) => write!(f, "{degrees} degrees across the longer side"),
            Self::FilmEquivalent(millimetres) => write!(f, "as {millimetres:.0} mm on 35 mm film"),
        }
    }
}

/// Largest file that is searched for EXIF data [bytes].
const MAX_FILE_BYTES: u64 = 1 << 30;

fn read_exif(path: &Path) -> Option<Exif> {
    let file = i2slam_storage::open(path).ok()?;
    if file.metadata().ok()?.len() > MAX_FILE_BYTES {
        return None;
    }
    let mut file = BufReader::new(file);
    // Files of other kinds, which are no pictures of a sequence, would be read as a whole.
    if !matches!(file.fill_buf().ok()?, [0x89, b'P', b'N', b'G', ..] | [0xff, 0xd8, ..]) {
        return None;
    }
    Reader::new().read_from_container(&mut file).ok()
}

/// Camera hints in the EXIF data of an image.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct ExifHints {
    /// Orientation in which the image is to be shown.
    pub(crate) orientation: Option<Orientation>,
    /// Field of view.
    pub(crate) view: Option<FieldOfView>,
}

impl ExifHints {
    /// Reads the hints of a file; empty if it has no EXIF data.
    pub(crate) fn read(path: &Path) -> Self {
        let Some(exif) = read_exif(path) else { return Self::default() };
        let tag = number(&exif, Tag::Orientation);
        let orientation = tag.and_then(|tag| Orientation::from_exif(tag as u32));
        Self { orientation, view: FieldOfView::from_exif(&exif) }
    }
}

/// 35 mm equivalent focal length [mm] from focal length, image size and sensor resolution.
fn focal_from_sensor(exif: &Exif) -> Option<f64> {
    let focal = number(exif, Tag::FocalLength)?;
    let unit = match number(exif, Tag::FocalPlaneResolutionUnit).unwrap_or(2.0) as u32 {
        2 => 25.4,
        3 => 10.0,
        4 => 1.0,
        5 => 1e-3,
        _ => return None,
    };
    let side = |pixels: Tag, density: Tag| {
        let side = unit * number(exif, pixels)? / number(exif, density)?;
        (side.is_finite() && side > 0.0).then_some(side)
    };
    let width = side(Tag::PixelXDimension, Tag::FocalPlaneXResolution)?;
    let height = side(Tag::PixelYDimension, Tag::FocalPlaneYResolution)?;
    Some(focal * FILM_DIAGONAL / width.hypot(height))
}

fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    let value = &exif.get_field(tag, In::PRIMARY)?.value;
    match value {
        Value::Rational(parts) => parts.first().map(|part| part.to_f64()),
        other => other.get_uint(0).map(f64::from),
    }
    .filter(|v| v.is_finite())
}

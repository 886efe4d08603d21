//! A camera that is known by its angle of view alone: given, told by a picture, or guessed.

use crate::orientation::Orientation;
use exif::{Exif, In, Reader, Tag, Value};
use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

/// Diagonal of a picture on 35 mm film, 36x24 mm [mm].
const FILM_DIAGONAL: f64 = 43.266_615;

/// Equivalent focal lengths that can be true [mm]: from a fisheye to a telescope.
const SENSIBLE: std::ops::RangeInclusive<f64> = 5.0..=2000.0;

/// How much a camera sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum FieldOfView {
    /// Across the width of the picture [degrees].
    Width(f64),
    /// Across the longer side of the picture [degrees].
    LongerSide(f64),
    /// The focal length that sees as much on 35 mm film, across the diagonal [mm].
    Film(f64),
}

impl FieldOfView {
    /// What the main camera of a telephone or a webcam sees, roughly.
    pub(crate) const USUAL: Self = Self::LongerSide(60.0);

    /// Focal length for pictures of a size [px].
    pub(crate) fn focal_length(self, width: usize, height: usize) -> f64 {
        let (width, height) = (width as f64, height as f64);
        let of = |degrees: f64, side: f64| 0.5 * side / (0.5 * degrees.to_radians()).tan();
        match self {
            Self::Width(degrees) => of(degrees, width),
            Self::LongerSide(degrees) => of(degrees, width.max(height)),
            Self::Film(millimetres) => millimetres / FILM_DIAGONAL * width.hypot(height),
        }
    }

    /// What EXIF data tell of the lens and the sensor.
    fn of_exif(exif: &Exif) -> Option<Self> {
        let direct = number(exif, Tag::FocalLengthIn35mmFilm).filter(|f| SENSIBLE.contains(f));
        let found = direct.or_else(|| of_sensor(exif)).filter(|f| SENSIBLE.contains(f));
        found.map(Self::Film)
    }
}

impl fmt::Display for FieldOfView {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Width(degrees) => write!(f, "{degrees} degrees across the width"),
            Self::LongerSide(degrees) => write!(f, "{degrees} degrees across the longer side"),
            Self::Film(millimetres) => write!(f, "as {millimetres:.0} mm on 35 mm film"),
        }
    }
}

fn exif(path: &Path) -> Option<Exif> {
    let mut file = BufReader::new(File::open(path).ok()?);
    Reader::new().read_from_container(&mut file).ok()
}

/// What the EXIF data of a picture tell.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Told {
    /// How the picture is to be shown.
    pub(crate) orientation: Option<Orientation>,
    /// How much it sees.
    pub(crate) view: Option<FieldOfView>,
}

impl Told {
    /// What those of one file tell; nothing where it has none.
    pub(crate) fn by(path: &Path) -> Self {
        let Some(exif) = exif(path) else { return Self::default() };
        let asked = number(&exif, Tag::Orientation);
        let orientation = asked.and_then(|asked| Orientation::of_exif(asked as u32));
        Self { orientation, view: FieldOfView::of_exif(&exif) }
    }
}

/// What was made of that, in words.
pub(crate) fn orientation_note(path: &Path, asked: Orientation, is_done: bool) -> String {
    let (path, how) = (path.display(), asked.words());
    if is_done {
        return format!("pictures are {how}, as the EXIF data of {path} ask");
    }
    format!(
        "EXIF data ask that {path} be {how}: what lies beside such pictures (depth, poses, a list) is \
         of pictures as they are stored, and so are they taken; `mogrify -auto-orient` \
         (ImageMagick) turns them for good"
    )
}

/// The equivalent focal length [mm] by focal length and pixels a unit of length on the sensor.
fn of_sensor(exif: &Exif) -> Option<f64> {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn angles_become_focal_lengths() {
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-3 * b, "{a} {b}");
        close(FieldOfView::Width(90.0).focal_length(640, 480), 320.0);
        close(FieldOfView::LongerSide(90.0).focal_length(480, 640), 320.0);
        close(FieldOfView::Film(FILM_DIAGONAL).focal_length(640, 480), 800.0);
        close(FieldOfView::USUAL.focal_length(320, 240), 277.1);
    }
}

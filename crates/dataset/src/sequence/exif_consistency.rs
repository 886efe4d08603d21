//! Whether pictures that lie together were taken with one lens, by their EXIF data.

use crate::guess::{FieldOfView, Told};
use crate::layouts::counted;
use crate::orientation::Orientation;
use crate::{DatasetError, Entry};
use std::path::Path;

/// Focal lengths that differ by this share are those of two lenses, or of one that zooms.
const SAME_LENS: f64 = 0.01;

/// A warning if EXIF data ask for some pictures to be turned otherwise than the first: all are
/// shown alike, because a sensor does not turn in its camera.
///
/// # Errors
///
/// A picture of another focal length than the first that tells one, or one that is mirrored where
/// the first is not: no single camera sees both.
pub(crate) fn check_alike(
    entries: &[Entry],
    shown: Orientation,
) -> Result<Option<String>, DatasetError> {
    let Some(first) = entries.first().map(|entry| entry.colour.as_path()) else { return Ok(None) };
    let of_first = Told::by(first);
    let reads_all = of_first != Told::default();
    let may_tell = |path: &&Path| reads_all || is_jpeg(path);
    let asked_first = of_first.orientation.unwrap_or_default();
    let mut lens = of_first.view.map(|view| (first, view));
    let mut turned: Vec<(&Path, Orientation)> = Vec::new();
    for path in entries.iter().skip(1).map(|entry| entry.colour.as_path()).filter(may_tell) {
        let told = Told::by(path);
        if let Some(view) = told.view {
            let (known, expected) = *lens.get_or_insert((path, view));
            if !is_same_lens(view, expected) {
                let reason = format!(
                    "it was taken {view}, that one {expected}; keep the pictures of one focal length, \
                     or reconstruct each alone"
                );
                return Err(other_camera(path, known, reason));
            }
        }
        let Some(asked) = told.orientation.filter(|asked| *asked != asked_first) else { continue };
        if asked.is_mirrored() != asked_first.is_mirrored() {
            let ways = (asked.words(), asked_first.words());
            let reason = format!(
                "EXIF data ask that it be {}, and that one be {}; `mogrify -auto-orient` \
                 (ImageMagick) makes mirrored pictures those of a camera",
                ways.0, ways.1
            );
            return Err(other_camera(path, first, reason));
        }
        turned.push((path, asked));
    }
    let Some((path, asked)) = turned.first() else { return Ok(None) };
    Ok(Some(format!(
        "EXIF data ask that {} be shown otherwise than {}, the first of them, {}, {}: all are {} \
         alike, because a sensor does not turn in its camera; if some were turned before they were stored, \
         `mogrify -auto-orient` (ImageMagick) turns the others, too",
        counted(turned.len(), "picture"),
        first.display(),
        path.display(),
        asked.words(),
        shown.words(),
    )))
}

/// PNG files may keep EXIF data behind everything else, so that all of a file would be read.
fn is_jpeg(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    ["jpg", "jpeg"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}

/// Whether two pictures of one size have the same focal length.
fn is_same_lens(view: FieldOfView, other: FieldOfView) -> bool {
    let ratio = view.focal_length(3, 4) / other.focal_length(3, 4);
    (ratio - 1.0).abs() <= SAME_LENS
}

fn other_camera(path: &Path, first: &Path, reason: String) -> DatasetError {
    DatasetError::OtherCamera { path: path.to_path_buf(), first: first.to_path_buf(), reason }
}

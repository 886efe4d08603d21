//! EXIF data of a folder of images: orientation of the first, consistency of all.

use crate::DatasetError;
use crate::camera::{ExifHints, FieldOfView, Orientation};
use crate::formats::FrameEntry;
use crate::text::counted;
use std::path::Path;

/// Relative difference of focal lengths up to which images count as taken with one lens.
const SAME_LENS_TOLERANCE: f64 = 0.01;

/// Checks that one camera took all images; `shown` is the orientation applied to all. Returns a
/// warning if some ask for another rotation than the first, which is ignored: rotating the camera
/// does not change where a ray falls on the sensor.
///
/// # Errors
///
/// Images of another focal length than the first that has one, and mirrored ones beside others.
pub(crate) fn check_exif_consistency(
    entries: &[FrameEntry],
    shown: Orientation,
) -> Result<Option<String>, DatasetError> {
    let Some(first) = entries.first().map(|entry| entry.colour.as_path()) else { return Ok(None) };
    let first_hints = ExifHints::read(first);
    // Without hints in the first image only JPEG files are read, see `is_jpeg`.
    let reads_all = first_hints != ExifHints::default();
    let may_have_exif = |path: &&Path| reads_all || is_jpeg(path);
    let first_orientation = first_hints.orientation.unwrap_or_default();
    let mut lens = first_hints.view.map(|view| (first, view));
    let mut rotated: Vec<(&Path, Orientation)> = Vec::new();
    for path in entries.iter().skip(1).map(|entry| entry.colour.as_path()).filter(may_have_exif) {
        let hints = ExifHints::read(path);
        if let Some(view) = hints.view {
            let (known, expected) = *lens.get_or_insert((path, view));
            if !is_same_lens(view, expected) {
                let reason = format!(
                    "it was taken {view}, that one {expected}; keep the pictures of one focal length, \
                     or reconstruct each alone"
                );
                return Err(other_camera(path, known, reason));
            }
        }
        let Some(orientation) =
            hints.orientation.filter(|orientation| *orientation != first_orientation)
        else {
            continue;
        };
        if orientation.is_mirrored() != first_orientation.is_mirrored() {
            let ways = (orientation.description(), first_orientation.description());
            let reason = format!(
                "EXIF data ask that it be {}, and that one be {}; `mogrify -auto-orient` \
                 (ImageMagick) makes mirrored pictures those of a camera",
                ways.0, ways.1
            );
            return Err(other_camera(path, first, reason));
        }
        rotated.push((path, orientation));
    }
    let Some((path, orientation)) = rotated.first() else { return Ok(None) };
    Ok(Some(format!(
        "EXIF data ask that {} be shown otherwise than {}, the first of them, {}, {}: all are {} \
         alike, because a sensor does not turn in its camera; if some were turned before they were stored, \
         `mogrify -auto-orient` (ImageMagick) turns the others, too",
        counted(rotated.len(), "picture"),
        first.display(),
        path.display(),
        orientation.description(),
        shown.description(),
    )))
}

/// Whether EXIF data are cheap to read: PNG files may keep them at their end.
fn is_jpeg(path: &Path) -> bool {
    let extension = path.extension().and_then(|e| e.to_str()).unwrap_or_default();
    ["jpg", "jpeg"].iter().any(|known| extension.eq_ignore_ascii_case(known))
}

/// Whether two fields of view give images of one size the same focal length.
fn is_same_lens(view: FieldOfView, other: FieldOfView) -> bool {
    let ratio = view.focal_length(3, 4) / other.focal_length(3, 4);
    (ratio - 1.0).abs() <= SAME_LENS_TOLERANCE
}

fn other_camera(path: &Path, first: &Path, reason: String) -> DatasetError {
    DatasetError::OtherCamera { path: path.to_path_buf(), first: first.to_path_buf(), reason }
}

/// Message about the EXIF orientation of the first image, applied or not.
pub(crate) fn orientation_note(path: &Path, orientation: Orientation, is_applied: bool) -> String {
    let (path, how) = (path.display(), orientation.description());
    if is_applied {
        return format!("pictures are {how}, as the EXIF data of {path} ask");
    }
    format!(
        "EXIF data ask that {path} be {how}: what lies beside such pictures (depth, poses, a list) is \
         of pictures as they are stored, and so are they taken; `mogrify -auto-orient` \
         (ImageMagick) turns them for good"
    )
}

//! ScanNet as extracted by its own reader: `color/N.jpg`, `depth/N.png`, `pose/N.txt`,
//! `intrinsic/intrinsic_color.txt` and `intrinsic_depth.txt`.

use super::file_pairing::{FilePairs, list_images};
use super::poses::{parse_matrix, read_pose};
use super::{Layout, Listing};
use crate::camera::{Calibration, DepthGrid, Distortion, FormatDefaults};
use crate::text::{is_present, read_text};
use crate::{DatasetError, OpenOptions};
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Depth in millimetres, smaller than colour, 30 frames a second.
pub(super) const DEFAULTS: FormatDefaults = FormatDefaults {
    depth_scale: 1000.0,
    frame_rate: Some(30.0),
    grid: DepthGrid::OwnCamera(None),
    ..FormatDefaults::TUM
};

/// Width of the border without data that the paper removes [px of depth].
const EMPTY_BORDER: usize = 12;

/// Folders of a sequence.
pub(crate) struct ScanNetFolders {
    folder: PathBuf,
    intrinsic_colour: PathBuf,
}

/// The sequence in a folder, or in its `frames/`.
pub(super) fn find(folder: &Path) -> Option<ScanNetFolders> {
    [folder.to_path_buf(), folder.join("frames")].into_iter().find_map(|folder| {
        let images = ["color", "depth"].iter().all(|name| folder.join(name).is_dir());
        let files = ["intrinsic/intrinsic_color.txt", "intrinsic_color.txt"];
        let intrinsic_colour =
            files.iter().map(|name| folder.join(name)).find(|path| is_present(path))?;
        images.then_some(ScanNetFolders { folder, intrinsic_colour })
    })
}

/// Calibration of both cameras. Pixel centres at integers: the published depth camera is the colour
/// camera resized by exactly that convention.
pub(super) fn calibration(folders: &ScanNetFolders) -> Result<Calibration, DatasetError> {
    let colour = read_intrinsics(&folders.intrinsic_colour)?;
    let beside = folders.intrinsic_colour.with_file_name("intrinsic_depth.txt");
    let depth = if is_present(&beside) { Some(read_intrinsics(&beside)?) } else { None };
    let source = folders.intrinsic_colour.display().to_string();
    Ok(from_intrinsics(colour, depth, &source, DEFAULTS))
}

/// Calibration from the intrinsics of both cameras, `[fx, fy, cx, cy]` [px] with pixel centres at integers.
pub(super) fn from_intrinsics(
    colour: [f64; 4],
    depth: Option<[f64; 4]>,
    source: &str,
    defaults: FormatDefaults,
) -> Calibration {
    let depth = depth.map(|k| [k[0], k[1], k[2] + 0.5, k[3] + 0.5]);
    let defaults = FormatDefaults { grid: DepthGrid::OwnCamera(depth), ..defaults };
    Calibration::from_opencv(colour, Distortion::default(), source, defaults)
}

fn read_intrinsics(path: &Path) -> Result<[f64; 4], DatasetError> {
    let k = parse_matrix(&read_text(path)?).as_ref().and_then(intrinsics_of_matrix);
    k.ok_or_else(|| {
        DatasetError::file(path, "expected a 4x4 matrix of intrinsics with fx, fy above 0")
    })
}

/// `[fx, fy, cx, cy]` of a row-major 4x4 matrix; `None` unless finite with fx, fy > 0.
pub(super) fn intrinsics_of_matrix(m: &[f64; 16]) -> Option<[f64; 4]> {
    let k = [m[0], m[5], m[2], m[6]];
    (k.iter().all(|v| v.is_finite()) && k[0] > 0.0 && k[1] > 0.0).then_some(k)
}

/// Lists the frames at `number / frame_rate` [s], unthinned: published numbers count frames.
pub(super) fn list(
    folders: &ScanNetFolders,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let folder = &folders.folder;
    let (colour, depth) = (folder.join("color"), folder.join("depth"));
    let pairs = FilePairs::new(
        folder,
        list_images(&colour, |_| true)?,
        list_images(&depth, |_| true)?,
        options.depth_pairing,
    )?;
    let mut listing = pairs.list_by_number(Layout::ScanNet, frame_rate);
    listing.set_poses(|_, entry| {
        let name = entry.colour.with_extension("txt");
        read_pose(&folder.join("pose").join(name.file_name()?))
    });
    listing.warnings.extend(border_warning(options));
    Ok(listing)
}

/// A warning if the empty border of ScanNet's pictures is kept.
pub(super) fn border_warning(options: &OpenOptions) -> Option<String> {
    (options.crop_border < EMPTY_BORDER).then(|| {
        format!(
            "ScanNet pictures have an empty border: crop_border = {EMPTY_BORDER} under [input] in a \
             file for --config removes it, as the paper does ({EMPTY_BORDER} pixels of depth, {} of colour)",
            2 * EMPTY_BORDER
        )
    })
}

/// Scenes and frames evaluated in the paper (appendix, "Real-world dataset"), as half-open ranges.
const PAPER_FRAMES: [(&str, Range<usize>); 4] =
    [("0024_01", 0..300), ("0031_00", 0..300), ("0736_00", 1000..1400), ("0785_00", 0..500)];

/// The frames that the paper uses of a ScanNet scene, recognised by a name such as `scene0024_01` or
/// `0024-01`; `None` otherwise.
///
/// Published lists of sharp frames count from the start of this range.
pub fn paper_frames(name: &str) -> Option<Range<usize>> {
    let name = name.replace('-', "_");
    let digit = |c: Option<char>| c.is_some_and(|c| c.is_ascii_digit());
    let known = |scene: &str| {
        name.match_indices(scene).any(|(at, _)| {
            let (before, behind) = (&name[..at], &name[at + scene.len()..]);
            !digit(before.chars().next_back()) && !digit(behind.chars().next())
        })
    };
    PAPER_FRAMES.into_iter().find(|(scene, _)| known(scene)).map(|(_, range)| range)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_recognised_by_name() {
        assert_eq!(paper_frames("scene0736_00"), Some(1000..1400));
        assert_eq!(paper_frames("0785-00"), Some(0..500));
        assert_eq!(paper_frames("scene0024_01.sens"), Some(0..300));
        assert_eq!(paper_frames("scene0024_00"), None);
        assert_eq!(paper_frames("scene10024_01"), None);
        assert_eq!(paper_frames("scene0024_011"), None);
    }
}

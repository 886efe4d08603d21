//! ScanNet as its own reader extracts it: `color/N.jpg`, `depth/N.png`, `pose/N.txt`,
//! `intrinsic/intrinsic_color.txt` and `intrinsic_depth.txt`.

use super::pairs::{Pairs, images};
use super::poses::{read_matrix, rigid, stamped};
use super::{Layout, Listing};
use crate::calibration::{Calibration, DepthGrid, Traits};
use crate::distortion::Distortion;
use crate::{DatasetError, OpenOptions};
use std::path::{Path, PathBuf};

/// Depth in millimetres, smaller than colour, 30 frames a second.
pub(super) const TRAITS: Traits = Traits {
    depth_scale: 1000.0,
    frame_rate: Some(30.0),
    grid: DepthGrid::Depth(None),
    invalid_depth: None,
};

/// The border without data that the paper removes [px of depth].
const EMPTY_BORDER: usize = 12;

/// Where the parts of a sequence lie.
pub(crate) struct Folders {
    folder: PathBuf,
    intrinsic_colour: PathBuf,
}

/// The sequence in a folder, or in its `frames/`.
pub(super) fn find(folder: &Path) -> Option<Folders> {
    [folder.to_path_buf(), folder.join("frames")].into_iter().find_map(|folder| {
        let images = ["color", "depth"].iter().all(|name| folder.join(name).is_dir());
        let files = ["intrinsic/intrinsic_color.txt", "intrinsic_color.txt"];
        let intrinsic_colour =
            files.iter().map(|name| folder.join(name)).find(|path| path.is_file())?;
        images.then_some(Folders { folder, intrinsic_colour })
    })
}

/// Colour and depth camera. Pixel centres at integers: the depth camera of the published files is
/// the colour camera resized by exactly that convention.
pub(super) fn calibration(folders: &Folders) -> Result<Calibration, DatasetError> {
    let colour = intrinsics(&folders.intrinsic_colour)?;
    let beside = folders.intrinsic_colour.with_file_name("intrinsic_depth.txt");
    let depth = if beside.is_file() { Some(intrinsics(&beside)?) } else { None };
    let source = folders.intrinsic_colour.display().to_string();
    Ok(from_matrices(colour, depth, &source, TRAITS))
}

/// The calibration of both cameras, `[fx, fy, cx, cy]` [px] with pixel centres at integers.
pub(super) fn from_matrices(
    colour: [f64; 4],
    depth: Option<[f64; 4]>,
    source: &str,
    traits: Traits,
) -> Calibration {
    let depth = depth.map(|k| [k[0], k[1], k[2] + 0.5, k[3] + 0.5]);
    let traits = Traits { grid: DepthGrid::Depth(depth), ..traits };
    Calibration::from_opencv(colour, Distortion::default(), source, traits)
}

fn intrinsics(path: &Path) -> Result<[f64; 4], DatasetError> {
    let k = read_matrix(path).as_ref().and_then(of_matrix);
    k.ok_or_else(|| DatasetError::Metadata {
        path: path.to_path_buf(),
        reason: "expected a 4x4 matrix of intrinsics with fx, fy above 0".into(),
    })
}

/// `fx fy cx cy` of a 4x4 matrix in rows.
pub(super) fn of_matrix(m: &[f64; 16]) -> Option<[f64; 4]> {
    let k = [m[0], m[5], m[2], m[6]];
    (k.iter().all(|v| v.is_finite()) && k[0] > 0.0 && k[1] > 0.0).then_some(k)
}

/// The frames, at `number / frame_rate` [s], none thinned: published numbers count frames.
pub(super) fn list(
    folders: &Folders,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let folder = &folders.folder;
    let (colour, depth) = (folder.join("color"), folder.join("depth"));
    let pairs = Pairs::of(folder, images(&colour, |_| true)?, images(&depth, |_| true)?)?;
    let without_depth = pairs.without_depth;
    let gap = pairs.gap_warning();
    let entries = pairs.by_number(frame_rate);
    let poses = entries.iter().map(|entry| {
        let name = entry.colour.with_extension("txt");
        let file = name.file_name().map(|name| folder.join("pose").join(name));
        (entry.timestamp, file.and_then(|f| read_matrix(&f)).as_ref().and_then(rigid))
    });
    let (poses, warning) = stamped(poses);
    let mut listing = Listing { poses, ..Listing::new(Layout::ScanNet, entries) };
    listing.leave_out_without_depth(without_depth);
    listing.warnings.extend(gap);
    listing.warnings.extend(warning);
    listing.warnings.extend(border_warning(options));
    Ok(listing)
}

/// A warning if the empty border of ScanNet's pictures is kept.
pub(super) fn border_warning(options: &OpenOptions) -> Option<String> {
    (options.crop_border < EMPTY_BORDER).then(|| {
        format!(
            "ScanNet pictures have an empty border: crop_border {EMPTY_BORDER} removes it, as the \
             paper does ({EMPTY_BORDER} pixels of depth, {} of colour)",
            2 * EMPTY_BORDER
        )
    })
}

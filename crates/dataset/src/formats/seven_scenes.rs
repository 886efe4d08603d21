//! 7-Scenes: `frame-000000.color.png`, `frame-000000.depth.png` and `frame-000000.pose.txt` in
//! the folder of one sequence.

use super::file_pairing::{FilePairs, list_images};
use super::poses::{pose_from_matrix, read_matrix, stamp_poses};
use super::{Layout, Listing};
use crate::DatasetError;
use crate::camera::{Calibration, DepthGrid, Distortion, FormatDefaults};
use std::path::Path;

/// Depth in millimetres, 65535 where there is none. Colour and depth come from two cameras without
/// a published extrinsic calibration; poses are those of the depth camera, so frames are delivered
/// on its grid: 585 px, the value that the publishers used for tracking.
pub(super) const DEFAULTS: FormatDefaults = FormatDefaults {
    depth_scale: 1000.0,
    frame_rate: Some(30.0),
    grid: DepthGrid::OwnCamera(Some([585.0, 585.0, 320.0, 240.0])),
    invalid_depth: Some(u16::MAX),
};

/// `[fx, fy, cx, cy]` [px] (pixel centres at integers) of the colour camera: the usual values of a
/// Kinect.
const COLOUR_INTRINSICS: [f64; 4] = [525.0, 525.0, 319.5, 239.5];

fn is_colour(name: &str) -> bool {
    name.ends_with(".color.png")
}

fn is_depth(name: &str) -> bool {
    name.ends_with(".depth.png")
}

/// Whether the folder holds a colour and a depth image with these names.
pub(super) fn is_sequence(folder: &Path) -> bool {
    let names = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let (mut colour, mut depth) = (false, false);
    for name in names.map(|entry| entry.file_name()) {
        colour |= is_colour(&name.to_string_lossy());
        depth |= is_depth(&name.to_string_lossy());
        if colour && depth {
            return true;
        }
    }
    false
}

/// Calibration of both cameras.
pub(super) fn calibration() -> Calibration {
    let source = "the usual calibration of 7-Scenes";
    let found =
        Calibration::from_opencv(COLOUR_INTRINSICS, Distortion::default(), source, DEFAULTS);
    Calibration { size: Some((640, 480)), ..found }
}

/// Lists the frames at `number / frame_rate` [s].
pub(super) fn list(folder: &Path, frame_rate: f64) -> Result<Listing, DatasetError> {
    let pairs =
        FilePairs::new(folder, list_images(folder, is_colour)?, list_images(folder, is_depth)?)?;
    let without_depth = pairs.without_depth;
    let gap = pairs.gap_warning();
    let entries = pairs.stamped_by_number(frame_rate);
    let poses = entries.iter().map(|entry| {
        let name = entry.colour.file_name().map(|name| name.to_string_lossy().into_owned());
        let file = name.map(|name| folder.join(name.replace(".color.png", ".pose.txt")));
        (entry.timestamp, file.and_then(|f| read_matrix(&f)).as_ref().and_then(pose_from_matrix))
    });
    let (poses, warning) = stamp_poses(poses);
    let mut listing = Listing { poses, ..Listing::new(Layout::SevenScenes, entries) };
    listing.drop_without_depth(without_depth);
    listing.warnings.extend(gap);
    listing.warnings.extend(warning);
    listing.warnings.push(
        "7-Scenes publishes no calibration between colour and depth: their distance is not \
         corrected, expect a few pixels between them"
            .into(),
    );
    Ok(listing)
}

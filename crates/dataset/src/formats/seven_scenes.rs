//! 7-Scenes: `frame-000000.color.png`, `frame-000000.depth.png` and `frame-000000.pose.txt` in
//! the folder of one sequence.

use super::file_pairing::{FilePairs, holds_both, list_images};
use super::poses::read_pose;
use super::{Layout, Listing};
use crate::camera::{Calibration, DepthGrid, Distortion, FormatDefaults};
use crate::{DatasetError, OpenOptions};
use std::path::Path;

/// Depth in millimetres, 65535 where there is none. Colour and depth come from two cameras without
/// a published extrinsic calibration; poses are those of the depth camera, so frames are delivered
/// on its grid: 585 px, the value that the publishers used for tracking.
pub(super) const DEFAULTS: FormatDefaults = FormatDefaults {
    depth_scale: 1000.0,
    is_scale_assumed: false,
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
    holds_both(folder, is_colour, is_depth)
}

/// Calibration of both cameras.
pub(super) fn calibration() -> Calibration {
    let source = "the usual calibration of 7-Scenes";
    let found =
        Calibration::from_opencv(COLOUR_INTRINSICS, Distortion::default(), source, DEFAULTS);
    Calibration { size: Some((640, 480)), ..found }
}

/// Lists the frames at `number / frame_rate` [s].
pub(super) fn list(
    folder: &Path,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let pairs = FilePairs::new(
        folder,
        list_images(folder, is_colour)?,
        list_images(folder, is_depth)?,
        options.depth_pairing,
    )?;
    let mut listing = pairs.list_by_number(Layout::SevenScenes, frame_rate);
    listing.set_poses(|_, entry| {
        let name = entry.colour.file_name()?.to_string_lossy();
        read_pose(&folder.join(name.replace(".color.png", ".pose.txt")))
    });
    listing.warnings.push(
        "7-Scenes publishes no calibration between colour and depth: their distance is not \
         corrected, expect a few pixels between them"
            .into(),
    );
    Ok(listing)
}

//! 7-Scenes: `frame-000000.color.png`, `frame-000000.depth.png` and `frame-000000.pose.txt` in
//! the folder of one sequence.

use super::pairs::{Pairs, images};
use super::poses::{read_matrix, rigid, stamped};
use super::{Layout, Listing};
use crate::DatasetError;
use crate::calibration::{Calibration, DepthGrid, Traits};
use crate::distortion::Distortion;
use std::path::Path;

/// Depth in millimetres, 65535 where there is none. Colour and depth are pictures of two cameras
/// that were not calibrated against each other; poses are those of the depth camera, so frames
/// are delivered on its grid: 585 px, the value that the publishers used for tracking.
pub(super) const TRAITS: Traits = Traits {
    depth_scale: 1000.0,
    frame_rate: Some(30.0),
    grid: DepthGrid::Depth(Some([585.0, 585.0, 320.0, 240.0])),
    invalid_depth: Some(u16::MAX),
};

/// `[fx, fy, cx, cy]` [px] (pixel centres at integers) of the colour camera: the value of a Kinect
/// as the field takes it.
const COLOUR: [f64; 4] = [525.0, 525.0, 319.5, 239.5];

fn is_colour(name: &str) -> bool {
    name.ends_with(".color.png")
}

fn is_depth(name: &str) -> bool {
    name.ends_with(".depth.png")
}

/// Whether a colour and a depth image of this naming lie in the folder.
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

/// The two cameras.
pub(super) fn calibration() -> Calibration {
    let source = "the usual calibration of 7-Scenes";
    let found = Calibration::from_opencv(COLOUR, Distortion::default(), source, TRAITS);
    Calibration { size: Some((640, 480)), ..found }
}

/// The frames, at `number / frame_rate` [s].
pub(super) fn list(folder: &Path, frame_rate: f64) -> Result<Listing, DatasetError> {
    let pairs = Pairs::of(folder, images(folder, is_colour)?, images(folder, is_depth)?)?;
    let without_depth = pairs.without_depth;
    let gap = pairs.gap_warning();
    let entries = pairs.by_number(frame_rate);
    let poses = entries.iter().map(|entry| {
        let name = entry.colour.file_name().map(|name| name.to_string_lossy().into_owned());
        let file = name.map(|name| folder.join(name.replace(".color.png", ".pose.txt")));
        (entry.timestamp, file.and_then(|f| read_matrix(&f)).as_ref().and_then(rigid))
    });
    let (poses, warning) = stamped(poses);
    let mut listing = Listing { poses, ..Listing::new(Layout::SevenScenes, entries) };
    listing.leave_out_without_depth(without_depth);
    listing.warnings.extend(gap);
    listing.warnings.extend(warning);
    listing.warnings.push(
        "7-Scenes publishes no calibration between colour and depth: their distance is not \
         corrected, expect a few pixels between them"
            .into(),
    );
    Ok(listing)
}

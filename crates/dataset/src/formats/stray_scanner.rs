//! Recordings of the app Stray Scanner on telephones with LiDAR: `rgb.mp4`, `depth/000000.png` [mm],
//! `confidence/000000.png` and `camera_matrix.csv`.
//!
//! Depth has the number of its colour picture in the video, and its field of view in fewer
//! pixels. Poses of the telephone (`odometry.csv`) are no ground truth, and not read.

use super::file_pairing::{file_stem, last_number, list_images};
use super::{DepthEntry, FrameEntry, Layout, Listing};
use crate::camera::{Calibration, DepthGrid, Distortion, FormatDefaults};
use crate::text::{counted, data_lines, is_present, parse_numbers, read_text};
use crate::video::{Video, VideoListing, VideoPart};
use crate::{DatasetError, OpenOptions};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Depth in millimetres.
pub(super) const DEFAULTS: FormatDefaults =
    FormatDefaults { depth_scale: 1000.0, grid: DepthGrid::ResizedToColour, ..FormatDefaults::TUM };

const VIDEO: &str = "rgb.mp4";
const CAMERA: &str = "camera_matrix.csv";

/// True if a folder holds such a recording.
pub(super) fn is_recording(folder: &Path) -> bool {
    [VIDEO, CAMERA, "depth"].iter().all(|name| is_present(&folder.join(name)))
}

/// The camera of the colour pictures: a matrix of three rows.
pub(super) fn calibration(folder: &Path) -> Result<Calibration, DatasetError> {
    let path = folder.join(CAMERA);
    let text = read_text(&path)?;
    let mut rows = Vec::new();
    for (line, content) in data_lines(&text) {
        let words: Vec<&str> = content.split(',').map(str::trim).collect();
        if words.len() != 3 {
            let reason = format!("{} columns, expected 3, separated by commas", words.len());
            return Err(DatasetError::line(&path, line, reason));
        }
        rows.push(parse_numbers(&path, line, ["column 1", "column 2", "column 3"], &words)?);
    }
    match rows.as_slice() {
        [[fx, _, cx], [_, fy, cy], _] if *fx > 0.0 && *fy > 0.0 => {
            let source = path.display().to_string();
            Ok(Calibration::from_opencv(
                [*fx, *fy, *cx, *cy],
                Distortion::default(),
                &source,
                DEFAULTS,
            ))
        }
        _ => Err(DatasetError::file(
            &path,
            "expected a 3x3 matrix of intrinsics with fx, fy above 0",
        )),
    }
}

/// Lists the pictures of the video with their depth, if it is asked for.
pub(super) fn list(
    folder: &Path,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let path = folder.join(VIDEO);
    let depth_folder = folder.join("depth");
    let depth_files = match options.colour_only {
        true => BTreeMap::new(),
        false => numbered(list_images(&depth_folder, |name| name.ends_with(".png"))?),
    };
    let end = options.frames.as_ref().map(|range| range.end);
    let part = VideoPart { end, depth: None, frame_rate };
    let VideoListing { video, timestamps, warnings, .. } = Video::open(&path, part)?;
    let confidence_of = |depth: &PathBuf| {
        let file = folder.join("confidence").join(depth.file_name()?);
        is_present(&file).then_some(file)
    };
    let entry = |(index, timestamp): (usize, &f64)| {
        let depth = depth_files.get(&(index as u64)).map(|path| DepthEntry {
            confidence: confidence_of(path),
            ..DepthEntry::of_file(path.clone(), *timestamp)
        });
        let colour = path.clone();
        FrameEntry { depth, ..FrameEntry::synchronous((index, index), *timestamp, colour, None) }
    };
    let entries: Vec<FrameEntry> = timestamps.iter().enumerate().map(entry).collect();
    if !options.colour_only && entries.iter().all(|entry| entry.depth.is_none()) {
        let reason = format!(
            "none of its {} has the number of one of the {} of {}",
            counted(depth_files.len(), "depth picture"),
            counted(entries.len(), "picture"),
            VIDEO
        );
        return Err(DatasetError::file(&depth_folder, reason));
    }
    let mut listing =
        Listing { video: Some(video), warnings, ..Listing::new(Layout::StrayScanner, entries) };
    listing.keep_those_with_depth(options, "no depth image of that number");
    Ok(listing)
}

/// Files by the number in their names.
fn numbered(files: Vec<PathBuf>) -> BTreeMap<u64, PathBuf> {
    files.into_iter().filter_map(|path| Some((last_number(&file_stem(&path))?, path))).collect()
}

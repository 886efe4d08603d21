//! Replica as rendered for NICE-SLAM: `results/frame000000.jpg`, `results/depth000000.png`,
//! `traj.txt`, and `cam_params.json` there or one folder up.

use super::pairs::{Pairs, images};
use super::poses::{read_lines, stamped};
use super::{Layout, Listing};
use crate::DatasetError;
use crate::calibration::{Calibration, DepthGrid, Traits};
use crate::distortion::Distortion;
use crate::lists::read_text;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// 6553.5 for one metre, rendered with 30 frames a second in mind.
pub(super) const TRAITS: Traits = Traits {
    depth_scale: 6553.5,
    frame_rate: Some(30.0),
    grid: DepthGrid::Colour,
    invalid_depth: None,
};

/// The camera of all scenes as published, `[fx, fy, cx, cy]` [px] for 1200x680.
const PUBLISHED: [f64; 4] = [600.0, 600.0, 599.5, 339.5];

/// Where the parts of a scene lie.
pub(crate) struct Folders {
    scene: PathBuf,
    results: PathBuf,
}

/// The scene in a folder.
pub(super) fn find(folder: &Path) -> Option<Folders> {
    let results = folder.join("results");
    let names = std::fs::read_dir(&results).ok()?.flatten();
    let (mut colour, mut depth) = (false, false);
    for name in names.map(|entry| entry.file_name()) {
        colour |= is_colour(&name.to_string_lossy());
        depth |= is_depth(&name.to_string_lossy());
        if colour && depth {
            return Some(Folders { scene: folder.to_path_buf(), results });
        }
    }
    None
}

fn is_colour(name: &str) -> bool {
    name.starts_with("frame")
}

fn is_depth(name: &str) -> bool {
    name.starts_with("depth")
}

#[derive(Deserialize)]
struct CameraFile {
    camera: CameraNumbers,
}

#[derive(Deserialize)]
struct CameraNumbers {
    w: usize,
    h: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    scale: f64,
}

/// The camera of `cam_params.json`, else the published one. Pixel centres at integers.
pub(super) fn calibration(folders: &Folders) -> Result<Calibration, DatasetError> {
    let whole = folders.scene.canonicalize().unwrap_or_else(|_| folders.scene.clone());
    let places = [Some(whole.as_path()), whole.parent()];
    let files = places.into_iter().flatten().map(|place| place.join("cam_params.json"));
    let Some(path) = files.into_iter().find(|path| path.is_file()) else {
        let lens = Distortion::default();
        let found = Calibration::from_opencv(PUBLISHED, lens, "the published camera", TRAITS);
        return Ok(Calibration { size: Some((1200, 680)), ..found });
    };
    let refuse = |reason: String| DatasetError::Metadata { path: path.clone(), reason };
    let CameraFile { camera: c } = serde_json::from_str(&read_text(&path)?)
        .map_err(|e| refuse(format!("{e}; expected camera with w, h, fx, fy, cx, cy, scale")))?;
    if [c.fx, c.fy, c.scale].iter().any(|v| *v <= 0.0) {
        return Err(refuse("fx, fy and scale must be positive".into()));
    }
    let traits = Traits { depth_scale: c.scale, ..TRAITS };
    let source = path.display().to_string();
    let k = [c.fx, c.fy, c.cx, c.cy];
    let found = Calibration::from_opencv(k, Distortion::default(), &source, traits);
    Ok(Calibration { size: Some((c.w, c.h)), ..found })
}

/// The frames, at `number / frame_rate` [s]; line n of `traj.txt` is the pose of frame n.
pub(super) fn list(folders: &Folders, frame_rate: f64) -> Result<Listing, DatasetError> {
    let results = &folders.results;
    let pairs = Pairs::of(results, images(results, is_colour)?, images(results, is_depth)?)?;
    let without_depth = pairs.without_depth;
    let gap = pairs.gap_warning();
    let places: Vec<Option<usize>> =
        pairs.pairs.iter().map(|pair| pair.number.map(|n| n as usize)).collect();
    let mut listing = Listing::new(Layout::Replica, pairs.by_number(frame_rate));
    listing.leave_out_without_depth(without_depth);
    listing.warnings.extend(gap);
    let file = folders.scene.join("traj.txt");
    if file.is_file() {
        match read_lines(&file) {
            Ok(lines) => {
                let numbers = places.iter().enumerate().map(|(i, n)| n.unwrap_or(i));
                let poses = numbers.map(|n| lines.get(n).copied().flatten());
                let stamps = listing.entries.iter().map(|entry| entry.timestamp);
                let (poses, warning) = stamped(stamps.zip(poses));
                listing.poses = poses;
                listing.warnings.extend(warning);
            }
            Err(error) => listing.warnings.push(format!("ground truth ignored: {error}")),
        }
    }
    Ok(listing)
}

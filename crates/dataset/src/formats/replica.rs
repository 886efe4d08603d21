//! Replica as rendered for NICE-SLAM: `results/frame000000.jpg`, `results/depth000000.png`,
//! `traj.txt`, and `cam_params.json` there or one folder up.

use super::file_pairing::{FilePairs, holds_both, list_images};
use super::poses::read_matrix_lines;
use super::{Layout, Listing};
use crate::camera::{Calibration, Distortion, FormatDefaults};
use crate::text::{deserialize_json, is_present, read_text};
use crate::{DatasetError, OpenOptions};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// Depth 6553.5 per metre, 30 frames a second (NICE-SLAM).
pub(super) const DEFAULTS: FormatDefaults =
    FormatDefaults { depth_scale: 6553.5, frame_rate: Some(30.0), ..FormatDefaults::TUM };

/// Published camera of all scenes, `[fx, fy, cx, cy]` [px] for 1200x680.
const PUBLISHED: [f64; 4] = [600.0, 600.0, 599.5, 339.5];

/// Folders of a scene.
pub(crate) struct ReplicaFolders {
    scene: PathBuf,
    results: PathBuf,
}

/// The scene in a folder, if any.
pub(super) fn find(folder: &Path) -> Option<ReplicaFolders> {
    let results = folder.join("results");
    let found = ReplicaFolders { scene: folder.to_path_buf(), results };
    holds_both(&found.results, is_colour, is_depth).then_some(found)
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

/// Calibration of `cam_params.json`, else the published one. Pixel centres at integers.
pub(super) fn calibration(folders: &ReplicaFolders) -> Result<Calibration, DatasetError> {
    let whole = folders.scene.canonicalize().unwrap_or_else(|_| folders.scene.clone());
    let places = [Some(whole.as_path()), whole.parent()];
    let files = places.into_iter().flatten().map(|place| place.join("cam_params.json"));
    let Some(path) = files.into_iter().find(|path| is_present(path)) else {
        let lens = Distortion::default();
        let found = Calibration::from_opencv(PUBLISHED, lens, "the published camera", DEFAULTS);
        return Ok(Calibration { size: Some((1200, 680)), ..found });
    };
    let refuse = |reason: String| DatasetError::file(&path, reason);
    let CameraFile { camera: c } = deserialize_json(&read_text(&path)?)
        .map_err(|e| refuse(format!("{e}; expected camera with w, h, fx, fy, cx, cy, scale")))?;
    if [c.fx, c.fy, c.scale].iter().any(|v| *v <= 0.0) {
        return Err(refuse("fx, fy and scale must be positive".into()));
    }
    let defaults = FormatDefaults { depth_scale: c.scale, ..DEFAULTS };
    let source = path.display().to_string();
    let k = [c.fx, c.fy, c.cx, c.cy];
    let found = Calibration::from_opencv(k, Distortion::default(), &source, defaults);
    Ok(Calibration { size: Some((c.w, c.h)), ..found })
}

/// Lists the frames at `number / frame_rate` [s]; line n of `traj.txt` is the pose of frame n.
pub(super) fn list(
    folders: &ReplicaFolders,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let results = &folders.results;
    let pairs = FilePairs::new(
        results,
        list_images(results, is_colour)?,
        list_images(results, is_depth)?,
        options.depth_pairing,
    )?;
    let numbers: Vec<Option<usize>> =
        pairs.pairs.iter().map(|pair| pair.number.map(|n| n as usize)).collect();
    let mut listing = pairs.list_by_number(Layout::Replica, frame_rate);
    let file = folders.scene.join("traj.txt");
    if is_present(&file) {
        match read_matrix_lines(&file) {
            Ok(lines) => listing.set_poses(|i, _| *lines.get(numbers[i].unwrap_or(i))?),
            Err(error) => listing.warnings.push(format!("ground truth ignored: {error}")),
        }
    }
    Ok(listing)
}

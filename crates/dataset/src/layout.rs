//! What a folder holds: pairs of colour and depth files with their time stamps.

use crate::associate::{Association, Rules, associate};
use crate::lists::read_image_list;
use crate::plain;
use crate::{DatasetError, Entry, LeftOut, OpenOptions, read_trajectory};
use std::path::{Path, PathBuf};

/// The associated stream of a folder.
#[derive(Debug)]
pub(crate) struct Listing {
    /// All pairs, in order of time.
    pub(crate) entries: Vec<Entry>,
    pub(crate) left_out: LeftOut,
    /// The folder's ground truth, whether or not it can be read.
    pub(crate) ground_truth: Option<PathBuf>,
    pub(crate) warnings: Vec<String>,
}

/// Colour and depth files with their stamps [s], each in order of time.
pub(crate) struct Stamped {
    pub(crate) colour: Vec<(f64, PathBuf)>,
    pub(crate) depth: Vec<(f64, PathBuf)>,
}

/// Lists the frames of `folder`, which must exist and be one of the two layouts. `frame_rate` [1/s] gives
/// stamps to files whose names carry none.
pub(crate) fn list(
    folder: &Path,
    options: &OpenOptions,
    frame_rate: f64,
) -> Result<Listing, DatasetError> {
    let (colour, depth) = (folder.join("rgb.txt"), folder.join("depth.txt"));
    if colour.is_file() && depth.is_file() {
        let colour = read_image_list(&colour, folder)?;
        let depth = read_image_list(&depth, folder)?;
        return by_time(folder, Stamped { colour, depth }, options);
    }
    let Some(folders) = plain::find(folder) else {
        let found = contents(folder);
        return Err(DatasetError::UnknownLayout { path: folder.to_path_buf(), found });
    };
    match plain::list(folder, &folders, frame_rate)? {
        plain::Files::Stamped(stamped) => by_time(folder, stamped, options),
        plain::Files::Paired { entries, without_depth } => {
            let left_out = LeftOut { without_depth, ..LeftOut::default() };
            let warnings = plain_warnings(&left_out);
            let ground_truth = ground_truth(folder);
            Ok(Listing { entries, left_out, ground_truth, warnings })
        }
    }
}

fn by_time(
    folder: &Path,
    stamped: Stamped,
    options: &OpenOptions,
) -> Result<Listing, DatasetError> {
    let stamps = |files: &[(f64, PathBuf)]| files.iter().map(|f| f.0).collect::<Vec<f64>>();
    let (colour, depth) = (stamps(&stamped.colour), stamps(&stamped.depth));
    let rules =
        Rules { tolerance: options.association_tolerance, minimum_gap: options.minimum_gap };
    let ground_truth = ground_truth(folder);
    let mut warnings = Vec::new();
    let poses = ground_truth.as_deref().and_then(|path| pose_stamps(path, &mut warnings));
    let mut association = associate(&colour, &depth, poses.as_deref(), rules);
    if association.pairs.is_empty() && association.without_pose > 0 {
        warnings.push("no frame has a ground-truth pose in time: ground truth ignored".into());
        association = associate(&colour, &depth, None, rules);
    }
    if association.pairs.is_empty() {
        return Err(DatasetError::NoDepthPartner {
            path: folder.to_path_buf(),
            frames: colour.len(),
            tolerance: rules.tolerance,
            nearest_gap: association.nearest_gap,
        });
    }
    let entries = entries(&association, &stamped);
    let left_out = LeftOut {
        without_depth: association.without_depth,
        without_pose: association.without_pose,
        too_close: association.too_close,
    };
    warnings.extend(time_warnings(&left_out, rules));
    Ok(Listing { entries, left_out, ground_truth, warnings })
}

fn entries(association: &Association, stamped: &Stamped) -> Vec<Entry> {
    let pairs = association.pairs.iter().enumerate();
    pairs
        .map(|(index, &(i, j))| {
            let (timestamp, colour) = stamped.colour[i].clone();
            let (depth_timestamp, depth) = stamped.depth[j].clone();
            Entry { index, timestamp, depth_timestamp, colour, depth }
        })
        .collect()
}

fn ground_truth(folder: &Path) -> Option<PathBuf> {
    ["groundtruth.txt", "pose.txt"].iter().map(|name| folder.join(name)).find(|p| p.is_file())
}

fn pose_stamps(path: &Path, warnings: &mut Vec<String>) -> Option<Vec<f64>> {
    match read_trajectory(path) {
        Ok(trajectory) => Some(trajectory.iter().map(|pose| pose.timestamp).collect()),
        Err(error) => {
            warnings.push(format!("ground truth ignored: {error}"));
            None
        }
    }
}

fn time_warnings(left_out: &LeftOut, rules: Rules) -> Vec<String> {
    let mut warnings = Vec::new();
    if left_out.without_depth > 0 {
        warnings.push(format!(
            "{} colour images left out: no depth image within {} s",
            left_out.without_depth, rules.tolerance
        ));
    }
    if left_out.without_pose > 0 {
        warnings.push(format!(
            "{} frames left out: no ground-truth pose within {} s",
            left_out.without_pose, rules.tolerance
        ));
    }
    if left_out.too_close > 0 {
        warnings.push(format!(
            "{} frames left out: no more than {} s after the frame before (minimum_gap; 0 keeps \
             all)",
            left_out.too_close, rules.minimum_gap
        ));
    }
    warnings
}

fn plain_warnings(left_out: &LeftOut) -> Vec<String> {
    let count = left_out.without_depth;
    (count > 0)
        .then(|| format!("{count} colour images left out: no depth image of that name or number"))
        .into_iter()
        .collect()
}

/// The first names in a folder, for an error message.
fn contents(folder: &Path) -> String {
    let mut names: Vec<String> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    match names.len() {
        0 => "an empty folder".into(),
        1..=8 => names.join(", "),
        count => format!("{}, ... ({count} in all)", names[..8].join(", ")),
    }
}

//! Colour and depth images paired by time: TUM RGB-D lists, and folders of stamped names.

use super::{Layout, Listing, counted};
use crate::associate::{Association, Rules, associate};
use crate::lists::read_image_list;
use crate::{DatasetError, Entry, LeftOut, OpenOptions, read_trajectory};
use std::path::{Path, PathBuf};

/// Colour and depth files with their stamps [s], each in order of time.
pub(crate) struct Stamped {
    pub(crate) colour: Vec<(f64, PathBuf)>,
    /// `None`: a sequence without depth.
    pub(crate) depth: Option<Vec<(f64, PathBuf)>>,
}

/// Whether `rgb.txt` and `depth.txt` lie in the folder.
pub(crate) fn has_lists(folder: &Path) -> bool {
    folder.join("rgb.txt").is_file() && folder.join("depth.txt").is_file()
}

/// Whether `rgb.txt` lies in the folder.
pub(crate) fn has_colour_list(folder: &Path) -> bool {
    folder.join("rgb.txt").is_file()
}

/// The frames of `rgb.txt` and `depth.txt`; of `rgb.txt` alone where only colour is wanted and
/// there is no other list.
pub(crate) fn list(
    folder: &Path,
    layout: Layout,
    options: &OpenOptions,
) -> Result<Listing, DatasetError> {
    let colour = read_image_list(&folder.join("rgb.txt"), folder)?;
    let list = folder.join("depth.txt");
    let alone = options.colour_only && !list.is_file();
    let depth = if alone { None } else { Some(read_image_list(&list, folder)?) };
    by_time(folder, layout, Stamped { colour, depth }, options)
}

/// Pairs by time; ground truth beside the images must be in time too.
pub(crate) fn by_time(
    folder: &Path,
    layout: Layout,
    stamped: Stamped,
    options: &OpenOptions,
) -> Result<Listing, DatasetError> {
    let stamps = |files: &[(f64, PathBuf)]| files.iter().map(|f| f.0).collect::<Vec<f64>>();
    let colour = stamps(&stamped.colour);
    // Without depth a picture is its own partner.
    let depth = stamps(stamped.depth.as_ref().unwrap_or(&stamped.colour));
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
    let listing = Listing::new(layout, entries);
    Ok(Listing { left_out, is_thinned: true, ground_truth, warnings, ..listing })
}

fn entries(association: &Association, stamped: &Stamped) -> Vec<Entry> {
    let pairs = association.pairs.iter().enumerate();
    pairs
        .map(|(index, &(i, j))| {
            let (timestamp, colour) = stamped.colour[i].clone();
            let depth = stamped.depth.as_ref().map(|depth| depth[j].clone());
            let depth_timestamp = depth.as_ref().map_or(timestamp, |depth| depth.0);
            let depth = depth.map(|depth| depth.1);
            Entry { index, place: i, timestamp, depth_timestamp, colour, depth, parts: None }
        })
        .collect()
}

/// The ground-truth file of a folder, whether or not it can be read.
pub(crate) fn ground_truth(folder: &Path) -> Option<PathBuf> {
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
            "{} left out: no depth image within {} s",
            counted(left_out.without_depth, "colour image"),
            rules.tolerance
        ));
    }
    if left_out.without_pose > 0 {
        warnings.push(format!(
            "{} left out: no ground-truth pose within {} s",
            counted(left_out.without_pose, "frame"),
            rules.tolerance
        ));
    }
    if left_out.too_close > 0 {
        warnings.push(format!(
            "{} left out: no more than {} s after the frame before (minimum_gap; 0 keeps all)",
            counted(left_out.too_close, "frame"),
            rules.minimum_gap
        ));
    }
    warnings
}

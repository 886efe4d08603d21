//! TUM RGB-D and ETH3D SLAM: stamped image lists, trajectories, published calibrations.

use super::association::{Association, AssociationRules, associate, time_warnings};
use super::poses::{UNIT_TOLERANCE, unit_length_error};
use super::{DepthEntry, DetectedLayout, FrameEntry, Layout, Listing};
use crate::camera::{Calibration, Distortion, FormatDefaults};
use crate::text::{data_lines, is_present, parse_number, parse_numbers, read_text};
use crate::{DatasetError, OpenOptions};
use i2slam_geometry::{Pose, Rotation, StampedPose, Trajectory, Vec3};
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Largest offset of two clocks [s]: stamps farther apart are in other units than seconds.
const MAX_CLOCK_OFFSET: f64 = 1e6;
const COLUMNS: [&str; 8] = ["time stamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"];

/// Reads `world_from_camera` poses [s, m] in the TUM format, sorted by time.
///
/// `#` starts a comment line. A stamp without a single finite number behind it, as some systems write
/// where they were lost, is left out. Any other number that is not finite, a wrong count of columns or
/// a zero quaternion is an error that names file and line; so is a file without a pose.
pub fn read_trajectory(path: impl AsRef<Path>) -> Result<Trajectory, DatasetError> {
    read_poses(path.as_ref(), f64::INFINITY)
}

/// As [`read_trajectory`], but refuses quaternions whose length is not 1.
pub(crate) fn read_unit_trajectory(path: &Path) -> Result<Trajectory, DatasetError> {
    read_poses(path, UNIT_TOLERANCE)
}

fn read_poses(path: &Path, tolerance: f64) -> Result<Trajectory, DatasetError> {
    let text = read_text(path)?;
    let mut trajectory = data_lines(&text)
        .filter_map(|(line, content)| read_pose(path, line, content, tolerance).transpose())
        .collect::<Result<Trajectory, _>>()?;
    if trajectory.is_empty() {
        return Err(DatasetError::empty(path, "lines with timestamp tx ty tz qx qy qz qw"));
    }
    trajectory.sort_by(|a, b| a.timestamp.total_cmp(&b.timestamp));
    Ok(trajectory)
}

/// The pose of a line; `None` if no number behind the stamp is finite.
fn read_pose(
    path: &Path,
    line: usize,
    content: &str,
    tolerance: f64,
) -> Result<Option<StampedPose>, DatasetError> {
    let columns: Vec<&str> = content.split_whitespace().collect();
    if columns.len() != COLUMNS.len() {
        let reason = format!(
            "{} columns, expected 8: timestamp tx ty tz qx qy qz qw, separated by spaces",
            columns.len()
        );
        return Err(DatasetError::line(path, line, reason));
    }
    let is_lost = |text: &&str| text.parse::<f64>().is_ok_and(|number| !number.is_finite());
    if columns[1..].iter().all(is_lost) {
        return parse_number(path, line, COLUMNS[0], columns[0]).map(|_| None);
    }
    let [timestamp, tx, ty, tz, qx, qy, qz, qw] = parse_numbers(path, line, COLUMNS, &columns)?;
    let rotation = Rotation::from_wxyz(qw, qx, qy, qz).ok_or_else(|| {
        DatasetError::line(path, line, "the quaternion is zero, expected one of length 1")
    })?;
    if let Some(reason) = unit_length_error([qw, qx, qy, qz], tolerance) {
        return Err(DatasetError::line(path, line, reason));
    }
    let world_from_camera = Pose::new(rotation, Vec3::new(tx, ty, tz));
    Ok(Some(StampedPose { timestamp, world_from_camera }))
}

/// Writes `world_from_camera` poses [s, m] in the TUM format.
pub fn write_trajectory(
    path: impl AsRef<Path>,
    trajectory: &[StampedPose],
) -> Result<(), DatasetError> {
    let path = path.as_ref();
    let mut text = String::from("# world_from_camera: timestamp tx ty tz qx qy qz qw\n");
    for pose in trajectory {
        let (q, t) = (pose.world_from_camera.rotation, pose.world_from_camera.translation);
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "{:.6} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
            pose.timestamp, t.x, t.y, t.z, q.v.x, q.v.y, q.v.z, q.w
        );
    }
    let written = i2slam_storage::write_file(path, |out| out.write_all(text.as_bytes()));
    Ok(written?)
}

/// Reads the stamped image files of `rgb.txt` or `depth.txt`, sorted by time; paths joined to
/// `folder`.
fn read_image_list(path: &Path, folder: &Path) -> Result<Vec<(f64, PathBuf)>, DatasetError> {
    let text = read_text(path)?;
    let mut images = Vec::new();
    for (line, content) in data_lines(&text) {
        let Some((stamp, file)) = content.split_once(char::is_whitespace) else {
            let reason = format!("'{content}', expected a time stamp and a file name");
            return Err(DatasetError::line(path, line, reason));
        };
        images.push((parse_number(path, line, "time stamp", stamp)?, folder.join(file.trim())));
    }
    if images.is_empty() {
        return Err(DatasetError::empty(path, "lines with a time stamp and a file name"));
    }
    images.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok(images)
}

/// [`read_image_list`] of a list whose files are needed: an error if not one of them is there.
fn read_present_images(path: &Path, folder: &Path) -> Result<Vec<(f64, PathBuf)>, DatasetError> {
    let images = read_image_list(path, folder)?;
    match images.iter().any(|(_, file)| is_present(file)) {
        true => Ok(images),
        false => {
            let (count, first) = (images.len(), images[0].1.display());
            let reason =
                format!("none of the {count} files that it names is there: expected {first}");
            Err(DatasetError::file(path, reason))
        }
    }
}

/// Colour and depth files with their time stamps [s], each in order of time.
pub(super) struct StampedImages {
    pub(crate) colour: Vec<(f64, PathBuf)>,
    /// `None`: a sequence without depth.
    pub(crate) depth: Option<Vec<(f64, PathBuf)>>,
}

/// The layout of a folder with `rgb.txt` (and `depth.txt`, if asked for): ETH3D's if there is a
/// calibration file.
pub(super) fn find(folder: &Path, with_depth: bool) -> Option<DetectedLayout> {
    let has = |name: &str| is_present(&folder.join(name));
    let calibration = folder.join("calibration.txt");
    (has("rgb.txt") && (!with_depth || has("depth.txt"))).then(|| match is_present(&calibration) {
        true => DetectedLayout::Eth3d(calibration),
        false => DetectedLayout::Tum,
    })
}

/// Lists the frames of `rgb.txt` and `depth.txt`; of `rgb.txt` alone with `colour_only` if there is
/// no depth list.
pub(super) fn list(
    folder: &Path,
    layout: Layout,
    options: &OpenOptions,
) -> Result<Listing, DatasetError> {
    let colour = read_present_images(&folder.join("rgb.txt"), folder)?;
    let list = folder.join("depth.txt");
    let depth = match (options.colour_only, is_present(&list)) {
        (true, false) => None,
        // Its time stamps choose among colour pictures.
        (true, true) => Some(read_image_list(&list, folder)?),
        (false, _) => Some(read_present_images(&list, folder)?),
    };
    list_by_time(folder, layout, StampedImages { colour, depth }, options)
}

/// Associates colour with depth and, if the folder has ground truth, with its poses.
pub(super) fn list_by_time(
    folder: &Path,
    layout: Layout,
    stamped: StampedImages,
    options: &OpenOptions,
) -> Result<Listing, DatasetError> {
    let stamps = |files: &[(f64, PathBuf)]| files.iter().map(|f| f.0).collect::<Vec<f64>>();
    let colour = stamps(&stamped.colour);
    let depth = stamped.depth.as_ref().map(|files| stamps(files));
    let rules = AssociationRules::of(options);
    let ground_truth = ground_truth(folder);
    let mut warnings = Vec::new();
    let poses = ground_truth.as_deref().and_then(|path| pose_stamps(path, &mut warnings));
    let mut association = associate(&colour, depth.as_deref(), poses.as_deref(), rules);
    if association.pairs.is_empty() && association.without_pose > 0 {
        warnings.push("no frame has a ground-truth pose in time: ground truth ignored".into());
        association = associate(&colour, depth.as_deref(), None, rules);
    }
    let needs_depth = depth.is_some() && !options.colour_only;
    if association.pairs.is_empty() || needs_depth && association.with_depth() == 0 {
        let check = match association.nearest_gap > MAX_CLOCK_OFFSET {
            true => "time stamps are in seconds, not in parts of one",
            false => "check that both use one clock",
        };
        let reason = format!(
            "none of {} colour images has a depth image within {} s; the nearest is {:.3} s away: {check}",
            colour.len(),
            rules.tolerance,
            association.nearest_gap
        );
        return Err(DatasetError::file(folder, reason));
    }
    let entries = entries(&association, &stamped);
    let dropped = association.dropped();
    warnings.extend(time_warnings(&dropped, rules));
    let listing = Listing::new(layout, entries);
    Ok(Listing { dropped, is_thinned: true, ground_truth, warnings, ..listing })
}

fn entries(association: &Association, stamped: &StampedImages) -> Vec<FrameEntry> {
    let entry = |(index, &(i, j)): (usize, &(usize, Option<usize>))| {
        let (timestamp, colour) = stamped.colour[i].clone();
        let depth = stamped.depth.as_ref().zip(j).map(|(files, j)| files[j].clone());
        let depth = depth.map(|(timestamp, path)| DepthEntry::of_file(path, timestamp));
        FrameEntry { depth, ..FrameEntry::synchronous((index, i), timestamp, colour, None) }
    };
    association.pairs.iter().enumerate().map(entry).collect()
}

/// Path of the folder's ground truth, if there is a file.
pub(super) fn ground_truth(folder: &Path) -> Option<PathBuf> {
    ["groundtruth.txt", "pose.txt"].iter().map(|name| folder.join(name)).find(|p| is_present(p))
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

/// Names of the lists that a folder lacks though another file of TUM RGB-D or ETH3D SLAM is there.
pub(super) fn missing_list(folder: &Path) -> Option<String> {
    let names = ["rgb.txt", "depth.txt", "calibration.txt"];
    let (there, missing): (Vec<&str>, Vec<&str>) =
        names.iter().partition(|name| is_present(&folder.join(name)));
    let missing: Vec<&str> =
        missing.into_iter().filter(|name| *name != "calibration.txt").collect();
    (!there.is_empty() && !missing.is_empty()).then(|| {
        format!(
            "{} is there without {}, which TUM RGB-D and ETH3D SLAM need",
            there.join(" and "),
            missing.join(" and ")
        )
    })
}

/// Reads ETH3D's `fx fy cx cy`, one line, pixel centres at integers, images undistorted.
pub(super) fn eth3d_calibration(path: &Path) -> Result<Calibration, DatasetError> {
    let text = read_text(path)?;
    let expected = "the four numbers fx fy cx cy";
    let Some((line, content)) = data_lines(&text).next() else {
        return Err(DatasetError::empty(path, expected));
    };
    let words: Vec<&str> = content.split_whitespace().collect();
    if words.len() != 4 {
        let reason = format!("{} numbers, expected {expected}", words.len());
        return Err(DatasetError::line(path, line, reason));
    }
    let k = parse_numbers(path, line, ["fx", "fy", "cx", "cy"], &words)?;
    if k[0] <= 0.0 || k[1] <= 0.0 {
        return Err(DatasetError::line(path, line, "fx and fy must be positive"));
    }
    let source = path.display().to_string();
    Ok(Calibration::from_opencv(k, Distortion::default(), &source, FormatDefaults::TUM))
}

/// The published calibration of a TUM RGB-D sequence (depth is registered to colour), recognised by
/// the name of the folder or of its parent.
pub(crate) fn published_calibration(folder: &Path) -> Option<Calibration> {
    let whole = folder.canonicalize().unwrap_or_else(|_| folder.to_path_buf());
    let number = [Some(whole.as_path()), whole.parent()]
        .into_iter()
        .flatten()
        .filter_map(|p| p.file_name()?.to_str().map(str::to_lowercase))
        .find_map(|name| freiburg_number(&name))?;
    let (k, lens): ([f64; 4], [f64; 5]) = match number {
        1 => ([517.3, 516.5, 318.6, 255.3], [0.2624, -0.9531, -0.0054, 0.0026, 1.1633]),
        2 => ([520.9, 521.0, 325.1, 249.7], [0.2312, -0.7849, -0.0033, -0.0001, 0.9172]),
        _ => ([535.4, 539.2, 320.1, 247.6], [0.0; 5]),
    };
    let lens = Distortion::from_opencv(&lens)?;
    let source = format!("the calibration of freiburg{number}");
    let format = FormatDefaults { frame_rate: Some(30.0), ..FormatDefaults::TUM };
    let found = Calibration::from_opencv(k, lens, &source, format);
    Some(Calibration { size: Some((640, 480)), ..found })
}

/// The number in `...freiburg2...`, or in `fr2` as a word of its own.
fn freiburg_number(name: &str) -> Option<u32> {
    let words = name.split(|c: char| !c.is_ascii_alphanumeric());
    words
        .filter_map(|word| word.strip_prefix("freiburg").or_else(|| word.strip_prefix("fr")))
        .find_map(|rest| match rest {
            "1" => Some(1),
            "2" => Some(2),
            "3" => Some(3),
            _ => None,
        })
}

#[cfg(test)]
mod tests {
    use super::freiburg_number;

    #[test]
    fn sequences_are_recognised_by_name() {
        assert_eq!(freiburg_number("rgbd_dataset_freiburg1_desk"), Some(1));
        assert_eq!(freiburg_number("tum_fr2_xyz"), Some(2));
        assert_eq!(freiburg_number("fr3"), Some(3));
        assert_eq!(freiburg_number("fr4"), None);
        assert_eq!(freiburg_number("fr12"), None);
        assert_eq!(freiburg_number("offr1"), None);
    }
}

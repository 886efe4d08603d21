//! Trajectories in the TUM format: `timestamp tx ty tz qx qy qz qw`, one pose a line.

use crate::DatasetError;
use crate::lists::{data_lines, number, read_text};
use i2slam_geometry::{Pose, Rotation, StampedPose, Trajectory, Vec3};
use std::fmt::Write;
use std::path::Path;

/// How far the length of a quaternion that was written with few digits may be from 1.
pub(crate) const UNIT_TOLERANCE: f64 = 0.01;

const COLUMNS: [&str; 8] = ["time stamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw"];

/// Reads `world_from_camera` poses [s, m] in the TUM format, sorted by time.
///
/// `#` starts a comment line. A number that is not finite, a wrong count of columns or a zero
/// quaternion is an error that names file and line; so is a file without a pose.
pub fn read_trajectory(path: impl AsRef<Path>) -> Result<Trajectory, DatasetError> {
    read(path.as_ref(), f64::INFINITY)
}

/// The same, but a quaternion whose length is not 1 is an error.
pub(crate) fn read_unit_trajectory(path: &Path) -> Result<Trajectory, DatasetError> {
    read(path, UNIT_TOLERANCE)
}

fn read(path: &Path, tolerance: f64) -> Result<Trajectory, DatasetError> {
    let text = read_text(path)?;
    let mut trajectory = data_lines(&text)
        .map(|(line, content)| read_pose(path, line, content, tolerance))
        .collect::<Result<Trajectory, _>>()?;
    if trajectory.is_empty() {
        let expected = "lines with timestamp tx ty tz qx qy qz qw";
        return Err(DatasetError::Empty { path: path.to_path_buf(), expected });
    }
    trajectory.sort_by(|a, b| a.timestamp.total_cmp(&b.timestamp));
    Ok(trajectory)
}

fn read_pose(
    path: &Path,
    line: usize,
    content: &str,
    tolerance: f64,
) -> Result<StampedPose, DatasetError> {
    let columns: Vec<&str> = content.split_whitespace().collect();
    if columns.len() != COLUMNS.len() {
        let reason = format!(
            "{} columns, expected 8: timestamp tx ty tz qx qy qz qw, parted by spaces",
            columns.len()
        );
        return Err(DatasetError::line(path, line, reason));
    }
    let mut v = [0.0; 8];
    for ((value, text), name) in v.iter_mut().zip(columns).zip(COLUMNS) {
        *value = number(path, line, name, text)?;
    }
    let [timestamp, tx, ty, tz, qx, qy, qz, qw] = v;
    let rotation = Rotation::from_wxyz(qw, qx, qy, qz).ok_or_else(|| {
        DatasetError::line(path, line, "the quaternion is zero, expected one of length 1")
    })?;
    if let Some(reason) = not_unit([qw, qx, qy, qz], tolerance) {
        return Err(DatasetError::line(path, line, reason));
    }
    let world_from_camera = Pose::new(rotation, Vec3::new(tx, ty, tz));
    Ok(StampedPose { timestamp, world_from_camera })
}

/// What is wrong with a quaternion whose length is farther than `tolerance` from 1.
pub(crate) fn not_unit(quaternion: [f64; 4], tolerance: f64) -> Option<String> {
    let length = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
    ((length - 1.0).abs() > tolerance).then(|| {
        format!(
            "the quaternion has length {length:.3}, expected 1 within {tolerance}: are the columns \
             in order, and is it normalised?"
        )
    })
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
    std::fs::write(path, text).map_err(|e| DatasetError::write(path, e))
}

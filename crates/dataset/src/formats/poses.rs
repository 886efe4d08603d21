//! Poses as 4x4 matrices or quaternions.

use crate::DatasetError;
use crate::text::{data_lines, read_text};
use i2slam_geometry::{Mat3, Pose, Rotation, Vec3};
use std::path::Path;

/// Largest deviation of an entry of `RᵀR` from the identity: rounding errors of text files.
const ROTATION_TOLERANCE: f64 = 1e-2;

/// Accepted deviation of a quaternion's length from 1: rounding of numbers written with few digits.
pub(super) const UNIT_TOLERANCE: f64 = 0.01;

/// Error message for a quaternion whose length differs from 1 by more than `tolerance`.
pub(super) fn unit_length_error(quaternion: [f64; 4], tolerance: f64) -> Option<String> {
    let length = quaternion.iter().map(|v| v * v).sum::<f64>().sqrt();
    ((length - 1.0).abs() > tolerance).then(|| {
        format!(
            "the quaternion has length {length:.3}, expected 1 within {tolerance}: are the columns \
             in order, and is it normalised?"
        )
    })
}

/// Pose of a quaternion w x y z and a translation; an error message unless finite and normalised.
pub(super) fn pose_from_wxyz(q: [f64; 4], t: [f64; 3]) -> Result<Pose<f64>, String> {
    if let Some(reason) = unit_length_error(q, UNIT_TOLERANCE) {
        return Err(reason);
    }
    let rotation = Rotation::from_wxyz(q[0], q[1], q[2], q[3]).ok_or("the quaternion is zero")?;
    Ok(Pose::new(rotation, Vec3::from_array(t)))
}

/// Pose of a row-major 4x4 matrix `world_from_camera`; `None` unless finite and rigid. Datasets
/// mark frames without a pose by infinities or zeros.
pub(super) fn pose_from_matrix(m: &[f64; 16]) -> Option<Pose<f64>> {
    let row = |i: usize| [m[4 * i], m[4 * i + 1], m[4 * i + 2]];
    let rows = [row(0), row(1), row(2)];
    let rotation = Mat3 { rows };
    let gram = rotation.transpose() * rotation;
    let off = |i: usize, j: usize| gram.rows[i][j] - f64::from(u8::from(i == j));
    let orthogonal = (0..9).all(|k| off(k / 3, k % 3).abs() <= ROTATION_TOLERANCE);
    let [x, y, z] = rows.map(|r| Vec3::new(r[0], r[1], r[2]));
    let translation = Vec3::new(m[3], m[7], m[11]);
    let proper = x.cross(y).dot(z) > 0.0;
    let pose = Pose::new(Rotation::from_matrix(&rotation).normalized(), translation);
    (orthogonal && proper && pose.is_finite()).then_some(pose)
}

/// Parses 16 numbers; infinities and NaN in the spelling of C runtimes are allowed.
pub(super) fn parse_matrix(text: &str) -> Option<[f64; 16]> {
    let numbers: Option<Vec<f64>> = text.split_whitespace().map(parse_entry).collect();
    numbers?.try_into().ok()
}

/// Parses a number; NaN for spellings of C runtimes such as `-1.#INF` and `nan(ind)`.
fn parse_entry(word: &str) -> Option<f64> {
    let odd = word.contains('#') || word.to_ascii_lowercase().contains("nan");
    if odd { Some(f64::NAN) } else { word.parse().ok() }
}

/// Reads a file with one matrix; `None` if it cannot be parsed.
pub(super) fn read_matrix(path: &Path) -> Option<[f64; 16]> {
    parse_matrix(&read_text(path).ok()?)
}

/// Reads a file with the matrix of a pose; `None` unless it is finite and rigid.
pub(super) fn read_pose(path: &Path) -> Option<Pose<f64>> {
    pose_from_matrix(&read_matrix(path)?)
}

/// Reads one matrix per line, as in Replica's `traj.txt`; `None` for matrices that are no pose.
pub(super) fn read_matrix_lines(path: &Path) -> Result<Vec<Option<Pose<f64>>>, DatasetError> {
    let text = read_text(path)?;
    data_lines(&text)
        .map(|(line, content)| match parse_matrix(content) {
            Some(matrix) => Ok(pose_from_matrix(&matrix)),
            None => {
                let reason = "expected the 16 numbers of a matrix world_from_camera";
                Err(DatasetError::line(path, line, reason))
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_that_are_not_rigid_give_no_pose() {
        let cases = [
            "-inf ".repeat(16),
            "-1.#INF ".repeat(16),
            "0 ".repeat(16),
            "1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1".into(),
            "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1".into(),
            "1 0 0 nan 0 1 0 0 0 0 1 0 0 0 0 1".into(),
        ];
        for text in cases {
            assert_eq!(pose_from_matrix(&parse_matrix(&text).expect("16 numbers")), None, "{text}");
        }
        assert!(parse_matrix("1 2 3").is_none());
        assert!(parse_matrix(&"x ".repeat(16)).is_none());
    }
}

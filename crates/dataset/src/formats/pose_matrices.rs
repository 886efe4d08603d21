//! Poses written as matrices: one file a frame, or one line a frame.

use super::counted;
use crate::DatasetError;
use crate::lists::{data_lines, read_text};
use i2slam_geometry::{Mat3, Pose, Rotation, StampedPose, Vec3};
use std::path::Path;

/// Largest deviation of `RᵀR` from the identity that still is a rotation with rounding errors.
const ROTATION_TOLERANCE: f64 = 1e-2;

/// The pose of a 4x4 matrix `world_from_camera` in rows; `None` unless it is finite and rigid.
/// Sequences mark frames without a pose by infinities or zeros.
pub(crate) fn rigid(m: &[f64; 16]) -> Option<Pose<f64>> {
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

/// 16 numbers of a text; infinities and what other programs write for them are allowed.
pub(crate) fn sixteen(text: &str) -> Option<[f64; 16]> {
    let numbers: Option<Vec<f64>> = text.split_whitespace().map(number).collect();
    numbers?.try_into().ok()
}

/// A number, or one of the words of C runtimes for no number (`-1.#INF`, `nan(ind)`).
fn number(word: &str) -> Option<f64> {
    let odd = word.contains('#') || word.to_ascii_lowercase().contains("nan");
    if odd { Some(f64::NAN) } else { word.parse().ok() }
}

/// The matrix in a file of its own; `None` if it cannot be read as one.
pub(crate) fn read_matrix(path: &Path) -> Option<[f64; 16]> {
    sixteen(&std::fs::read_to_string(path).ok()?)
}

/// One matrix a line, as `traj.txt` of Replica; lines that are no pose give `None`.
pub(crate) fn read_lines(path: &Path) -> Result<Vec<Option<Pose<f64>>>, DatasetError> {
    let text = read_text(path)?;
    data_lines(&text)
        .map(|(line, content)| match sixteen(content) {
            Some(matrix) => Ok(rigid(&matrix)),
            None => {
                let reason = "expected the 16 numbers of a matrix world_from_camera";
                Err(DatasetError::line(path, line, reason))
            }
        })
        .collect()
}

/// The poses that are there, at the times of their frames, and a warning about the others.
pub(crate) fn stamped(
    poses: impl Iterator<Item = (f64, Option<Pose<f64>>)>,
) -> (Vec<StampedPose>, Option<String>) {
    let (mut found, mut missing) = (Vec::new(), 0);
    for (timestamp, pose) in poses {
        match pose {
            Some(world_from_camera) => found.push(StampedPose { timestamp, world_from_camera }),
            None => missing += 1,
        }
    }
    let warning = (missing > 0 && !found.is_empty())
        .then(|| format!("{} without a finite, rigid true pose", counted(missing, "frame")));
    (found, warning)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn matrices_become_poses() {
        let quarter_turn = "0 -1 0 1\n1 0 0 2\n0 0 1 3\n0 0 0 1\n";
        let pose = rigid(&sixteen(quarter_turn).expect("16 numbers")).expect("a pose");
        assert_eq!(pose.translation, Vec3::new(1.0, 2.0, 3.0));
        let seen = pose.rotation.rotate(Vec3::new(1.0, 0.0, 0.0));
        assert!((seen - Vec3::new(0.0, 1.0, 0.0)).norm() < 1e-12);
    }

    #[test]
    fn no_pose_is_made_of_what_is_none() {
        let cases = [
            "-inf ".repeat(16),
            "-1.#INF ".repeat(16),
            "0 ".repeat(16),
            "1 0 0 0 0 1 0 0 0 0 -1 0 0 0 0 1".into(),
            "2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1".into(),
            "1 0 0 nan 0 1 0 0 0 0 1 0 0 0 0 1".into(),
        ];
        for text in cases {
            assert_eq!(rigid(&sixteen(&text).expect("16 numbers")), None, "{text}");
        }
        assert!(sixteen("1 2 3").is_none());
        assert!(sixteen(&"x ".repeat(16)).is_none());
    }
}

//! Poses, time stamps and the camera.

use super::arrays::Arrays;
use crate::DatasetError;
use crate::checks::is_central;
use crate::import::npy::Array;
use crate::trajectory_file::{UNIT_TOLERANCE, not_unit};
use i2slam_geometry::{Camera, Pose, Rotation, Vec3};

const POSES: [&str; 3] = ["poses", "cam0_poses", "cam0_T_world"];
const INTRINSICS: [&str; 2] = ["intrinsics", "cam0_intrinsics"];
pub(super) const STAMPS: [&str; 3] = ["tstamps", "timestamps", "cam0_timestamps"];

/// DROID-SLAM's features, and with them its intrinsics, have an eighth of the size.
const REDUCED: f64 = 8.0;

/// The array of the poses, of which there is at least one.
pub(super) fn pose_numbers(arrays: &Arrays) -> Result<Array, DatasetError> {
    let array = arrays.find(&POSES)?.ok_or_else(|| arrays.missing(&POSES))?;
    let &[frames, 7] = array.shape.as_slice() else {
        let reason = format!(
            "shape {:?}, expected [frames, 7]: tx ty tz qx qy qz qw, camera_from_world",
            array.shape
        );
        return Err(DatasetError::metadata(&array.path, reason));
    };
    if frames == 0 {
        return Err(DatasetError::Empty { path: array.path, expected: "poses of keyframes" });
    }
    Ok(array)
}

/// The poses at some places, with these.
pub(super) fn read_poses(
    array: &Array,
    records: &[usize],
) -> Result<Vec<(usize, Pose<f64>)>, DatasetError> {
    let numbers = array.all()?;
    let poses = records.iter().map(|&frame| {
        let v = &numbers[7 * frame..7 * frame + 7];
        let refuse = |reason: String| {
            DatasetError::metadata(&array.path, format!("frame {frame}: {reason}"))
        };
        if v.iter().any(|v| !v.is_finite()) {
            return Err(refuse(format!("the pose {v:?} is not finite, expected seven numbers")));
        }
        let (t, q) = (Vec3::new(v[0], v[1], v[2]), [v[6], v[3], v[4], v[5]]);
        if let Some(reason) = not_unit(q, UNIT_TOLERANCE) {
            return Err(refuse(reason));
        }
        let rotation = Rotation::from_wxyz(q[0], q[1], q[2], q[3]);
        let rotation = rotation.ok_or_else(|| refuse("the quaternion is zero".into()))?;
        Ok((frame, Pose::new(rotation, t).inverse()))
    });
    poses.collect()
}

/// Time stamps as written: seconds, or frames counted.
#[derive(Clone, Debug)]
pub(super) enum Stamps {
    Seconds(Vec<f64>),
    Frames(Vec<usize>),
}

impl Stamps {
    /// As they are written.
    pub(super) fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Seconds(times) => times.clone(),
            Self::Frames(counts) => counts.iter().map(|&count| count as f64).collect(),
        }
    }
}

pub(super) fn read_stamps(arrays: &Arrays, frames: usize) -> Result<Option<Stamps>, DatasetError> {
    let array =
        arrays.find_shaped(&STAMPS, frames, "1", |rest| rest.iter().all(|&side| side == 1))?;
    let Some(array) = array else { return Ok(None) };
    let stamps = array.all()?;
    if let Some(frame) = stamps.iter().position(|stamp| !stamp.is_finite()) {
        let reason = format!("frame {frame}: time stamp {}, expected a number", stamps[frame]);
        return Err(DatasetError::metadata(&array.path, reason));
    }
    // A video has no whole seconds between all frames, and no 10⁹ frames.
    let counts = stamps.iter().all(|&s| s.fract() == 0.0 && (0.0..1e9).contains(&s));
    Ok(Some(match counts {
        true => Stamps::Frames(stamps.iter().map(|&s| s as usize).collect()),
        false => Stamps::Seconds(stamps),
    }))
}

/// The camera of arrays of a size. Intrinsics of another one are recognised by the principal
/// point, which lies in the middle half of a picture.
pub(super) fn camera_of(
    arrays: &Arrays,
    frames: usize,
    (width, height): (usize, usize),
) -> Result<Camera<f64>, DatasetError> {
    let array = arrays.find(&INTRINSICS)?.ok_or_else(|| arrays.missing(&INTRINSICS))?;
    let refuse = |reason: String| DatasetError::metadata(&array.path, reason);
    if array.shape != [4] && array.shape != [frames, 4] {
        let shape = &array.shape;
        return Err(refuse(format!("shape {shape:?}, expected [{frames}, 4]: fx fy cx cy")));
    }
    let all = array.all()?;
    let k = [all[0], all[1], all[2], all[3]];
    if k.iter().any(|v| !v.is_finite()) || k[0] <= 0.0 || k[1] <= 0.0 {
        return Err(refuse(format!("{k:?}, expected finite fx fy cx cy with fx, fy above 0")));
    }
    let camera = |scale: f64| {
        let [fx, fy, cx, cy] = k.map(|v| scale * v);
        Camera { width, height, fx, fy, cx: cx + 0.5, cy: cy + 0.5 }
    };
    let scales = [1.0, REDUCED, REDUCED.recip()];
    scales.into_iter().map(camera).find(is_central).ok_or_else(|| {
        refuse(format!(
            "{k:?}: the principal point does not lie in the middle of {width}x{height} pixels, nor \
             at 8 times or an eighth of the size"
        ))
    })
}

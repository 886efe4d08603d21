//! Arrays of DROID-SLAM and NeRF-SLAM: poses, time stamps and intrinsics, each a `.npy` file of a
//! folder or a member of an `.npz`.
//!
//! Poses are seven numbers `camera_from_world`: tx ty tz qx qy qz qw. Intrinsics fx fy cx cy have
//! pixel centres at integers, and those of DROID-SLAM count pixels of an eighth of the size.

use super::npy::NpyArray;
use super::npz::NpzArchive;
use super::poses::pose_from_wxyz;
use crate::DatasetError;
use crate::camera::has_central_principal_point;
use crate::text::list_names;
use i2slam_geometry::{Camera, Pose};
use std::path::{Path, PathBuf};

/// Names of the array of poses.
const POSE_NAMES: [&str; 3] = ["poses", "cam0_poses", "cam0_T_world"];
/// Names of the array of intrinsics.
const INTRINSICS_NAMES: [&str; 2] = ["intrinsics", "cam0_intrinsics"];
/// Names of the array of time stamps.
pub(crate) const TIMESTAMP_NAMES: [&str; 3] = ["tstamps", "timestamps", "cam0_timestamps"];

/// DROID-SLAM's intrinsics are those of its feature maps, an eighth of the image size.
const FEATURE_STRIDE: f64 = 8.0;

/// Opens the array of poses, at least one.
pub(crate) fn open_poses(arrays: &Arrays) -> Result<NpyArray, DatasetError> {
    let array = arrays.find(&POSE_NAMES)?.ok_or_else(|| arrays.missing(&POSE_NAMES))?;
    let &[frames, 7] = array.shape.as_slice() else {
        let reason = format!(
            "shape {:?}, expected [frames, 7]: tx ty tz qx qy qz qw, camera_from_world",
            array.shape
        );
        return Err(DatasetError::file(&array.path, reason));
    };
    if frames == 0 {
        return Err(DatasetError::empty(&array.path, "poses of keyframes"));
    }
    Ok(array)
}

/// Reads the poses `world_from_camera` at some indices, with these indices.
pub(crate) fn read_poses(
    array: &NpyArray,
    records: &[usize],
) -> Result<Vec<(usize, Pose<f64>)>, DatasetError> {
    let numbers = array.all()?;
    let poses = records.iter().map(|&frame| {
        let v = &numbers[7 * frame..7 * frame + 7];
        let refuse =
            |reason: String| DatasetError::file(&array.path, format!("frame {frame}: {reason}"));
        if v.iter().any(|v| !v.is_finite()) {
            return Err(refuse(format!("the pose {v:?} is not finite, expected seven numbers")));
        }
        let pose = pose_from_wxyz([v[6], v[3], v[4], v[5]], [v[0], v[1], v[2]]);
        Ok((frame, pose.map_err(refuse)?.inverse()))
    });
    poses.collect()
}

/// Time stamps as written: seconds, or frame numbers.
#[derive(Clone, Debug)]
pub(crate) enum Timestamps {
    Seconds(Vec<f64>),
    Frames(Vec<usize>),
}

impl Timestamps {
    /// The stamps as numbers, whatever their unit.
    pub(crate) fn numbers(&self) -> Vec<f64> {
        match self {
            Self::Seconds(times) => times.clone(),
            Self::Frames(counts) => counts.iter().map(|&count| count as f64).collect(),
        }
    }
}

/// Reads the time stamps, if there are any.
pub(crate) fn read_timestamps(
    arrays: &Arrays,
    frames: usize,
) -> Result<Option<Timestamps>, DatasetError> {
    let array = arrays
        .find_shaped(&TIMESTAMP_NAMES, frames, "1", |rest| rest.iter().all(|&side| side == 1))?;
    let Some(array) = array else { return Ok(None) };
    let stamps = array.all()?;
    if let Some(frame) = stamps.iter().position(|stamp| !stamp.is_finite()) {
        let reason = format!("frame {frame}: time stamp {}, expected a number", stamps[frame]);
        return Err(DatasetError::file(&array.path, reason));
    }
    // Stamps in seconds are not all whole, and Unix times in nanoseconds are no frame numbers.
    let counts = stamps.iter().all(|&s| s.fract() == 0.0 && (0.0..1e9).contains(&s));
    Ok(Some(match counts {
        true => Timestamps::Frames(stamps.iter().map(|&s| s as usize).collect()),
        false => Timestamps::Seconds(stamps),
    }))
}

/// Reads the camera of arrays of a size. Intrinsics of another size are recognised by the principal
/// point, which must lie in the middle half of the image.
pub(crate) fn read_camera(
    arrays: &Arrays,
    frames: usize,
    (width, height): (usize, usize),
) -> Result<Camera<f64>, DatasetError> {
    let array = arrays.find(&INTRINSICS_NAMES)?.ok_or_else(|| arrays.missing(&INTRINSICS_NAMES))?;
    let refuse = |reason: String| DatasetError::file(&array.path, reason);
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
    let scales = [1.0, FEATURE_STRIDE, FEATURE_STRIDE.recip()];
    scales.into_iter().map(camera).find(has_central_principal_point).ok_or_else(|| {
        refuse(format!(
            "{k:?}: the principal point does not lie in the middle of {width}x{height} pixels, nor \
             at 8 times or an eighth of the size"
        ))
    })
}

/// Named arrays of a folder or an archive.
pub(crate) enum Arrays {
    Folder(PathBuf),
    Archive(PathBuf, NpzArchive),
}

impl Arrays {
    /// Opens a folder of `.npy` files or an `.npz` archive.
    pub(crate) fn open(path: &Path) -> Result<Self, DatasetError> {
        if path.is_dir() {
            return Ok(Self::Folder(path.to_path_buf()));
        }
        Ok(Self::Archive(path.to_path_buf(), NpzArchive::open(path)?))
    }

    /// The folder or the archive.
    pub(crate) fn path(&self) -> &Path {
        match self {
            Self::Folder(path) | Self::Archive(path, _) => path,
        }
    }

    /// Opens the first array that exists of some names.
    pub(crate) fn find(&self, names: &[&str]) -> Result<Option<NpyArray>, DatasetError> {
        let array = |name: &&str| match self {
            Self::Folder(folder) => {
                let file = folder.join(format!("{name}.npy"));
                file.is_file().then(|| NpyArray::open(&file))
            }
            Self::Archive(_, archive) => archive.array(name),
        };
        names.iter().find_map(array).transpose()
    }

    /// As [`find`](Self::find); an error unless the shape is `[frames, ..]` with a tail that `fits`.
    pub(crate) fn find_shaped(
        &self,
        names: &[&str],
        frames: usize,
        expected: &str,
        fits: impl Fn(&[usize]) -> bool,
    ) -> Result<Option<NpyArray>, DatasetError> {
        let Some(array) = self.find(names)? else { return Ok(None) };
        if array.shape.first() == Some(&frames) && fits(&array.shape[1..]) {
            return Ok(Some(array));
        }
        let reason = format!("shape {:?}, expected [{frames}, {expected}]", array.shape);
        Err(DatasetError::file(&array.path, reason))
    }

    /// The error for missing arrays.
    pub(crate) fn missing(&self, names: &[&str]) -> DatasetError {
        let found = match self {
            Self::Folder(folder) => list_names(folder),
            Self::Archive(_, archive) => archive.names().join(", "),
        };
        let reason = format!("no array {}; found {found}", names.join(" or "));
        DatasetError::file(self.path(), reason)
    }
}

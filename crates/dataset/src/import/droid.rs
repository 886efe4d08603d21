//! What DROID-SLAM and NeRF-SLAM keep of their keyframes: arrays of poses, inverse depths,
//! pictures, intrinsics and time stamps, each a `.npy` file of a folder or a member of an `.npz`.
//!
//! Poses are seven numbers `camera_from_world`: tx ty tz qx qy qz qw. Intrinsics fx fy cx cy have
//! pixel centres at integers, and those of DROID-SLAM count pixels of an eighth of the size.

use super::archive::Archive;
use super::inverse_depth::{InverseDepth, Variance};
use super::keyframe::{DepthSource, KeyframePose, Pictures, Source};
use super::npy::{Array, Element};
use super::pictures::ArrayPictures;
use super::placed::{Found, LeftOut, by_index, by_time, open_pictures};
use super::{Depth, Kind, Options};
use crate::trajectory_file::{UNIT_TOLERANCE, not_unit};
use crate::{DatasetError, Sequence};
use i2slam_geometry::{Camera, Pose, Rotation, StampedPose, Vec3};
use std::path::{Path, PathBuf};

const POSES: [&str; 3] = ["poses", "cam0_poses", "cam0_T_world"];
const INVERSE_DEPTHS: [&str; 6] =
    ["disps_up", "cam0_idepths_up", "idepths_up", "disps", "cam0_idepths", "idepths"];
const DEPTHS: [&str; 1] = ["depths"];
const DEPTH_VARIANCES: [&str; 4] =
    ["cam0_depths_cov_up", "depths_cov_up", "cam0_depths_cov", "depths_cov"];
const INVERSE_VARIANCES: [&str; 6] = [
    "cam0_idepths_cov_up",
    "idepths_cov_up",
    "disps_cov_up",
    "cam0_idepths_cov",
    "idepths_cov",
    "disps_cov",
];
const IMAGES: [&str; 2] = ["images", "cam0_images"];
const INTRINSICS: [&str; 2] = ["intrinsics", "cam0_intrinsics"];
const STAMPS: [&str; 3] = ["tstamps", "timestamps", "cam0_timestamps"];

/// DROID-SLAM's features, and with them its intrinsics, have an eighth of the size.
const REDUCED: f64 = 8.0;

/// Frames a second of stamps that count frames.
const FRAME_RATE: f64 = 30.0;

/// Arrays by their names.
pub(super) enum Arrays {
    Folder(PathBuf),
    Archive(PathBuf, Archive),
}

impl Arrays {
    pub(super) fn open(path: &Path) -> Result<Self, DatasetError> {
        if path.is_dir() {
            return Ok(Self::Folder(path.to_path_buf()));
        }
        Ok(Self::Archive(path.to_path_buf(), Archive::open(path)?))
    }

    fn path(&self) -> &Path {
        match self {
            Self::Folder(path) | Self::Archive(path, _) => path,
        }
    }

    /// The first array of some names that is there.
    fn find(&self, names: &[&str]) -> Result<Option<Array>, DatasetError> {
        let array = |name: &&str| match self {
            Self::Folder(folder) => {
                let file = folder.join(format!("{name}.npy"));
                file.is_file().then(|| Array::open(&file))
            }
            Self::Archive(_, archive) => archive.array(name),
        };
        names.iter().find_map(array).transpose()
    }

    /// The same, if it has `frames` places of the given size each.
    fn find_shaped(
        &self,
        names: &[&str],
        frames: usize,
        expected: &str,
        fits: impl Fn(&[usize]) -> bool,
    ) -> Result<Option<Array>, DatasetError> {
        let Some(array) = self.find(names)? else { return Ok(None) };
        if array.shape.first() == Some(&frames) && fits(&array.shape[1..]) {
            return Ok(Some(array));
        }
        let reason = format!("shape {:?}, expected [{frames}, {expected}]", array.shape);
        Err(DatasetError::metadata(&array.path, reason))
    }

    fn missing(&self, names: &[&str]) -> DatasetError {
        let found = match self {
            Self::Folder(folder) => crate::layouts::contents(folder),
            Self::Archive(_, archive) => archive.names().join(", "),
        };
        let reason = format!("no array {}; found {found}", names.join(" or "));
        DatasetError::metadata(self.path(), reason)
    }
}

/// Opens the arrays, with the pictures of a sequence or their own.
pub(super) fn open(
    path: &Path,
    pictures: Option<&Path>,
    options: &Options,
) -> Result<Found, DatasetError> {
    let arrays = Arrays::open(path)?;
    let poses = read_poses(&arrays)?;
    let frames = poses.len();
    let stamps = read_stamps(&arrays, frames)?;
    let depth = read_depth(&arrays, frames, options)?;
    let mut warnings = Vec::new();
    let (keyframes, left_out, source);
    if let Some(folder) = pictures {
        let stamps = stamps.ok_or_else(|| arrays.missing(&STAMPS))?;
        let sequence = open_pictures(folder, options, options.depth == Depth::Pictures)?;
        warnings.extend(sequence.warnings.iter().cloned());
        (keyframes, left_out) = join(&poses, &stamps, &sequence, options, &mut warnings);
        source = Source { pictures: Pictures::Sequence(Box::new(sequence)), depth };
    } else {
        (keyframes, left_out) = alone(&poses, stamps.as_ref());
        let images = read_images(&arrays, frames, options)?;
        source = Source { pictures: Pictures::Arrays(Box::new(images)), depth };
    }
    let path = path.to_path_buf();
    Ok(Found { kind: Kind::Droid, path, source, keyframes, left_out, warnings })
}

fn read_poses(arrays: &Arrays) -> Result<Vec<Pose<f64>>, DatasetError> {
    let array = arrays.find(&POSES)?.ok_or_else(|| arrays.missing(&POSES))?;
    let &[_, 7] = array.shape.as_slice() else {
        let reason = format!(
            "shape {:?}, expected [frames, 7]: tx ty tz qx qy qz qw, camera_from_world",
            array.shape
        );
        return Err(DatasetError::metadata(&array.path, reason));
    };
    let numbers = array.all()?;
    let poses = numbers.chunks_exact(7).enumerate().map(|(frame, v)| {
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
        Ok(Pose::new(rotation, t).inverse())
    });
    poses.collect()
}

/// Time stamps as written: seconds, or frames counted.
#[derive(Clone, Debug)]
enum Stamps {
    Seconds(Vec<f64>),
    Frames(Vec<usize>),
}

fn read_stamps(arrays: &Arrays, frames: usize) -> Result<Option<Stamps>, DatasetError> {
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

/// Poses with the pictures of a sequence.
fn join(
    poses: &[Pose<f64>],
    stamps: &Stamps,
    sequence: &Sequence,
    options: &Options,
    warnings: &mut Vec<String>,
) -> (Vec<KeyframePose>, LeftOut) {
    match stamps {
        Stamps::Frames(counts) => {
            let indices = counts.iter().map(|count| count * options.frames_per_stamp.max(1));
            let poses = indices.zip(poses.iter().copied()).enumerate();
            let poses = poses.map(|(record, (index, pose))| (record, index, pose));
            by_index(poses.collect(), sequence, warnings)
        }
        Stamps::Seconds(times) => {
            let stamped = poses.iter().zip(times).map(|(&world_from_camera, &timestamp)| {
                StampedPose { timestamp, world_from_camera }
            });
            by_time(&stamped.collect::<Vec<_>>(), sequence, options, warnings)
        }
    }
}

/// Poses with pictures of the same arrays, in order of time.
fn alone(poses: &[Pose<f64>], stamps: Option<&Stamps>) -> (Vec<KeyframePose>, LeftOut) {
    let index = |record: usize| match stamps {
        Some(Stamps::Frames(counts)) => counts[record],
        _ => record,
    };
    let time = |record: usize| match stamps {
        Some(Stamps::Seconds(times)) => times[record],
        _ => index(record) as f64 / FRAME_RATE,
    };
    let keyframe = |(record, &world_from_camera): (usize, &Pose<f64>)| KeyframePose {
        index: index(record),
        timestamp: time(record),
        world_from_camera,
        position: record,
        record,
    };
    let mut keyframes: Vec<KeyframePose> = poses.iter().enumerate().map(keyframe).collect();
    keyframes.sort_by(|a, b| a.timestamp.total_cmp(&b.timestamp));
    let reason = "the files hold no more".to_owned();
    let left_out = LeftOut { with_picture: poses.len(), reason, ..LeftOut::default() };
    (keyframes, left_out)
}

fn read_images(
    arrays: &Arrays,
    frames: usize,
    options: &Options,
) -> Result<ArrayPictures, DatasetError> {
    let planes = |rest: &[usize]| matches!(rest, [3, _, _] | [_, _, 3]);
    let images = arrays.find_shaped(&IMAGES, frames, "3, height, width", planes)?;
    let images = images.ok_or_else(|| arrays.missing(&IMAGES))?;
    if images.element != Element::U8 {
        let reason = format!("pictures of type {:?}, expected U8 (0 to 255)", images.element);
        return Err(DatasetError::metadata(&images.path, reason));
    }
    let size = match images.shape[1..] {
        [3, height, width] | [height, width, 3] => (width, height),
        _ => (0, 0),
    };
    let camera = camera_of(arrays, frames, size)?;
    let source = arrays.path().display().to_string();
    ArrayPictures::new(images, camera, source, FRAME_RATE, options)
}

fn read_depth(
    arrays: &Arrays,
    frames: usize,
    options: &Options,
) -> Result<DepthSource, DatasetError> {
    match options.depth {
        Depth::None => return Ok(DepthSource::None),
        Depth::Pictures => return DepthSource::pictures(options),
        Depth::Imported => {}
    }
    let planar = |rest: &[usize]| rest.len() == 2;
    let inverse = arrays.find_shaped(&INVERSE_DEPTHS, frames, "height, width", planar)?;
    let (values, is_inverse) = match inverse {
        Some(values) => (values, true),
        None => match arrays.find_shaped(&DEPTHS, frames, "height, width", planar)? {
            Some(values) => (values, false),
            None => return Ok(DepthSource::None),
        },
    };
    let (height, width) = (values.shape[1], values.shape[2]);
    let expected = format!("{height}, {width}");
    let same = |rest: &[usize]| rest == [height, width];
    let of_depth = arrays.find_shaped(&DEPTH_VARIANCES, frames, &expected, same);
    let variance = match of_depth? {
        Some(array) => Some((array, Variance::OfDepth)),
        None => arrays
            .find_shaped(&INVERSE_VARIANCES, frames, &expected, same)?
            .map(|array| (array, Variance::OfInverse)),
    };
    let camera = camera_of(arrays, frames, (width, height))?;
    let max_depth = options.open.max_depth.unwrap_or(f64::INFINITY);
    let depth = InverseDepth { values, is_inverse, variance, camera, max_depth };
    Ok(DepthSource::Inverse(Box::new(depth)))
}

/// The camera of arrays of a size. Intrinsics of another one are recognised by the principal
/// point, which lies in the middle half of a picture.
fn camera_of(
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
    let central = |scale: f64| {
        let middle = |c: f64, side: usize| (0.25..0.75).contains(&(scale * c / side as f64));
        middle(k[2], width) && middle(k[3], height)
    };
    let scales = [1.0, REDUCED, REDUCED.recip()];
    let scale = scales.into_iter().find(|&scale| central(scale)).ok_or_else(|| {
        refuse(format!(
            "{k:?}: the principal point does not lie in the middle of {width}x{height} pixels, nor \
             at 8 times or an eighth of the size"
        ))
    })?;
    let [fx, fy, cx, cy] = k.map(|v| scale * v);
    Ok(Camera { width, height, fx, fy, cx: cx + 0.5, cy: cy + 0.5 })
}

//! Inverse depth and its variance.

use super::arrays::Arrays;
use super::numbers::camera_of;
use crate::DatasetError;
use crate::import::inverse_depth::{InverseDepth, Variance};
use crate::import::keyframe::DepthSource;
use crate::import::npy::Array;
use crate::import::{Depth, Options};

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

/// The maps of depth that the options ask for.
pub(super) fn read_depth(
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
    let maps = |names: &[&str]| arrays.find_shaped(names, frames, "height, width", planar);
    let (values, is_inverse) = match maps(&INVERSE_DEPTHS)? {
        Some(values) => (values, true),
        None => match maps(&DEPTHS)? {
            Some(values) => (values, false),
            None => return Ok(DepthSource::None),
        },
    };
    let size = (values.shape[2], values.shape[1]);
    let variance = read_variance(arrays, frames, size)?;
    let camera = camera_of(arrays, frames, size)?;
    let max_depth = options.open.max_depth.unwrap_or(f64::INFINITY);
    let depth = InverseDepth { values, is_inverse, variance, camera, max_depth };
    Ok(DepthSource::Inverse(Box::new(depth)))
}

fn read_variance(
    arrays: &Arrays,
    frames: usize,
    (width, height): (usize, usize),
) -> Result<Option<(Array, Variance)>, DatasetError> {
    let expected = format!("{height}, {width}");
    let same = |rest: &[usize]| rest == [height, width];
    let maps = |names: &[&str]| arrays.find_shaped(names, frames, &expected, same);
    if let Some(array) = maps(&DEPTH_VARIANCES)? {
        return Ok(Some((array, Variance::OfDepth)));
    }
    Ok(maps(&INVERSE_VARIANCES)?.map(|array| (array, Variance::OfInverse)))
}

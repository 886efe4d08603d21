//! Which truth an evaluation rests on, so that its figures can be made again.

use super::reference::Reference;
use super::subject::Subject;
use crate::arguments::Eval;
use crate::failure::Failure;
use i2slam::geometry::{Image, StampedPose};
use i2slam_result::Input;
use i2slam_result::report::TruthSource;
use std::path::{Path, PathBuf};

/// The true trajectory: a file, or the dataset that has it.
pub(super) fn of_trajectory(
    arguments: &Eval,
    reference: Option<&Reference>,
    truth: &[StampedPose],
) -> Option<TruthSource> {
    let path = arguments.groundtruth.as_deref().or(reference.map(Reference::path))?;
    let mut sum = crc32fast::Hasher::new();
    for pose in truth {
        let (q, t) = (pose.world_from_camera.rotation, pose.world_from_camera.translation);
        let numbers = [pose.timestamp, t.x, t.y, t.z, q.w, q.v.x, q.v.y, q.v.z];
        numbers.iter().for_each(|number| sum.update(&number.to_le_bytes()));
    }
    Some(source(path, truth.len(), sum.finalize()))
}

/// True pictures, by the checksums of those that were judged.
pub(super) fn of_pictures(reference: &Reference, checksums: &[u32]) -> TruthSource {
    let mut sum = crc32fast::Hasher::new();
    checksums.iter().for_each(|one| sum.update(&one.to_le_bytes()));
    source(reference.path(), checksums.len(), sum.finalize())
}

/// CRC-32 of a picture's values.
pub(super) fn checksum(picture: &Image<f32>) -> u32 {
    let mut sum = crc32fast::Hasher::new();
    for values in picture.data.chunks(1 << 12) {
        let bytes: Vec<u8> = values.iter().flat_map(|value| value.to_le_bytes()).collect();
        sum.update(&bytes);
    }
    sum.finalize()
}

fn source(path: &Path, count: usize, crc32: u32) -> TruthSource {
    let path = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    TruthSource { path, count, crc32: format!("{crc32:08x}") }
}

/// The truths that are not of the dataset which the run read, and that dataset.
pub(super) fn foreign(
    arguments: &Eval,
    subject: &Subject,
    reference: Option<&Reference>,
) -> Result<Option<(Vec<PathBuf>, PathBuf)>, Failure> {
    let Some(result) = subject.result() else { return Ok(None) };
    let Some(input) = Input::load(result)? else { return Ok(None) };
    let whole = |path: &Path| path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let read = whole(&input.dataset);
    let truths = arguments.groundtruth.iter().map(PathBuf::as_path);
    let truths = truths.chain(reference.map(Reference::path)).map(whole);
    let others: Vec<PathBuf> = truths.filter(|truth| !truth.starts_with(&read)).collect();
    Ok((!others.is_empty()).then_some((others, input.dataset)))
}

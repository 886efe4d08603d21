//! Poses of views that a user gives, in the world of a result (`--poses` of `render` and `export`).

use crate::failure::{Failure, failed};
use i2slam::dataset::read_trajectory;
use i2slam::geometry::StampedPose;
use i2slam_result::export::LEVELLED;
use std::path::Path;

/// Reads views in the TUM format, in order of time; refuses a path that was exported in another world.
pub(super) fn read_views(file: &Path) -> Result<Vec<StampedPose>, Failure> {
    let views = read_trajectory(file)?;
    let text = i2slam_storage::read_text(file).map_err(|error| failed(file, error))?;
    match text.lines().any(|line| line == LEVELLED) {
        true => Err(failed(
            file,
            "the poses are in the levelled world of exports, and are wanted in that of the result: \
             take its trajectory.txt, or export them with --up keep",
        )),
        false => Ok(views),
    }
}

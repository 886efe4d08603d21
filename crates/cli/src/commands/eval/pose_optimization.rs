//! Test-time pose optimisation: renders from the poses at which the map fits the true pictures.

use super::estimate::Estimate;
use super::metric_value::MetricValue;
use super::reference::Reference;
use super::{Eval, Protocol};
use crate::failure::{Failure, failed};
use crate::image_files::at_size_of;
use crate::interrupt;
use crate::messages::note_displaced;
use crate::progress::Progress;
use i2slam::FrameEstimate;
use i2slam::geometry::{Image, Pose, StampedPose};
use i2slam_result::{RenderKind, save_render, save_trajectory};
use i2slam_storage::OutputFolder;

/// Folder of the pictures inside the result.
const BELOW: &str = "renders/optimised";

/// Refuses protocols and inputs that pose optimisation is not for.
pub(super) fn check(arguments: &Eval, estimate: &Estimate) -> Result<(), Failure> {
    let refuse = |message: &str| Err(Failure::Usage(format!("--optimise-poses {message}")));
    if matches!(arguments.protocol, Protocol::Splatam | Protocol::Monogs) {
        return refuse("is no part of this protocol: take i2slam, held-out or all-frames");
    }
    if estimate.result().is_none_or(|result| !result.join("map.i2slam").is_file()) {
        return refuse("needs a result folder with its map");
    }
    Ok(())
}

/// Renders `frames` to `renders/optimised/sharp/`, writes their poses to
/// `trajectory_optimised.txt`, and returns the mean corrections.
pub(super) fn draw(
    (estimate, reference): (&Estimate, &Reference),
    frames: &[usize],
    quiet: bool,
) -> Result<Vec<MetricValue>, Failure> {
    let Some(result) = estimate.result() else { return Ok(Vec::new()) };
    let reconstruction = i2slam_result::load(result)?;
    let mut folder =
        OutputFolder::extend(result, "i2slam eval", &["trajectory_optimised.txt", "renders"])?;
    let camera = &reconstruction.camera;
    let size = Image::new(camera.width, camera.height, 3);
    let mut viewer = reconstruction.viewer();
    let mut moved: Vec<(StampedPose, Pose<f64>)> = Vec::new();
    let chosen = reconstruction.frames.iter().filter(|f| frames.binary_search(&f.index).is_ok());
    let chosen: Vec<&FrameEstimate> = chosen.collect();
    interrupt::listen();
    let progress = Progress::new(chosen.len(), quiet);
    let count = chosen.len();
    for frame in chosen {
        if interrupt::requested() {
            return Err(Failure::Interrupted);
        }
        let truth = at_size_of(reference.load(frame.index)?.colour, &size);
        let other = || failed(reference.path(), "its pictures have another size than the renders");
        let found = viewer.optimise_pose(frame, &truth.ok_or_else(other)?);
        save_render(&folder, BELOW, RenderKind::Sharp, frame.index, &found.picture)?;
        let world_from_camera = found.world_from_camera;
        let stamped = StampedPose { timestamp: frame.timestamp, world_from_camera };
        moved.push((stamped, frame.middle()));
        progress.step("optimising poses", moved.len(), count);
    }
    progress.clear();
    let poses: Vec<StampedPose> = moved.iter().map(|(pose, _)| *pose).collect();
    let unit = reconstruction.unit_of_length;
    save_trajectory(&folder, "trajectory_optimised.txt", &poses, unit)?;
    note_displaced(&folder.commit_or_save()?);
    Ok(corrections(&moved))
}

/// Mean motion from the estimated to the optimised pose.
fn corrections(moved: &[(StampedPose, Pose<f64>)]) -> Vec<MetricValue> {
    let count = moved.len().max(1) as f64;
    let steps = moved.iter().map(|(to, from)| from.local(to.world_from_camera));
    let (metres, radians) = steps.fold((0.0, 0.0), |sum, step| {
        (sum.0 + step.translation.norm() / count, sum.1 + step.rotation.norm() / count)
    });
    let figure =
        |key, label, unit, value| MetricValue { key, label, unit, decimals: 4, value: Some(value) };
    vec![
        figure("pose_correction_m", "poses moved by (mean)", "m", metres),
        figure("pose_correction_deg", "poses turned by (mean)", "degrees", radians.to_degrees()),
    ]
}

//! A reconstruction written to its folder, what matters most first.

use super::state::{CameraFile, State};
use super::{ExportError, Metrics, ResultFolder, Storage, UnitOfLength, map, table};
use i2slam::geometry::StampedPose;
use i2slam::{Map, Reconstruction};
use std::io::{self, Write};

/// Write everything but metrics, report and pictures: trajectories, `frames.csv`, `config.toml`,
/// `camera.json`, `camera_response.csv`, `state.json`, `map.i2slam`, `map.ply` (of Gaussians only;
/// an older one is removed), in this order.
///
/// A file that fails does not keep the others from being tried. The list holds what failed.
pub fn save<S: Storage>(
    folder: &ResultFolder<S>,
    reconstruction: &Reconstruction,
) -> Vec<ExportError> {
    let r = reconstruction;
    let unit = UnitOfLength::of(&r.config);
    let steps = [
        save_trajectory(folder, "trajectory.txt", &r.trajectory(), unit),
        folder.write_text("trajectory_shutter.txt", &table::shutter_trajectory(&r.frames, unit)),
        folder.write_text("frames.csv", &table::frames(&r.frames)),
        folder.write_text("config.toml", &r.config.to_toml()),
        folder.write("camera.json", |out| json(out, &CameraFile::of(&r.camera))),
        folder.write_text("camera_response.csv", &table::responses(r)),
        folder.write("state.json", |out| {
            json(out, &State::of(&r.responses, r.rolling_shutter_readout))
        }),
        folder.write("map.i2slam", |out| map::write_native(out, &r.map)),
        match &r.map {
            Map::Gaussians(map) => {
                folder.write("map.ply", |out| map::write_ply(out, map, r.typical_tone()))
            }
            Map::HashGrid(_) => folder.remove("map.ply"),
        },
    ];
    steps.into_iter().filter_map(Result::err).collect()
}

/// Write mid-exposure poses in the TUM format.
pub fn save_trajectory<S: Storage>(
    folder: &ResultFolder<S>,
    file: &str,
    poses: &[StampedPose],
    unit: UnitOfLength,
) -> Result<(), ExportError> {
    folder.write_text(file, &table::trajectory(poses, unit))
}

/// Write `metrics.json`.
pub fn save_metrics<S: Storage>(
    folder: &ResultFolder<S>,
    metrics: &Metrics,
) -> Result<(), ExportError> {
    folder.write("metrics.json", |out| json(out, metrics))
}

fn json(out: &mut dyn Write, value: &impl serde::Serialize) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut *out, value)?;
    writeln!(out)
}

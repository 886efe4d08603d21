//! A result folder read back.

use super::state::{CameraFile, FORMAT, State};
use super::table::FRAME_COLUMNS;
use super::{ExportError, map};
use i2slam::Config;
use i2slam::formation::{FrameTone, ShutterPoses};
use i2slam::geometry::{Pose, Rotation, Tangent, Vec3};
use i2slam::{Convergence, FrameEstimate, Losses, Reconstruction};
use std::fs;
use std::path::Path;
use std::str::FromStr;

/// Read the folder that [`save`](super::save) wrote: `config.toml`, `camera.json`,
/// `trajectory_shutter.txt`, `frames.csv`, `state.json` and `map.i2slam`.
pub fn load(folder: &Path) -> Result<Reconstruction, ExportError> {
    let config_path = folder.join("config.toml");
    let config = Config::from_toml(&text(&config_path)?, &config_path.display().to_string(), None)
        .map_err(|e| ExportError::Format { path: config_path, message: e.to_string() })?;
    let camera_path = folder.join("camera.json");
    let camera: CameraFile = json(&camera_path)?;
    let camera = camera.camera().map_err(|m| damaged(&camera_path, m))?;
    let (responses, rolling_shutter_readout) = state(&folder.join("state.json"))?;
    let frames = frames(folder, responses.len())?;
    let map_path = folder.join("map.i2slam");
    let bytes = fs::read(&map_path).map_err(|e| unreadable(&map_path, e))?;
    let map = map::read_native(&bytes).map_err(|m| damaged(&map_path, m))?;
    Ok(Reconstruction { config, camera, frames, map, responses, rolling_shutter_readout })
}

fn unreadable(path: &Path, source: std::io::Error) -> ExportError {
    ExportError::Read { path: path.to_owned(), source }
}

fn damaged(path: &Path, message: String) -> ExportError {
    ExportError::Format { path: path.to_owned(), message }
}

fn text(path: &Path) -> Result<String, ExportError> {
    fs::read_to_string(path).map_err(|e| unreadable(path, e))
}

fn json<T: for<'de> serde::Deserialize<'de>>(path: &Path) -> Result<T, ExportError> {
    serde_json::from_str(&text(path)?).map_err(|e| damaged(path, e.to_string()))
}

/// Camera responses, and the time in which the rows are read.
fn state(path: &Path) -> Result<(Vec<i2slam::formation::CameraResponse<f32>>, f64), ExportError> {
    let state: State = json(path)?;
    if state.format != FORMAT {
        let message = format!("has format {}, this program reads format {FORMAT}", state.format);
        return Err(damaged(path, message));
    }
    let responses = state.responses.into_iter().map(|r| r.response());
    let responses = responses.collect::<Result<_, _>>().map_err(|m| damaged(path, m))?;
    Ok((responses, state.rolling_shutter_readout))
}

/// Frames from the two tables, which have one row per frame in the same order.
fn frames(folder: &Path, responses: usize) -> Result<Vec<FrameEstimate>, ExportError> {
    let path = folder.join("frames.csv");
    let content = text(&path)?;
    let mut lines = content.lines();
    if lines.next() != Some(FRAME_COLUMNS.join(",").as_str()) {
        return Err(damaged(&path, "does not begin with the expected column names".to_owned()));
    }
    let shutters = shutters(&folder.join("trajectory_shutter.txt"))?;
    let rows: Vec<&str> = lines.filter(|l| !l.is_empty()).collect();
    if rows.len() != shutters.len() {
        let message =
            format!("has {} rows, but trajectory_shutter.txt has {}", rows.len(), shutters.len());
        return Err(damaged(&path, message));
    }
    let frames = rows.iter().zip(shutters).enumerate().map(|(i, (row, shutter))| {
        frame(row, shutter, responses).map_err(|m| damaged(&path, format!("line {}: {m}", i + 2)))
    });
    frames.collect()
}

fn frame(row: &str, shutter: ShutterPoses<f64>, responses: usize) -> Result<FrameEstimate, String> {
    let cells: Vec<&str> = row.split(',').collect();
    if cells.len() != FRAME_COLUMNS.len() {
        return Err(format!("{} columns, expected {}", cells.len(), FRAME_COLUMNS.len()));
    }
    let log = |column: usize| cell::<f64>(&cells, column).map(|gain| gain.ln() as f32);
    let response = cell(&cells, 15)?;
    if response >= responses {
        return Err(format!("camera response {response} is not in state.json"));
    }
    let mut depth_lead = [0.0; 6];
    for (i, value) in depth_lead.iter_mut().enumerate() {
        *value = cell(&cells, 16 + i)?;
    }
    Ok(FrameEstimate {
        index: cell(&cells, 0)?,
        timestamp: cell(&cells, 1)?,
        shutter,
        readout: cell(&cells, 23)?,
        depth_lead: Tangent::from_array(depth_lead),
        tone: FrameTone::from_array([log(2)?, log(3)?, log(4)?, log(5)?]),
        response,
        keyframe: cell::<u8>(&cells, 13)? != 0,
        held_out: cell::<u8>(&cells, 22)? != 0,
        tracked: cell::<u8>(&cells, 14)? != 0,
        losses: Losses {
            image: cell(&cells, 6)?,
            depth: cell(&cells, 7)?,
            trajectory: cell(&cells, 8)?,
        },
        convergence: Convergence {
            converged: cell::<u8>(&cells, 24)? != 0,
            iterations: cell(&cells, 25)?,
            position_deviation: optional(&cells, 26)?,
            rotation_deviation: optional(&cells, 27)?.map(f64::to_radians),
        },
        blur_length: cell(&cells, 9)?,
        tracking_seconds: cell(&cells, 10)?,
        mapping_seconds: cell(&cells, 11)?,
        gaussians: cell(&cells, 12)?,
    })
}

fn cell<T: FromStr>(cells: &[&str], column: usize) -> Result<T, String> {
    let text = cells[column];
    let wrong = |_| format!("`{text}` is no value of {}", FRAME_COLUMNS[column]);
    text.parse().map_err(wrong)
}

/// A number, or none in an empty cell.
fn optional(cells: &[&str], column: usize) -> Result<Option<f64>, String> {
    if cells[column].is_empty() { Ok(None) } else { cell(cells, column).map(Some) }
}

fn shutters(path: &Path) -> Result<Vec<ShutterPoses<f64>>, ExportError> {
    let content = text(path)?;
    let lines = content.lines().enumerate().filter(|(_, l)| !l.is_empty() && !l.starts_with('#'));
    let shutters = lines.map(|(i, line)| {
        let numbers: Option<Vec<f64>> = line.split(' ').map(|t| t.parse().ok()).collect();
        let numbers = numbers.filter(|n| n.len() == 15);
        let poses = numbers.and_then(|n| Some((pose(&n[1..8])?, pose(&n[8..15])?)));
        let wrong = || damaged(path, format!("line {}: expected a time and two poses", i + 1));
        poses.map(|(start, end)| ShutterPoses { start, end }).ok_or_else(wrong)
    });
    shutters.collect()
}

/// A pose from `tx ty tz qx qy qz qw`. Unit quaternions are kept bit for bit.
fn pose(n: &[f64]) -> Option<Pose<f64>> {
    let rotation = Rotation::from_wxyz(n[6], n[3], n[4], n[5])?;
    let exact = Rotation { w: n[6], v: Vec3::new(n[3], n[4], n[5]) };
    let unit = (rotation.w - exact.w).abs() + (rotation.v - exact.v).norm() < 1e-12;
    let rotation = if unit { exact } else { rotation };
    Some(Pose::new(rotation, Vec3::new(n[0], n[1], n[2]))).filter(|p| p.is_finite())
}

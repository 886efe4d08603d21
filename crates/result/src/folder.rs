//! A reconstruction saved to a result folder, the most important files first, and loaded from it.

use crate::error::read_text;
use crate::export::blended_colours::picture_splats;
use crate::export::ply;
use crate::pictures::DEPTH_UNITS_PER_METRE;
use crate::{FrameFiles, Metrics, ResultError, UnitOfLength, map, tables};
use i2slam::dataset::read_trajectory;
use i2slam::formation::tone::NODES;
use i2slam::formation::{CameraResponse, NodeSpacing, StartCurve, Vignetting};
use i2slam::geometry::{Camera, Pose, StampedPose};
use i2slam::{Config, Map, Reconstruction};
use i2slam_storage::OutputFolder;
use serde::{Deserialize, Serialize};
use std::io::{self, Write};
use std::path::Path;

/// Names in a result folder: those of `run`, and those that `eval` and `render` add.
pub const NAMES: &[&str] = &[
    "trajectory.txt",
    "trajectory_online.txt",
    "trajectory_shutter.txt",
    "trajectory_optimised.txt",
    "frames.csv",
    "config.toml",
    "input.json",
    "camera.json",
    "camera_response.csv",
    "state.json",
    "map.i2slam",
    "map.ply",
    "metrics.json",
    "evaluation.json",
    "report.html",
    "viewer.html",
    "renders",
    "views",
];

/// Writes everything but metrics, report and pictures: trajectories, `frames.csv`, `config.toml`,
/// `camera.json`, `camera_response.csv`, `state.json`, `map.i2slam`, `map.ply` (of Gaussians only),
/// in this order.
///
/// `files` are those of the pictures taken. Every file is tried; returns the failures.
pub fn save(
    folder: &OutputFolder,
    reconstruction: &Reconstruction,
    files: &FrameFiles,
) -> Vec<ResultError> {
    let r = reconstruction;
    let unit = r.unit_of_length;
    let steps = [
        folder.write_text("trajectory.txt", &tables::trajectory(&r.trajectory(), unit)),
        match r.online_trajectory.as_slice() {
            [] => Ok(()),
            path => {
                folder.write_text("trajectory_online.txt", &tables::online_trajectory(path, unit))
            }
        },
        folder.write_text("trajectory_shutter.txt", &tables::shutter_trajectory(&r.frames, unit)),
        folder.write_text("frames.csv", &tables::frames(&r.frames, files)),
        folder.write_text("config.toml", &r.config.to_toml()),
        folder.write("camera.json", |out| write_json(out, &CameraFile::of(&r.camera))),
        folder.write_text("camera_response.csv", &tables::responses(r)),
        folder.write("state.json", |out| write_json(out, &State::of(r))),
        folder.write("map.i2slam", |out| map::write_native(out, &r.map)),
        match &r.map {
            Map::Gaussians(map) => {
                let splats = picture_splats(r, map, Pose::identity());
                folder.write("map.ply", |out| ply::write(out, &splats, None))
            }
            Map::HashGrid(_) => Ok(()),
        },
    ];
    steps.into_iter().filter_map(Result::err).map(ResultError::from).collect()
}

/// Deletes the pictures of a result, with the list of their poses.
pub fn remove_renders(result: &Path) -> Result<(), ResultError> {
    let mut folder = OutputFolder::extend(result, "i2slam-bench", &[])?;
    folder.remove(|name| name.starts_with("renders/") || name.starts_with("views/"));
    folder.commit()?;
    Ok(())
}

/// Writes mid-exposure poses in the TUM format.
pub fn save_trajectory(
    folder: &OutputFolder,
    file: &str,
    poses: &[StampedPose],
    unit: UnitOfLength,
) -> Result<(), ResultError> {
    Ok(folder.write_text(file, &tables::trajectory(poses, unit))?)
}

/// Writes `metrics.json`.
pub fn save_metrics(folder: &OutputFolder, metrics: &Metrics) -> Result<(), ResultError> {
    Ok(folder.write("metrics.json", |out| write_json(out, metrics))?)
}

/// Reads `metrics.json`; `None` where it is missing or damaged.
pub fn load_metrics(folder: &Path) -> Option<Metrics> {
    read_json(&folder.join("metrics.json")).ok()
}

fn write_json(out: &mut dyn Write, value: &impl serde::Serialize) -> io::Result<()> {
    serde_json::to_writer_pretty(&mut *out, value)?;
    writeln!(out)
}

/// Reads what [`save`] wrote: `config.toml`, `camera.json`, `trajectory_shutter.txt`, `frames.csv`,
/// `state.json` and `map.i2slam`, and `trajectory_online.txt` where it is there. Settings that earlier versions had are ignored.
pub fn load(folder: &Path) -> Result<Reconstruction, ResultError> {
    let config_path = folder.join("config.toml");
    let config =
        Config::from_stored(&read_text(&config_path)?, &config_path.display().to_string())?;
    let camera_path = folder.join("camera.json");
    let camera: CameraFile = read_json(&camera_path)?;
    let camera = camera.camera().map_err(|m| ResultError::format(&camera_path, m))?;
    let state_path = folder.join("state.json");
    let state = state(&state_path)?;
    let responses = state.responses.into_iter().map(ResponseState::response);
    let responses = responses
        .collect::<Result<Vec<_>, _>>()
        .map_err(|m| ResultError::format(&state_path, m))?;
    let frames = tables::read_frames(folder, responses.len())?;
    let map_path = folder.join("map.i2slam");
    let bytes =
        i2slam_storage::read(&map_path, MAX_MAP).map_err(|e| ResultError::read(&map_path, e))?;
    let map = map::read_native(&bytes).map_err(|m| ResultError::format(&map_path, m))?;
    let online = folder.join("trajectory_online.txt");
    let online_trajectory = if online.is_file() { read_trajectory(&online)? } else { Vec::new() };
    let unit_of_length = state.unit_of_length.unwrap_or_else(|| UnitOfLength::of_pictures(&config));
    Ok(Reconstruction {
        config,
        camera,
        frames,
        online_trajectory,
        map,
        responses,
        vignetting: state.vignetting.map(|found| found.vignetting()).unwrap_or_default(),
        rolling_shutter_readout: state.rolling_shutter_readout,
        unit_of_length,
    })
}

/// True if the `trajectory.txt` of a folder has other poses than its reconstruction, which is loaded from
/// `trajectory_shutter.txt`; a folder without the file has no others.
pub fn is_trajectory_edited(folder: &Path, reconstruction: &Reconstruction) -> bool {
    let path = folder.join("trajectory.txt");
    let written = reconstruction.trajectory();
    let is_same = |(a, b): (&StampedPose, &StampedPose)| {
        let off = a.world_from_camera.local(b.world_from_camera);
        (a.timestamp - b.timestamp).abs() < MAX_ROUNDING
            && off.translation.norm().max(off.rotation.norm()) < MAX_ROUNDING
    };
    path.is_file()
        && read_trajectory(&path).map_or(true, |read| {
            read.len() != written.len() || !read.iter().zip(&written).all(is_same)
        })
}

/// Reads `state.json`.
fn state(path: &Path) -> Result<State, ResultError> {
    let state: State = read_json(path)?;
    if state.format != FORMAT {
        let message = format!("has format {}, this program reads format {FORMAT}", state.format);
        return Err(ResultError::format(path, message));
    }
    if state.vignetting.is_some_and(|found| !found.is_finite()) {
        return Err(ResultError::format(path, "has no usable vignetting"));
    }
    Ok(state)
}

/// Largest change of a time or pose by the decimals of `trajectory.txt`.
const MAX_ROUNDING: f64 = 2e-6;

/// Largest map [bytes]: 100 million Gaussians of 56 bytes.
const MAX_MAP: u64 = 6 << 30;

/// Version of `state.json`, which stands for that of the folder.
const FORMAT: u32 = 1;

/// `state.json`: the parameters of camera responses and lens.
#[derive(Serialize, Deserialize)]
struct State {
    format: u32,
    responses: Vec<ResponseState>,
    /// Time from the first to the last row [s].
    #[serde(default)]
    rolling_shutter_readout: f64,
    /// Absent where none was found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    vignetting: Option<VignettingState>,
    /// Absent in results of earlier versions.
    #[serde(default)]
    unit_of_length: Option<UnitOfLength>,
}

/// `v(r) = 1 + a r² + b r⁴ + c r⁶`.
#[derive(Clone, Copy, Serialize, Deserialize)]
struct VignettingState {
    a: f32,
    b: f32,
    c: f32,
    /// `v(1)`, for readers.
    corner: f32,
}

impl VignettingState {
    /// None of a lens without.
    fn of(vignetting: &Vignetting<f32>) -> Option<Self> {
        let [a, b, c] = vignetting.coefficients;
        (!vignetting.is_none()).then(|| Self { a, b, c, corner: vignetting.corner() })
    }

    fn vignetting(self) -> Vignetting<f32> {
        Vignetting { coefficients: [self.a, self.b, self.c] }
    }

    fn is_finite(self) -> bool {
        [self.a, self.b, self.c].into_iter().all(f32::is_finite)
    }
}

#[derive(Serialize, Deserialize)]
struct ResponseState {
    start: StartCurve,
    /// Exponent of the node spacing [default: uniform].
    node_power: Option<f64>,
    nodes: Vec<Vec<f32>>,
    /// Values of the curve it began with at the nodes [default: those of `start`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    initial: Option<Vec<f32>>,
}

impl State {
    fn of(reconstruction: &Reconstruction) -> Self {
        Self {
            format: FORMAT,
            responses: reconstruction.responses.iter().map(ResponseState::of).collect(),
            rolling_shutter_readout: reconstruction.rolling_shutter_readout,
            vignetting: VignettingState::of(&reconstruction.vignetting),
            unit_of_length: Some(reconstruction.unit_of_length),
        }
    }
}

impl ResponseState {
    fn of(response: &CameraResponse<f32>) -> Self {
        let node_power = match response.spacing() {
            NodeSpacing::Uniform => None,
            NodeSpacing::Power(power) => Some(power),
        };
        let started = CameraResponse::<f32>::new(1, response.start(), response.spacing());
        let is_start = response.initial() == started.initial();
        Self {
            start: response.start(),
            node_power,
            nodes: response.nodes.clone(),
            initial: (!is_start).then(|| response.initial().to_vec()),
        }
    }

    /// The response; the error says what is wrong with it.
    fn response(self) -> Result<CameraResponse<f32>, String> {
        let spacing = self.node_power.map_or(NodeSpacing::Uniform, NodeSpacing::Power);
        let curves = self.nodes.len();
        if !matches!(curves, 1 | 3) || self.nodes.iter().any(|n| n.len() != NODES) {
            return Err(format!("a camera response needs 1 or 3 curves of {NODES} nodes"));
        }
        let mut response = CameraResponse::new(curves, self.start, spacing);
        if let Some(initial) = self.initial {
            if initial.len() != NODES {
                return Err(format!("a camera response begins with a curve of {NODES} nodes"));
            }
            let initial = initial.into_iter().map(f64::from).collect();
            response = CameraResponse::of_nodes(vec![initial], self.start, spacing);
        }
        response.nodes = self.nodes;
        Ok(response)
    }
}

/// `camera.json`: the camera of the pictures under `renders/`, readable as a dataset's `camera.json`.
#[derive(Serialize, Deserialize)]
struct CameraFile {
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    /// Position of the centre of pixel (0, 0) [px].
    pixel_centre: f64,
    distortion: [f64; 5],
    depth_scale: f64,
}

impl CameraFile {
    fn of(camera: &Camera<f64>) -> Self {
        let &Camera { width, height, fx, fy, cx, cy } = camera;
        let depth_scale = f64::from(DEPTH_UNITS_PER_METRE);
        Self { width, height, fx, fy, cx, cy, pixel_centre: 0.5, distortion: [0.0; 5], depth_scale }
    }

    fn camera(self) -> Result<Camera<f64>, String> {
        let shift = 0.5 - self.pixel_centre;
        let Self { width, height, fx, fy, cx, cy, .. } = self;
        let numbers = [fx, fy, cx, cy, shift];
        if width == 0
            || height == 0
            || fx <= 0.0
            || fy <= 0.0
            || numbers.iter().any(|v| !v.is_finite())
        {
            return Err("has no usable camera".to_owned());
        }
        Ok(Camera { width, height, fx, fy, cx: cx + shift, cy: cy + shift })
    }
}

fn read_json<T: for<'de> Deserialize<'de>>(path: &Path) -> Result<T, ResultError> {
    serde_json::from_str(&read_text(path)?).map_err(|e| ResultError::format(path, e.to_string()))
}

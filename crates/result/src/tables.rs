//! The text tables of a result: trajectories, `frames.csv`, camera response.

use crate::error::read_text;
use crate::frame_files::{FILE_COLUMN, FrameFiles};
use crate::{ResultError, UnitOfLength};
use i2slam::formation::{FrameTone, ShutterPoses};
use i2slam::geometry::{Pose, Rotation, StampedPose, Tangent, Vec3};
use i2slam::{Convergence, FrameEstimate, Losses, Reconstruction};
use std::fmt::{Display, Write};
use std::path::Path;
use std::str::FromStr;

/// Columns of `frames.csv` before [`FILE_COLUMN`], in order.
pub(crate) const FRAME_COLUMNS: [&str; 28] = [
    "index",
    "timestamp",
    "exposure",
    "white_balance_r",
    "white_balance_g",
    "white_balance_b",
    "loss_image",
    "loss_depth",
    "loss_trajectory",
    "blur_length_px",
    "tracking_seconds",
    "mapping_seconds",
    "gaussians",
    "keyframe",
    "tracked",
    "response",
    "depth_lead_x",
    "depth_lead_y",
    "depth_lead_z",
    "depth_lead_rx",
    "depth_lead_ry",
    "depth_lead_rz",
    "held_out",
    "readout_exposures",
    "converged",
    "iterations",
    "position_deviation_m",
    "rotation_deviation_deg",
];

/// `trajectory.txt`: mid-exposure poses in the TUM format.
pub(crate) fn trajectory(poses: &[StampedPose], unit: UnitOfLength) -> String {
    let mut text = format!("# world_from_camera at mid-exposure {}\n", unit_label(unit));
    text += "# timestamp tx ty tz qx qy qz qw\n";
    for pose in poses {
        text += &trajectory_line(pose);
    }
    text
}

/// A line of `trajectory.txt`: `timestamp tx ty tz qx qy qz qw`, `world_from_camera`.
pub fn trajectory_line(pose: &StampedPose) -> String {
    pose_line(pose.timestamp, &[pose.world_from_camera], |v| format!("{v:.9}"))
}

/// `trajectory_online.txt`: mid-exposure poses as they were known when the frames came. Without poses
/// the lines before the first one.
pub fn online_trajectory(poses: &[StampedPose], unit: UnitOfLength) -> String {
    let poses = trajectory(poses, unit);
    poses.replacen("at mid-exposure", "at mid-exposure, as known when the frame came", 1)
}

/// `trajectory_shutter.txt`: poses at shutter open and close, in full precision.
pub(crate) fn shutter_trajectory(frames: &[FrameEstimate], unit: UnitOfLength) -> String {
    let unit = unit_label(unit);
    let mut text = format!("# world_from_camera at shutter open (0) and close (1) {unit}\n");
    text += "# timestamp tx0 ty0 tz0 qx0 qy0 qz0 qw0 tx1 ty1 tz1 qx1 qy1 qz1 qw1\n";
    for frame in frames {
        let poses = [frame.shutter.start, frame.shutter.end];
        text += &pose_line(frame.timestamp, &poses, |v| v.to_string());
    }
    text
}

fn unit_label(unit: UnitOfLength) -> &'static str {
    match unit {
        UnitOfLength::Metre => "[m]",
        UnitOfLength::Keyframes => "[unit of length of the keyframes given]",
        UnitOfLength::Unknown => "[unit of length unknown]",
    }
}

/// The unit in the first line of a `trajectory.txt`; metres if it names none.
pub fn unit_of_trajectory(text: &str) -> UnitOfLength {
    let head = text.lines().next().unwrap_or_default();
    let is_named = |unit: &UnitOfLength| head.starts_with('#') && head.ends_with(unit_label(*unit));
    let units = [UnitOfLength::Keyframes, UnitOfLength::Unknown];
    units.into_iter().find(is_named).unwrap_or_default()
}

fn pose_line(timestamp: f64, poses: &[Pose<f64>], number: impl Fn(f64) -> String) -> String {
    let mut line = format!("{timestamp:.6}");
    for Pose { rotation: q, translation: t } in poses {
        for value in [t.x, t.y, t.z, q.v.x, q.v.y, q.v.z, q.w] {
            line.push(' ');
            line += &number(value);
        }
    }
    line.push('\n');
    line
}

/// `frames.csv`: one row per frame, in full precision but for times of work.
pub(crate) fn frames(frames: &[FrameEstimate], files: &FrameFiles) -> String {
    let mut text = frame_header();
    text.push('\n');
    for frame in frames {
        let [log_exposure, red, green, blue] = frame.tone.to_array().map(f64::from);
        let [image, depth, trajectory, blur] =
            [frame.losses.image, frame.losses.depth, frame.losses.trajectory, frame.blur_length]
                .map(|value| optional(frame.refined.then_some(value)));
        let [x, y, z, rx, ry, rz] = frame.depth_offset.to_array();
        let convergence = frame.convergence;
        let [position, rotation] =
            [convergence.position_deviation, convergence.rotation_deviation.map(f64::to_degrees)]
                .map(optional);
        let cells: [&dyn Display; 28] = [
            &frame.index,
            &frame.timestamp,
            &log_exposure.exp(),
            &red.exp(),
            &green.exp(),
            &blue.exp(),
            &image,
            &depth,
            &trajectory,
            &blur,
            &format_args!("{:.4}", frame.tracking_seconds),
            &format_args!("{:.4}", frame.mapping_seconds),
            &frame.gaussians,
            &u8::from(frame.keyframe),
            &u8::from(frame.tracked),
            &frame.response,
            &x,
            &y,
            &z,
            &rx,
            &ry,
            &rz,
            &u8::from(frame.held_out),
            &frame.readout,
            &u8::from(convergence.converged),
            &convergence.iterations,
            &position,
            &rotation,
        ];
        text += &cells.map(|cell| cell.to_string()).join(",");
        text += &format!(",{}\n", files.cell(frame.index));
    }
    text
}

/// A cell with a number, empty of `None`.
fn optional(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

/// First line of `frames.csv`.
fn frame_header() -> String {
    format!("{},{FILE_COLUMN}", FRAME_COLUMNS.join(","))
}

/// `camera_response.csv`: node, linear input, picture value of each curve; a leading `frame`
/// where every frame has a response of its own.
pub(crate) fn responses(reconstruction: &Reconstruction) -> String {
    let per_frame = reconstruction.responses.len() > 1;
    let curves = reconstruction.responses.first().map_or(1, |r| r.nodes.len());
    let mut text = String::from(if per_frame { "frame,node,input" } else { "node,input" });
    text += if curves == 1 { ",output\n" } else { ",output_r,output_g,output_b\n" };
    for (i, response) in reconstruction.responses.iter().enumerate() {
        let curve = response.curve();
        let frame = first_frame_of(reconstruction, i);
        // Frames that were taken out of the map leave their responses.
        if per_frame && frame.is_none() {
            continue;
        }
        for (node, input) in curve.positions().iter().enumerate() {
            if let Some(frame) = frame.filter(|_| per_frame) {
                // Writing to a string cannot fail.
                write!(text, "{frame},").ok();
            }
            write!(text, "{node},{input}").ok();
            for c in 0..curves {
                write!(text, ",{}", curve.values(c)[node]).ok();
            }
            text.push('\n');
        }
    }
    text
}

/// The stream index of the first frame that a response forms.
fn first_frame_of(reconstruction: &Reconstruction, response: usize) -> Option<usize> {
    reconstruction.frames.iter().find(|f| f.response == response).map(|f| f.index)
}

/// Reads frames from the two tables, which have one row per frame in the same order.
pub(crate) fn read_frames(
    folder: &Path,
    responses: usize,
) -> Result<Vec<FrameEstimate>, ResultError> {
    let path = folder.join("frames.csv");
    let content = read_text(&path)?;
    let mut lines = content.lines();
    // Earlier versions wrote no files.
    let header = lines.next().unwrap_or_default();
    if header != frame_header() && header != FRAME_COLUMNS.join(",") {
        return Err(ResultError::format(&path, "does not begin with the expected column names"));
    }
    let shutters = shutters(&folder.join("trajectory_shutter.txt"))?;
    let rows: Vec<&str> = lines.filter(|l| !l.is_empty()).collect();
    if rows.len() != shutters.len() {
        let message =
            format!("has {} rows, but trajectory_shutter.txt has {}", rows.len(), shutters.len());
        return Err(ResultError::format(&path, message));
    }
    let frames = rows.iter().zip(shutters).enumerate().map(|(i, (row, shutter))| {
        frame(row, shutter, responses)
            .map_err(|m| ResultError::format(&path, format!("line {}: {m}", i + 2)))
    });
    frames.collect()
}

fn frame(row: &str, shutter: ShutterPoses<f64>, responses: usize) -> Result<FrameEstimate, String> {
    // Names of files may hold commas.
    let row = Row(row.splitn(FRAME_COLUMNS.len() + 1, ',').collect());
    if row.0.len() < FRAME_COLUMNS.len() {
        return Err(format!("{} columns, expected {}", row.0.len(), FRAME_COLUMNS.len()));
    }
    let log = |column: &str| row.value::<f64>(column).map(|gain| gain.ln() as f32);
    let response = row.value("response")?;
    if response >= responses {
        return Err(format!("camera response {response} is not in state.json"));
    }
    let depth_offset = [
        row.value("depth_lead_x")?,
        row.value("depth_lead_y")?,
        row.value("depth_lead_z")?,
        row.value("depth_lead_rx")?,
        row.value("depth_lead_ry")?,
        row.value("depth_lead_rz")?,
    ];
    let blur_length = row.optional("blur_length_px")?;
    Ok(FrameEstimate {
        index: row.value("index")?,
        timestamp: row.value("timestamp")?,
        shutter,
        readout: row.value("readout_exposures")?,
        depth_offset: Tangent::from_array(depth_offset),
        tone: FrameTone::from_array([
            log("exposure")?,
            log("white_balance_r")?,
            log("white_balance_g")?,
            log("white_balance_b")?,
        ]),
        response,
        keyframe: row.flag("keyframe")?,
        held_out: row.flag("held_out")?,
        tracked: row.flag("tracked")?,
        refined: blur_length.is_some(),
        losses: Losses {
            image: row.optional("loss_image")?.unwrap_or(0.0),
            depth: row.optional("loss_depth")?.unwrap_or(0.0),
            trajectory: row.optional("loss_trajectory")?.unwrap_or(0.0),
        },
        convergence: Convergence {
            converged: row.flag("converged")?,
            iterations: row.value("iterations")?,
            position_deviation: row.optional("position_deviation_m")?,
            rotation_deviation: row.optional("rotation_deviation_deg")?.map(f64::to_radians),
        },
        blur_length: blur_length.unwrap_or(0.0),
        tracking_seconds: row.value("tracking_seconds")?,
        mapping_seconds: row.value("mapping_seconds")?,
        gaussians: row.value("gaussians")?,
    })
}

/// The cells of a row of `frames.csv`, read by the names of [`FRAME_COLUMNS`].
struct Row<'a>(Vec<&'a str>);

impl Row<'_> {
    fn text(&self, column: &str) -> &str {
        let place = FRAME_COLUMNS.iter().position(|name| *name == column);
        place.and_then(|place| self.0.get(place)).copied().unwrap_or_default()
    }

    fn value<T: FromStr>(&self, column: &str) -> Result<T, String> {
        let text = self.text(column);
        text.parse().map_err(|_| format!("`{text}` is no value of {column}"))
    }

    fn flag(&self, column: &str) -> Result<bool, String> {
        self.value::<u8>(column).map(|value| value != 0)
    }

    /// A number; `None` of an empty cell.
    fn optional(&self, column: &str) -> Result<Option<f64>, String> {
        if self.text(column).is_empty() { Ok(None) } else { self.value(column).map(Some) }
    }
}

fn shutters(path: &Path) -> Result<Vec<ShutterPoses<f64>>, ResultError> {
    let content = read_text(path)?;
    let lines = content.lines().enumerate().filter(|(_, l)| !l.is_empty() && !l.starts_with('#'));
    let shutters = lines.map(|(i, line)| {
        let numbers: Option<Vec<f64>> = line.split(' ').map(|t| t.parse().ok()).collect();
        let numbers = numbers.filter(|n| n.len() == 15);
        let poses = numbers.and_then(|n| Some((pose(&n[1..8])?, pose(&n[8..15])?)));
        let wrong =
            || ResultError::format(path, format!("line {}: expected a time and two poses", i + 1));
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

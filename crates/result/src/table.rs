//! The text files of a result: trajectories, frames, camera response.

use super::UnitOfLength;
use i2slam::geometry::{Pose, StampedPose};
use i2slam::{FrameEstimate, Reconstruction};
use std::fmt::{Display, Write};

/// Columns of `frames.csv`, in order.
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
    let mut text = format!("# world_from_camera at mid-exposure {}\n", in_words(unit));
    text += "# timestamp tx ty tz qx qy qz qw\n";
    for pose in poses {
        text += &line(pose.timestamp, &[pose.world_from_camera], |v| format!("{v:.9}"));
    }
    text
}

/// `trajectory_shutter.txt`: poses at shutter open and close, in full precision.
pub(crate) fn shutter_trajectory(frames: &[FrameEstimate], unit: UnitOfLength) -> String {
    let unit = in_words(unit);
    let mut text = format!("# world_from_camera at shutter open (0) and close (1) {unit}\n");
    text += "# timestamp tx0 ty0 tz0 qx0 qy0 qz0 qw0 tx1 ty1 tz1 qx1 qy1 qz1 qw1\n";
    for frame in frames {
        let poses = [frame.shutter.start, frame.shutter.end];
        text += &line(frame.timestamp, &poses, |v| v.to_string());
    }
    text
}

fn in_words(unit: UnitOfLength) -> &'static str {
    match unit {
        UnitOfLength::Metre => "[m]",
        UnitOfLength::Unknown => "[unit of length unknown]",
    }
}

impl UnitOfLength {
    /// What the first line of a `trajectory.txt` says; metres if it says nothing.
    pub fn of_trajectory(text: &str) -> Self {
        let head = text.lines().next().unwrap_or_default();
        let is_unknown = head.starts_with('#') && head.ends_with(in_words(Self::Unknown));
        if is_unknown { Self::Unknown } else { Self::Metre }
    }
}

fn line(timestamp: f64, poses: &[Pose<f64>], number: impl Fn(f64) -> String) -> String {
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

/// `frames.csv`: one row per frame. Numbers that are read back are in full precision.
pub(crate) fn frames(frames: &[FrameEstimate]) -> String {
    let mut text = FRAME_COLUMNS.join(",");
    text.push('\n');
    for frame in frames {
        let [log_exposure, red, green, blue] = frame.tone.to_array().map(f64::from);
        let losses = frame.losses;
        let [x, y, z, rx, ry, rz] = frame.depth_lead.to_array();
        let convergence = frame.convergence;
        let [position, rotation] =
            [convergence.position_deviation, convergence.rotation_deviation.map(f64::to_degrees)]
                .map(|v| v.map_or_else(String::new, |v| v.to_string()));
        let cells: [&dyn Display; 28] = [
            &frame.index,
            &frame.timestamp,
            &log_exposure.exp(),
            &red.exp(),
            &green.exp(),
            &blue.exp(),
            &losses.image,
            &losses.depth,
            &losses.trajectory,
            &frame.blur_length,
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
        text.push('\n');
    }
    text
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
        let frame = per_frame.then(|| frame_of(reconstruction, i)).flatten();
        for (node, input) in curve.positions().iter().enumerate() {
            if let Some(frame) = frame {
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
fn frame_of(reconstruction: &Reconstruction, response: usize) -> Option<usize> {
    reconstruction.frames.iter().find(|f| f.response == response).map(|f| f.index)
}

//! What is told of keyframes that another program has found poses for.

use super::Info;
use crate::failure::Failure;
use crate::output::{complain, counted, say};
use i2slam::dataset::import::{Files, Options};
use i2slam::dataset::{DatasetError, OpenOptions};
use serde::Serialize;

/// The JSON object.
#[derive(Debug, Serialize)]
struct Told {
    kind: &'static str,
    poses: String,
    keyframes: usize,
    poses_without_picture: usize,
    pictures_without_pose: usize,
    first_s: f64,
    duration_s: f64,
    /// In the unit of the poses.
    path_length: f64,
    width: usize,
    height: usize,
    fx: f64,
    fy: f64,
    /// Pixel centres at one half.
    cx: f64,
    cy: f64,
    camera_source: String,
    has_depth: bool,
    has_variance: bool,
    warnings: Vec<String>,
}

/// Tells of keyframes in what is no sequence, for the reason given; whether there are some.
pub(super) fn tell(
    arguments: &Info,
    open: OpenOptions,
    reason: &DatasetError,
) -> Result<bool, Failure> {
    if !matches!(reason, DatasetError::UnknownLayout { .. }) {
        return Ok(false);
    }
    let options = Options { open, ..Options::default() };
    let files = match Files::open(&arguments.dataset, None, &options) {
        Err(DatasetError::UnknownImport { .. }) => return Ok(false),
        files => files?,
    };
    let told = Told::of(&files);
    if arguments.json {
        let text = serde_json::to_string_pretty(&told);
        say(&text.map_err(|e| Failure::Failed(format!("cannot write JSON: {e}")))?);
        return Ok(true);
    }
    for (label, text) in told.rows() {
        say(&format!("{label:<18}{text}"));
    }
    for warning in &told.warnings {
        complain(&format!("warning: {warning}"));
    }
    Ok(true)
}

impl Told {
    fn of(files: &Files) -> Self {
        let (camera, poses) = (&files.camera, &files.keyframes);
        let place = |i: usize| poses[i].world_from_camera.translation;
        let first_s = poses.first().map_or(0.0, |pose| pose.timestamp);
        Self {
            kind: files.kind.name(),
            poses: format!("{}: {}", files.path.display(), files.kind.convention()),
            keyframes: files.len(),
            poses_without_picture: files.left_out.poses_without_picture,
            pictures_without_pose: files.left_out.pictures_without_pose,
            first_s,
            duration_s: poses.last().map_or(0.0, |pose| pose.timestamp) - first_s,
            path_length: (1..poses.len()).map(|i| (place(i) - place(i - 1)).norm()).sum(),
            width: camera.width,
            height: camera.height,
            fx: camera.fx,
            fy: camera.fy,
            cx: camera.cx,
            cy: camera.cy,
            camera_source: files.camera_source.clone(),
            has_depth: files.has_depth,
            has_variance: files.has_variance,
            warnings: files.warnings.clone(),
        }
    }

    fn rows(&self) -> [(&'static str, String); 7] {
        let depth = match (self.has_depth, self.has_variance) {
            (false, _) => "none",
            (true, false) => "yes, without variance",
            (true, true) => "yes, with variance",
        };
        [
            ("keyframes of", self.kind.to_owned()),
            ("poses", self.poses.clone()),
            (
                "keyframes",
                format!(
                    "{} ({} without a picture, {} without a pose)",
                    self.keyframes,
                    counted(self.poses_without_picture, "pose"),
                    counted(self.pictures_without_pose, "picture")
                ),
            ),
            ("times", format!("{:.2} s from {:.3}", self.duration_s, self.first_s)),
            ("path", format!("{:.3} in the unit of the poses", self.path_length)),
            (
                "camera",
                format!(
                    "{}x{}, fx {:.2}, fy {:.2}, cx {:.2}, cy {:.2} px (pixel centres at 0.5), from \
                     {}",
                    self.width, self.height, self.fx, self.fy, self.cx, self.cy, self.camera_source
                ),
            ),
            ("depth", depth.to_owned()),
        ]
    }
}

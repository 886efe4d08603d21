//! Facts about a sequence, or about imported keyframes, that need no look at the pictures.

use super::Info;
use crate::console::{counted, print, print_status};
use crate::failure::{Failure, print_json};
use crate::ground_truth::GroundTruth;
use i2slam::dataset::import::{ImportOptions, ImportedKeyframes};
use i2slam::dataset::{
    DatasetError, DroppedFrames, FrameEntry, Layout, OpenOptions, Sequence, paper_frames,
};
use i2slam::geometry::StampedPose;
use serde::Serialize;

/// Smallest ratio of a reported gap to the median gap.
const MIN_GAP_RATIO: f64 = 1.5;

/// Facts from lists and headers.
#[derive(Debug, Serialize)]
pub(super) struct SequenceInfo {
    pub(super) name: String,
    pub(super) layout: String,
    /// Transfer function of a video of high dynamic range, HLG or PQ.
    pub(super) high_dynamic_range: Option<&'static str>,
    pub(super) frames: usize,
    /// Frames that have a depth image of their own.
    pub(super) frames_with_depth: usize,
    pub(super) left_out: DroppedFrames,
    pub(super) times: TimeInfo,
    pub(super) camera: CameraInfo,
    /// Depth image value of one metre; `null` without depth, and where depth is stored in metres.
    pub(super) depth_scale: Option<f64>,
    pub(super) is_depth_scale_assumed: bool,
    pub(super) truth: GroundTruthInfo,
    /// First frame and the one behind the last that the paper uses of this sequence.
    pub(super) paper_frames: Option<[usize; 2]>,
}

/// Time stamps of the frames.
#[derive(Debug, Serialize)]
pub(super) struct TimeInfo {
    pub(super) first_s: f64,
    pub(super) duration_s: f64,
    pub(super) frames_per_second: f64,
    /// True if none were recorded, so that these are counted at an assumed frame rate.
    pub(super) are_assumed: bool,
    /// Gaps of at least 1.5 median gaps.
    pub(super) gaps: Vec<Gap>,
    /// Largest distance in time between colour and depth of a frame.
    pub(super) colour_to_depth_s: f64,
}

/// A gap in time.
#[derive(Debug, PartialEq, Serialize)]
pub(super) struct Gap {
    /// Place in the associated stream of the frame before it.
    pub(super) after_frame: usize,
    pub(super) seconds: f64,
}

/// The camera of the delivered frames.
#[derive(Debug, Serialize)]
pub(super) struct CameraInfo {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) fx: f64,
    pub(super) fy: f64,
    /// Pixel centres at one half.
    pub(super) cx: f64,
    pub(super) cy: f64,
    pub(super) source: String,
    /// Whether the camera is a guess.
    pub(super) is_guess: bool,
    /// Size of the recorded pictures [px].
    pub(super) recorded: [usize; 2],
    /// Share of a frame that removing the lens distortion leaves empty.
    pub(super) uncovered: f64,
}

/// Ground truth in the dataset.
#[derive(Debug, Serialize)]
pub(super) struct GroundTruthInfo {
    pub(super) kinds: Vec<&'static str>,
    pub(super) poses: usize,
    pub(super) path_length_m: Option<f64>,
}

impl SequenceInfo {
    pub(super) fn new(sequence: &Sequence, truth: &GroundTruth) -> Self {
        let poses = &truth.trajectory;
        let frames_with_depth = sequence.frames_with_depth();
        let has_scale = frames_with_depth > 0 && sequence.layout != Layout::Record3d;
        let path_length_m = (!poses.is_empty()).then(|| path_length(poses));
        let truth = GroundTruthInfo { kinds: truth.kinds(), poses: poses.len(), path_length_m };
        Self {
            name: sequence.name.clone(),
            layout: sequence.layout_name().to_owned(),
            high_dynamic_range: sequence.high_dynamic_range(),
            frames: sequence.len(),
            frames_with_depth,
            left_out: sequence.dropped,
            times: TimeInfo::new(sequence),
            camera: CameraInfo::new(sequence),
            depth_scale: has_scale.then_some(sequence.depth_scale),
            is_depth_scale_assumed: has_scale && sequence.is_depth_scale_assumed,
            truth,
            paper_frames: paper_frames(&sequence.name).map(|range| [range.start, range.end]),
        }
    }
}

impl TimeInfo {
    fn new(sequence: &Sequence) -> Self {
        let entries = &sequence.entries;
        let stamps: Vec<(usize, f64)> = entries.iter().map(|e| (e.index, e.timestamp)).collect();
        let first_s = stamps.first().map_or(0.0, |s| s.1);
        let duration_s = stamps.last().map_or(0.0, |s| s.1) - first_s;
        let depth_gap = |e: &FrameEntry| Some((e.depth.as_ref()?.timestamp - e.timestamp).abs());
        let frames_per_second = match stamps.len() {
            2.. if duration_s > 0.0 => (stamps.len() - 1) as f64 / duration_s,
            _ => sequence.frame_rate,
        };
        let colour_to_depth_s = entries.iter().filter_map(depth_gap).fold(0.0, f64::max);
        Self {
            first_s,
            duration_s,
            frames_per_second,
            are_assumed: sequence.are_times_assumed,
            gaps: gaps(&stamps),
            colour_to_depth_s,
        }
    }
}

/// Gaps that are long against the median one, of stamps [s] with their frames.
fn gaps(stamps: &[(usize, f64)]) -> Vec<Gap> {
    let all: Vec<Gap> = stamps
        .windows(2)
        .map(|pair| Gap { after_frame: pair[0].0, seconds: pair[1].1 - pair[0].1 })
        .collect();
    let mut sorted: Vec<f64> = all.iter().map(|gap| gap.seconds).collect();
    sorted.sort_by(f64::total_cmp);
    let median = sorted.get(sorted.len() / 2).copied().unwrap_or(0.0);
    all.into_iter()
        .filter(|gap| gap.seconds >= MIN_GAP_RATIO * median && gap.seconds > 0.0)
        .collect()
}

impl CameraInfo {
    fn new(sequence: &Sequence) -> Self {
        let c = &sequence.camera;
        let uncovered = sequence.valid_mask.as_ref().map_or(0.0, |covered| {
            let missing = covered.data.iter().filter(|&&there| !there).count();
            missing as f64 / covered.data.len() as f64
        });
        let source = sequence.camera_source.clone();
        Self {
            width: c.width,
            height: c.height,
            fx: c.fx,
            fy: c.fy,
            cx: c.cx,
            cy: c.cy,
            source,
            is_guess: sequence.camera_is_guess,
            recorded: sequence.recorded_size.into(),
            uncovered,
        }
    }
}

fn path_length(poses: &[StampedPose]) -> f64 {
    let centre = |pose: &StampedPose| pose.world_from_camera.translation;
    poses.windows(2).map(|pair| (centre(&pair[1]) - centre(&pair[0])).norm()).sum()
}

/// The JSON object.
#[derive(Debug, Serialize)]
struct ImportInfo {
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

/// Prints imported keyframes if the path, which is no sequence for `reason`, holds some; returns
/// whether it does.
pub(super) fn print_keyframes(
    arguments: &Info,
    open: OpenOptions,
    reason: &DatasetError,
) -> Result<bool, Failure> {
    if !matches!(reason, DatasetError::UnknownLayout { .. }) {
        return Ok(false);
    }
    let options = ImportOptions { open, ..ImportOptions::default() };
    let files = match ImportedKeyframes::open(&arguments.dataset, None, &options) {
        Err(DatasetError::UnknownImport { .. }) => return Ok(false),
        files => files?,
    };
    let info = ImportInfo::new(&files);
    if arguments.json {
        print_json(&info)?;
        return Ok(true);
    }
    for (label, text) in info.rows() {
        print(&format!("{label:<18}{text}"));
    }
    for warning in &info.warnings {
        print_status(&format!("warning: {warning}"));
    }
    Ok(true)
}

impl ImportInfo {
    fn new(files: &ImportedKeyframes) -> Self {
        let (camera, poses) = (&files.camera, &files.keyframes);
        let place = |i: usize| poses[i].world_from_camera.translation;
        let first_s = poses.first().map_or(0.0, |pose| pose.timestamp);
        Self {
            kind: files.format.name(),
            poses: format!("{}: {}", files.path.display(), files.format.convention()),
            keyframes: files.len(),
            poses_without_picture: files.unmatched.poses_without_image,
            pictures_without_pose: files.unmatched.images_without_pose,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn long_gaps_are_found_against_the_median() {
        let stamps = [(3, 0.0), (4, 0.1), (5, 0.2), (6, 0.5), (9, 0.6), (10, 0.74)];
        let found = gaps(&stamps);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].after_frame, 5);
        assert!((found[0].seconds - 0.3).abs() < 1e-9);
        assert!(gaps(&[(0, 1.0)]).is_empty() && gaps(&[(0, 0.0), (1, 0.0)]).is_empty());
    }
}

//! Trajectory errors of a result or a trajectory file.

use super::estimate::Estimate;
use super::metric_value::TableRow;
use super::reference::Reference;
use super::{AlignmentGroup, Eval, Protocol};
use crate::console::counted;
use crate::failure::Failure;
use i2slam::dataset::read_trajectory;
use i2slam::geometry::StampedPose;
use i2slam_eval::EvalError;
use i2slam_eval::trajectory::{
    Alignment, DEFAULT_TOLERANCE, RelativePoseError, Step, TrajectoryError,
    absolute_trajectory_error, count_frames_without_pose, relative_pose_error,
};
use i2slam_result::UnitOfLength;
use serde::Serialize;
use serde_json::{Map, Value};

/// Largest difference of two stamps of one frame [s]; `trajectory.txt` has six decimals.
const SAME_STAMP: f64 = 1e-5;

/// Absolute and relative errors.
#[derive(Serialize)]
pub(super) struct TrajectoryErrors {
    #[serde(flatten)]
    absolute: TrajectoryError,
    /// `None` where no two poses are as far apart as a step is long.
    #[serde(flatten)]
    relative: Option<RelativePoseError>,
    #[serde(skip)]
    step: Step,
    /// Errors of the poses as they were known when their frames came.
    #[serde(flatten)]
    online: Option<OnlineErrors>,
    /// Poses of the trajectory, those without a true one among them.
    estimated_poses: usize,
    /// Frames of the run that have a true pose and no estimated one; `None` where the frames of the
    /// run are not known.
    frames_without_pose: Option<usize>,
}

/// Errors of the poses as they were known when their frames came, aligned by themselves.
#[derive(Serialize)]
struct OnlineErrors {
    online_ate_rmse_m: f64,
    online_ate_max_m: f64,
    online_pairs: usize,
}

/// The true trajectory: the file given, or that of the dataset given.
pub(super) fn truth(
    arguments: &Eval,
    reference: Option<&Reference>,
) -> Result<Option<Vec<StampedPose>>, Failure> {
    match &arguments.groundtruth {
        Some(file) => Ok(Some(read_trajectory(file)?)),
        None => Ok(reference.and_then(Reference::trajectory).map(<[StampedPose]>::to_vec)),
    }
}

pub(super) fn evaluate(
    arguments: &Eval,
    (estimate, reference): (&Estimate, Option<&Reference>),
    mut poses: Vec<StampedPose>,
    truth: &[StampedPose],
) -> Result<TrajectoryErrors, Failure> {
    let frames = reference.map(|reference| reference.frames_of_run(estimate)).transpose()?;
    let missing =
        |frames: Vec<f64>| count_frames_without_pose(&frames, &poses, truth, DEFAULT_TOLERANCE);
    let frames_without_pose = frames.flatten().map(missing).transpose()?;
    if arguments.protocol == Protocol::Monogs {
        keep_keyframes(&mut poses, estimate)?;
    }
    let alignment = alignment(arguments, estimate)?;
    let absolute = absolute_trajectory_error(&poses, truth, alignment, DEFAULT_TOLERANCE)?;
    let aligned = &absolute.aligned_estimate;
    let relative = match relative_pose_error(aligned, truth, arguments.rpe, DEFAULT_TOLERANCE) {
        Err(EvalError::TooFew { .. }) => None,
        measured => Some(measured?),
    };
    let online = online_errors(estimate, truth, alignment)?;
    let estimated_poses = poses.len();
    let step = arguments.rpe;
    Ok(TrajectoryErrors { absolute, relative, step, online, estimated_poses, frames_without_pose })
}

/// `None` without a `trajectory_online.txt`, or where that has too few true poses to be aligned.
fn online_errors(
    estimate: &Estimate,
    truth: &[StampedPose],
    alignment: Alignment,
) -> Result<Option<OnlineErrors>, Failure> {
    let Some(file) = estimate.online_trajectory() else { return Ok(None) };
    let poses = read_trajectory(&file)?;
    let errors = absolute_trajectory_error(&poses, truth, alignment, DEFAULT_TOLERANCE).ok();
    Ok(errors.map(|errors| OnlineErrors {
        online_ate_rmse_m: errors.ate_rmse_m,
        online_ate_max_m: errors.ate_max_m,
        online_pairs: errors.pairs,
    }))
}

/// The alignment asked for, else by the unit of length of the trajectory.
fn alignment(arguments: &Eval, estimate: &Estimate) -> Result<Alignment, Failure> {
    let fit = match arguments.align {
        Some(fit) => fit,
        None if estimate.unit_of_length()? == UnitOfLength::Metre => AlignmentGroup::Se3,
        None => AlignmentGroup::Sim3,
    };
    Ok(match fit {
        AlignmentGroup::Se3 => Alignment::Se3,
        AlignmentGroup::Sim3 => Alignment::Sim3,
    })
}

/// Reason why a trajectory of keyframes alone cannot be evaluated: an alignment takes three poses.
pub(super) fn too_few_keyframes(
    arguments: &Eval,
    estimate: &Estimate,
) -> Result<Option<String>, Failure> {
    if arguments.protocol != Protocol::Monogs {
        return Ok(None);
    }
    let frames = estimate.run_frames()?.unwrap_or_default();
    let keyframes = frames.iter().filter(|frame| frame.keyframe).count();
    Ok((!frames.is_empty() && keyframes < 3).then(|| {
        let have = counted(keyframes, "keyframe");
        format!(
            "trajectory: the protocol takes the poses of keyframes, and this run has {have}, where \
             three are needed: run more frames, or take --protocol all-frames"
        )
    }))
}

fn keep_keyframes(poses: &mut Vec<StampedPose>, estimate: &Estimate) -> Result<(), Failure> {
    let frames = estimate
        .run_frames()?
        .ok_or_else(|| Failure::usage("--protocol monogs needs a result folder with frames.csv"))?;
    let stamps: Vec<f64> = frames.iter().filter(|f| f.keyframe).map(|f| f.timestamp).collect();
    let same =
        |pose: &StampedPose| stamps.iter().any(|stamp| (stamp - pose.timestamp).abs() < SAME_STAMP);
    poses.retain(same);
    Ok(())
}

impl TrajectoryErrors {
    pub(super) fn is_scaled(&self) -> bool {
        matches!(self.absolute.alignment, Alignment::Sim3)
    }

    /// Ratio of true lengths to those of the trajectory: 1 where it is in metres.
    pub(super) fn scale(&self) -> f64 {
        if self.is_scaled() { self.absolute.scale } else { 1.0 }
    }

    pub(super) fn rows(&self) -> Vec<TableRow> {
        let t = &self.absolute;
        let fit = match t.alignment {
            Alignment::Se3 => ", aligned by SE(3)".to_owned(),
            Alignment::Sim3 => format!(", aligned by Sim(3), scale {:.4}", t.scale),
        };
        let row = |name: &str, number: String, rest: &str| TableRow {
            name: name.to_owned(),
            number,
            rest: rest.to_owned(),
        };
        let pairs = match self.estimated_poses {
            all if all > t.pairs => format!(" of {all}, the others have no true pose{fit}"),
            _ => fit,
        };
        let mut rows = vec![row("poses", t.pairs.to_string(), &pairs)];
        if let Some(missing) = self.frames_without_pose {
            rows.push(row("frames without a pose", missing.to_string(), ""));
        }
        let centimetres = [
            ("ATE RMSE", t.ate_rmse_m),
            ("ATE mean", t.ate_mean_m),
            ("ATE median", t.ate_median_m),
            ("ATE largest", t.ate_max_m),
            ("SplaTAM's mean (world to cam)", t.splatam_mean_m),
        ];
        let number = |value: f64| format!("{value:.4}");
        rows.extend(centimetres.map(|(name, metres)| row(name, number(100.0 * metres), " cm")));
        rows.extend(self.online.iter().map(|online| {
            let most = 100.0 * online.online_ate_max_m;
            let rest = format!(" cm, largest {most:.4}, of {} poses", online.online_pairs);
            row("ATE RMSE when frames came", number(100.0 * online.online_ate_rmse_m), &rest)
        }));
        let over = match self.step {
            Step::Frames(1) => "a frame".to_owned(),
            Step::Frames(n) | Step::OverlappingFrames(n) => counted(n, "frame"),
            Step::Seconds(s) => format!("{s} s"),
        };
        let Some(relative) = &self.relative else {
            let why = format!(" no two poses are {over} apart");
            rows.push(row("RPE", "-".to_owned(), &why));
            return rows;
        };
        let relative = [
            ("RPE translation RMSE", 100.0 * relative.rpe_translation_rmse_m, "cm"),
            ("RPE rotation RMSE", relative.rpe_rotation_rmse_deg, "degrees"),
        ];
        rows.extend(
            relative.map(|(name, value, unit)| {
                row(name, number(value), &format!(" {unit} over {over}"))
            }),
        );
        rows
    }

    pub(super) fn json(&self) -> Result<Map<String, Value>, Failure> {
        match serde_json::to_value(self) {
            Ok(Value::Object(object)) => Ok(object),
            Ok(_) => Ok(Map::new()),
            Err(error) => Err(Failure::Failed(error.to_string())),
        }
    }
}

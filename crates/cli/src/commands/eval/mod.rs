//! `i2slam eval`: compares a result, a trajectory or pictures with ground truth.

mod estimate;
mod evaluation;
mod frames;
mod metric_value;
mod pictures;
mod pose_optimization;
mod reference;
mod tones;
mod trajectory;

use crate::arguments::{Machine, existing_path};
use crate::console::{print, print_status};
use crate::failure::{Failure, print_json};
use crate::messages::note_saved_parts;
use clap::{Args, ValueEnum};
use estimate::Estimate;
use evaluation::Evaluation;
use i2slam::dataset::read_trajectory;
use i2slam_eval::trajectory::Step;
use i2slam_result::load;
use reference::Reference;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(crate) struct Eval {
    /// Result folder of a run, a trajectory in the TUM format, or a folder of pictures
    pub(crate) estimate: PathBuf,
    /// True trajectory in the TUM format [default: that of the dataset]
    #[arg(long, value_name = "FILE", value_parser = existing_path())]
    pub(crate) groundtruth: Option<PathBuf>,
    /// True pictures: a folder of NNNNNN.png (or .exr) named as the renders, or the dataset of the
    /// run (its sharp/ if there is one, else the pictures taken) [default: the dataset that the
    /// result names]
    #[arg(long, value_name = "DIR", value_parser = existing_path())]
    pub(crate) reference: Option<PathBuf>,
    /// Which frames are compared, and by which metrics
    #[arg(long, value_enum, default_value_t = Protocol::AllFrames, value_name = "NAME")]
    pub(crate) protocol: Protocol,
    /// Compare these frames only: a file with one frame number a line, a published list (names:
    /// --list help), or `auto` for the sharp frames of the dataset
    #[arg(long, value_name = "LIST")]
    pub(crate) list: Option<String>,
    /// Write the list of the sharp frames of ESTIMATE, a dataset or a folder of pictures
    #[arg(long, value_name = "FILE", conflicts_with_all = ["reference", "groundtruth", "list"])]
    pub(crate) write_list: Option<PathBuf>,
    /// Replace an earlier list of that name
    #[arg(long, requires = "write_list")]
    pub(crate) overwrite: bool,
    /// With --protocol splatam, the first and every N-th frame
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..))]
    pub(crate) every: u32,
    /// Optimise the pose of every frame against its true picture before rendering, which leaves
    /// pose errors out. Needs the map of the result
    #[arg(long)]
    pub(crate) optimise_poses: bool,
    /// Compare the renders that exist, even if others are missing
    #[arg(long)]
    pub(crate) partial: bool,
    /// Alignment before trajectory errors are measured [default: se3, or sim3 for a trajectory of
    /// unknown unit of length]
    #[arg(long, value_enum, value_name = "GROUP")]
    pub(crate) align: Option<AlignmentGroup>,
    /// Step of the relative pose error: frames (`1`, `30`) or seconds (`0.5s`)
    #[arg(long, value_name = "STEP", default_value = "1", value_parser = relative_step)]
    pub(crate) rpe: Step,
    /// Print JSON
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

/// Published evaluation protocols.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Protocol {
    /// Every frame that has a true picture
    AllFrames,
    /// I2-SLAM: listed sharp frames, poses at mid-exposure
    I2slam,
    /// SplaTAM: the first and every N-th frame, pixels with true depth
    Splatam,
    /// MonoGS: every fifth frame that is no keyframe; trajectory error of keyframes
    Monogs,
    /// Frames that the map never saw (`i2slam run --hold-out N`)
    HeldOut,
}

/// Alignment of two trajectories.
#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum AlignmentGroup {
    /// Rotation and translation
    Se3,
    /// Rotation, translation and scale
    Sim3,
}

fn relative_step(text: &str) -> Result<Step, String> {
    let step = match text.trim().strip_suffix('s') {
        Some(seconds) => seconds.parse().ok().map(Step::Seconds),
        None => text.trim().parse().ok().map(Step::Frames),
    };
    let sound = |step: &Step| match *step {
        Step::Frames(n) | Step::OverlappingFrames(n) => n > 0,
        Step::Seconds(s) => s.is_finite() && s > 0.0,
    };
    step.filter(sound).ok_or_else(|| "expected frames as in 30, or seconds as in 0.5s".to_owned())
}

pub(crate) fn eval(arguments: &Eval) -> Result<(), Failure> {
    if arguments.list.as_deref() == Some("help") {
        frames::published_lists().iter().for_each(|line| print(line));
        return Ok(());
    }
    arguments.machine.use_threads()?;
    if let Some(file) = &arguments.write_list {
        return frames::write_list(&arguments.estimate, file, arguments.overwrite);
    }
    let lists = matches!(arguments.protocol, Protocol::AllFrames | Protocol::I2slam);
    if !lists && arguments.list.is_some() {
        return Err(Failure::usage("--list goes with the protocols all-frames and i2slam"));
    }
    note_saved_parts(&i2slam_storage::recover(&arguments.estimate));
    let estimate = Estimate::open(&arguments.estimate)?;
    let evaluation = evaluate(arguments, &estimate)?;
    if arguments.json {
        print_json(&evaluation.json()?)?;
    } else {
        evaluation.print();
    }
    if let (Some(result), None) = (estimate.result(), &evaluation.problem) {
        let added = evaluation::add_to_report(result, evaluation.section(arguments));
        if let Some(reason) = added.err().as_ref().and_then(Failure::message) {
            print_status(&format!("warning: the report is not updated: {reason}"));
        }
    }
    evaluation.problem.map_or(Ok(()), Err)
}

fn evaluate(arguments: &Eval, estimate: &Estimate) -> Result<Evaluation, Failure> {
    if arguments.optimise_poses {
        pose_optimization::check(arguments, estimate)?;
    }
    let reference = find_reference(arguments, estimate)?;
    let mut evaluation =
        Evaluation { protocol: protocol_name(arguments.protocol), ..Default::default() };
    evaluation.foreign = reference::foreign_ground_truth(arguments, estimate, reference.as_ref())?;
    evaluate_trajectory(arguments, estimate, reference.as_ref(), &mut evaluation)?;
    let Some(reference) = &reference else {
        return match (&evaluation.trajectory, evaluation.not_evaluated.pop()) {
            (Some(_), _) => Ok(evaluation),
            (None, Some(reason)) => Err(Failure::Failed(reason)),
            (None, None) => Err(Failure::usage(
                "nothing to compare with: give --groundtruth, --reference or both",
            )),
        };
    };
    evaluation.tones = tones::evaluate(estimate, reference)?;
    match evaluate_pictures(arguments, estimate, reference, &mut evaluation) {
        Err(Failure::Failed(reason))
            if evaluation.trajectory.is_some() || !evaluation.not_evaluated.is_empty() =>
        {
            evaluation.problem = Some(Failure::Failed(reason));
        }
        other => other?,
    }
    Ok(evaluation)
}

fn evaluate_trajectory(
    arguments: &Eval,
    estimate: &Estimate,
    reference: Option<&Reference>,
    evaluation: &mut Evaluation,
) -> Result<(), Failure> {
    let truth = trajectory::truth(arguments, reference)?;
    let Some(file) = estimate.trajectory() else {
        if arguments.groundtruth.is_some() {
            return Err(Failure::usage(
                "--groundtruth needs a result folder or a trajectory, not pictures",
            ));
        }
        return Ok(());
    };
    let Some(truth) = truth else {
        let path = reference.map(|reference| reference.path().display());
        let none = path.map(|path| format!("trajectory: {path} has no true poses"));
        evaluation.not_evaluated.extend(none);
        return Ok(());
    };
    if let Some(reason) = trajectory::too_few_keyframes(arguments, estimate)? {
        evaluation.not_evaluated.push(reason);
        return Ok(());
    }
    let poses = read_trajectory(&file)?;
    match trajectory::evaluate(arguments, (estimate, reference), poses, &truth) {
        Ok(errors) => evaluation.trajectory = Some(errors),
        // The dataset's own trajectory was not asked for: go on with its pictures.
        Err(Failure::Failed(reason)) if arguments.groundtruth.is_none() => {
            evaluation.not_evaluated.push(format!("trajectory: {reason}"));
            return Ok(());
        }
        Err(failure) => return Err(failure),
    }
    evaluation.true_trajectory = reference::trajectory_source(arguments, reference, &truth);
    Ok(())
}

fn evaluate_pictures(
    arguments: &Eval,
    estimate: &Estimate,
    reference: &Reference,
    evaluation: &mut Evaluation,
) -> Result<(), Failure> {
    let wanted = frames::select(arguments, estimate, reference)?;
    if arguments.optimise_poses {
        let drawn =
            pose_optimization::draw((estimate, reference), &wanted, arguments.machine.quiet)?;
        evaluation.corrections = Some(drawn);
    } else if let (Some(result), Some(_)) = (estimate.result(), &evaluation.trajectory)
        && estimate.renders("sharp", "png")?.is_empty()
    {
        let has_map = !load(result).is_ok_and(|found| found.map.is_empty());
        let result = result.display();
        evaluation.not_evaluated.push(match has_map {
            true => format!(
                "pictures: {result} has no renders/sharp (`i2slam render {result}` draws them)"
            ),
            false => format!("pictures: {result} has no map to draw them from"),
        });
        return Ok(());
    }
    let chosen = frames::match_renders(arguments, estimate, reference, wanted)?;
    if !arguments.optimise_poses {
        evaluation.radiance = pictures::evaluate_radiance(estimate, reference, &chosen)?;
    }
    let only_radiance = chosen.frames.is_empty() && !evaluation.radiance.is_empty();
    if !only_radiance {
        let scale = evaluation.trajectory.as_ref().map_or(1.0, |errors| errors.scale());
        let evaluated = pictures::evaluate(arguments, (estimate, reference), scale, chosen)?;
        evaluation.true_pictures = Some(reference::picture_source(reference, &evaluated.checksums));
        evaluation.pictures = Some(evaluated);
        evaluation.is_against_recorded = reference.uses_recorded();
    }
    Ok(())
}

/// The given reference, else the dataset that the result names; none if only `--groundtruth` is
/// given.
fn find_reference(arguments: &Eval, estimate: &Estimate) -> Result<Option<Reference>, Failure> {
    match (&arguments.reference, estimate) {
        (Some(_), Estimate::Trajectory(_)) => {
            Err(Failure::usage("--reference needs a result folder or pictures, not a trajectory"))
        }
        (Some(folder), _) => Reference::open(folder, estimate).map(Some),
        (None, Estimate::Pictures(_)) => {
            Err(Failure::usage("a folder of pictures needs --reference, or --write-list"))
        }
        (None, _) if arguments.groundtruth.is_some() && !arguments.optimise_poses => Ok(None),
        (None, _) => Reference::recorded(estimate),
    }
}

/// Name on the command line.
fn protocol_name(protocol: Protocol) -> String {
    protocol.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_are_frames_or_seconds() {
        assert_eq!(relative_step("30"), Ok(Step::Frames(30)));
        assert_eq!(relative_step("0.5s"), Ok(Step::Seconds(0.5)));
        for wrong in ["0", "0s", "-1s", "1.5", "x", "", "infs"] {
            assert!(relative_step(wrong).is_err(), "{wrong}");
        }
    }
}

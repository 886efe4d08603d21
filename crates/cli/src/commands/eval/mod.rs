//! `i2slam eval`: a result, a trajectory or pictures against the truth.

mod evaluation;
mod figure;
mod frames;
mod lists;
mod metrics;
mod optimise;
mod pictures;
mod radiance;
mod reference;
mod report;
mod source;
mod subject;
mod trajectory;

use crate::arguments::{Eval, Protocol};
use crate::failure::Failure;
use crate::output::{complain, say};
use evaluation::Evaluation;
use i2slam::dataset::read_trajectory;
use reference::Reference;
use std::path::Path;
use subject::Subject;

pub(crate) fn eval(arguments: &Eval) -> Result<(), Failure> {
    if arguments.list.as_deref() == Some("help") {
        lists::published().iter().for_each(|line| say(line));
        return Ok(());
    }
    if let Some(file) = &arguments.write_list {
        return lists::write(&arguments.estimate, file, arguments.overwrite);
    }
    let lists = matches!(arguments.protocol, Protocol::AllFrames | Protocol::I2slam);
    if !lists && arguments.list.is_some() {
        let message = "--list goes with the protocols all-frames and i2slam";
        return Err(Failure::Usage(message.to_owned()));
    }
    let subject = Subject::find(&arguments.estimate)?;
    let evaluation = judge(arguments, &subject)?;
    if arguments.json {
        let text = serde_json::to_string_pretty(&evaluation.json()?);
        say(&text.map_err(|e| Failure::Failed(e.to_string()))?);
    } else {
        evaluation.print();
    }
    if let (Some(result), None) = (subject.result(), &evaluation.problem) {
        let added = report::add(result, evaluation.section(arguments));
        if let Some(reason) = added.err().as_ref().and_then(Failure::message) {
            complain(&format!("warning: the report is not updated: {reason}"));
        }
    }
    evaluation.problem.map_or(Ok(()), Err)
}

fn judge(arguments: &Eval, subject: &Subject) -> Result<Evaluation, Failure> {
    if arguments.optimise_poses {
        optimise::check(arguments, subject)?;
    }
    let reference = reference(arguments, subject)?;
    let mut evaluation = Evaluation { protocol: name(arguments.protocol), ..Default::default() };
    evaluation.foreign = source::foreign(arguments, subject, reference.as_ref())?;
    judge_trajectory(arguments, subject, reference.as_ref(), &mut evaluation)?;
    let Some(reference) = &reference else {
        return match (&evaluation.trajectory, evaluation.not_judged.pop()) {
            (Some(_), _) => Ok(evaluation),
            (None, Some(reason)) => Err(Failure::Failed(reason)),
            (None, None) => {
                let message = "nothing to compare with: give --groundtruth, --reference or both";
                Err(Failure::Usage(message.to_owned()))
            }
        };
    };
    match judge_pictures(arguments, subject, reference, &mut evaluation) {
        Err(Failure::Failed(reason))
            if evaluation.trajectory.is_some() || !evaluation.not_judged.is_empty() =>
        {
            evaluation.problem = Some(Failure::Failed(reason));
        }
        other => other?,
    }
    Ok(evaluation)
}

fn judge_trajectory(
    arguments: &Eval,
    subject: &Subject,
    reference: Option<&Reference>,
    evaluation: &mut Evaluation,
) -> Result<(), Failure> {
    let truth = trajectory::truth(arguments, reference)?;
    let Some(file) = subject.trajectory() else {
        if arguments.groundtruth.is_some() {
            let message = "--groundtruth needs a result folder or a trajectory, not pictures";
            return Err(Failure::Usage(message.to_owned()));
        }
        return Ok(());
    };
    let Some(truth) = truth else {
        let path = reference.map(|reference| reference.path().display());
        let none = path.map(|path| format!("trajectory: {path} has no true poses"));
        evaluation.not_judged.extend(none);
        return Ok(());
    };
    if let Some(reason) = trajectory::too_few_keyframes(arguments, subject)? {
        evaluation.not_judged.push(reason);
        return Ok(());
    }
    let estimate = read_trajectory(&file)?;
    match trajectory::judge(arguments, subject, estimate, &truth) {
        Ok(errors) => evaluation.trajectory = Some(errors),
        // The dataset's own truth was not asked for: its pictures are judged all the same.
        Err(Failure::Failed(reason)) if arguments.groundtruth.is_none() => {
            evaluation.not_judged.push(format!("trajectory: {reason}"));
            return Ok(());
        }
        Err(failure) => return Err(failure),
    }
    evaluation.true_trajectory = source::of_trajectory(arguments, reference, &truth);
    Ok(())
}

fn judge_pictures(
    arguments: &Eval,
    subject: &Subject,
    reference: &Reference,
    evaluation: &mut Evaluation,
) -> Result<(), Failure> {
    let wanted = frames::wanted(arguments, subject, reference)?;
    if arguments.optimise_poses {
        let drawn = optimise::draw(subject, reference, &wanted)?;
        evaluation.corrections = Some(drawn);
    } else if let (Some(result), Some(_)) = (subject.result(), &evaluation.trajectory)
        && subject.renders("sharp", "png")?.is_empty()
    {
        let result = result.display();
        evaluation.not_judged.push(format!(
            "pictures: {result} has no renders/sharp (`i2slam render {result}` draws them)"
        ));
        return Ok(());
    }
    let chosen = frames::choose(arguments, subject, reference, wanted)?;
    if !arguments.optimise_poses {
        evaluation.radiance = radiance::judge(subject, reference, &chosen)?;
    }
    let only_radiance = chosen.frames.is_empty() && !evaluation.radiance.is_empty();
    if !only_radiance {
        let judged = pictures::judge(arguments, subject, reference, chosen)?;
        evaluation.true_pictures = Some(source::of_pictures(reference, &judged.checksums));
        evaluation.pictures = Some(judged);
        evaluation.as_taken = reference.is_as_taken();
    }
    Ok(())
}

/// What is given, else the dataset that the result names, unless a trajectory alone is asked for.
fn reference(arguments: &Eval, subject: &Subject) -> Result<Option<Reference>, Failure> {
    match (&arguments.reference, subject) {
        (Some(_), Subject::Trajectory(_)) => {
            let message = "--reference needs a result folder or pictures, not a trajectory";
            Err(Failure::Usage(message.to_owned()))
        }
        (Some(folder), _) => Reference::open(folder, subject).map(Some),
        (None, Subject::Pictures(_)) => {
            let message = "a folder of pictures needs --reference, or --write-list";
            Err(Failure::Usage(message.to_owned()))
        }
        (None, _) if arguments.groundtruth.is_some() && !arguments.optimise_poses => Ok(None),
        (None, _) => Reference::recorded(subject),
    }
}

/// As it is typed.
fn name(protocol: Protocol) -> &'static str {
    match protocol {
        Protocol::AllFrames => "all-frames",
        Protocol::I2slam => "i2slam",
        Protocol::Splatam => "splatam",
        Protocol::Monogs => "monogs",
        Protocol::HeldOut => "held-out",
    }
}

/// `PATH: reason`.
fn failed(path: &Path, reason: impl std::fmt::Display) -> Failure {
    Failure::Failed(format!("{}: {reason}", path.display()))
}

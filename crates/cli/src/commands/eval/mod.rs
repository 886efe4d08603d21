//! `i2slam eval`: a result, a trajectory or pictures against the truth.

mod figure;
mod frames;
mod lists;
mod metrics;
mod pictures;
mod radiance;
mod reference;
mod subject;
mod trajectory;

use crate::arguments::{Eval, Protocol};
use crate::failure::Failure;
use crate::output::{complain, say};
use figure::Figure;
use pictures::Judged;
use reference::Reference;
use serde_json::{Map, Value};
use std::path::Path;
use subject::Subject;

/// All figures of an evaluation.
#[derive(Default)]
struct Evaluation {
    protocol: &'static str,
    trajectory: Option<trajectory::Errors>,
    pictures: Option<Judged>,
    radiance: Vec<Figure>,
}

pub(crate) fn eval(arguments: &Eval) -> Result<(), Failure> {
    if arguments.list.as_deref() == Some("help") {
        lists::published().iter().for_each(|line| say(line));
        return Ok(());
    }
    if let Some(file) = &arguments.write_list {
        return lists::write(&arguments.estimate, file);
    }
    let own_frames = matches!(arguments.protocol, Protocol::Splatam | Protocol::Monogs);
    if own_frames && arguments.list.is_some() {
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
    Ok(())
}

fn judge(arguments: &Eval, subject: &Subject) -> Result<Evaluation, Failure> {
    let reference = reference(arguments, subject)?;
    let truth = trajectory::truth(arguments, reference.as_ref())?;
    let mut evaluation = Evaluation { protocol: name(arguments.protocol), ..Default::default() };
    evaluation.trajectory = match (subject.trajectory(), truth) {
        (Some(file), Some(truth)) => Some(trajectory::judge(arguments, subject, &file, &truth)?),
        (None, Some(_)) => {
            let message = "--groundtruth needs a result folder or a trajectory, not pictures";
            return Err(Failure::Usage(message.to_owned()));
        }
        (_, None) => None,
    };
    if let Some(reference) = &reference {
        let chosen = frames::choose(arguments, subject, reference)?;
        evaluation.radiance = radiance::judge(subject, reference, &chosen)?;
        let only_radiance = chosen.frames.is_empty() && !evaluation.radiance.is_empty();
        if !only_radiance {
            evaluation.pictures = Some(pictures::judge(arguments, subject, reference, chosen)?);
        }
    }
    if evaluation.trajectory.is_none() && reference.is_none() {
        let message = "nothing to compare with: give --groundtruth, --reference or both";
        return Err(Failure::Usage(message.to_owned()));
    }
    Ok(evaluation)
}

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
        (None, _) => Ok(None),
    }
}

/// As it is typed.
fn name(protocol: Protocol) -> &'static str {
    match protocol {
        Protocol::AllFrames => "all-frames",
        Protocol::I2slam => "i2slam",
        Protocol::Splatam => "splatam",
        Protocol::Monogs => "monogs",
    }
}

/// `PATH: reason`.
fn failed(path: &Path, reason: impl std::fmt::Display) -> Failure {
    Failure::Failed(format!("{}: {reason}", path.display()))
}

impl Evaluation {
    /// One flat object, and the frames one by one.
    fn json(&self) -> Result<Value, Failure> {
        let mut object = Map::new();
        object.insert("protocol".to_owned(), self.protocol.into());
        if let Some(errors) = &self.trajectory {
            object.extend(errors.json()?);
        }
        if let Some(pictures) = &self.pictures {
            object.extend(pictures.json());
        }
        object.extend(self.radiance.iter().map(Figure::json));
        Ok(Value::Object(object))
    }

    fn print(&self) {
        if let Some(errors) = &self.trajectory {
            errors.lines().iter().for_each(|line| say(line));
        }
        if let Some(pictures) = &self.pictures {
            pictures.lines().iter().for_each(|line| say(line));
            pictures.remarks().iter().for_each(|line| complain(line));
        }
        self.radiance.iter().for_each(|figure| say(&figure.line()));
    }
}

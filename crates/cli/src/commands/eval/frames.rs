//! Which frames a protocol judges.

use super::lists;
use super::reference::Reference;
use super::subject::{Pictures, RunFrame, Subject};
use crate::arguments::{Eval, Protocol};
use crate::failure::Failure;
use crate::output::counted;
use std::path::PathBuf;

/// MonoGS judges every so many frames.
const MONOGS_INTERVAL: usize = 5;

/// The frames to judge, ascending.
#[derive(Debug)]
pub(super) struct Chosen {
    /// Frame and its render.
    pub(super) frames: Vec<(usize, PathBuf)>,
    /// Frames that should be judged and have no render.
    pub(super) missing: Vec<usize>,
    /// The list that chose them.
    pub(super) list: Option<String>,
}

/// The frames that protocol and list name and that have a true picture, rendered or not.
pub(super) fn wanted(
    arguments: &Eval,
    subject: &Subject,
    reference: &Reference,
) -> Result<Vec<usize>, Failure> {
    let run = subject.run_frames()?;
    let known = reference.frames();
    let demanded = demanded(arguments, run.as_deref(), reference)?;
    let wanted: Vec<usize> = match &demanded {
        Some(frames) => {
            let within = within_run(frames, run.as_deref());
            if within.is_empty() {
                return Err(nothing_demanded(arguments, frames, run.as_deref()));
            }
            within
        }
        None => match &run {
            Some(run) => run.iter().map(|f| f.index).collect(),
            None => known.clone(),
        },
    };
    Ok(wanted.into_iter().filter(|frame| known.binary_search(frame).is_ok()).collect())
}

/// Those of them that are drawn.
pub(super) fn choose(
    arguments: &Eval,
    subject: &Subject,
    reference: &Reference,
    wanted: Vec<usize>,
) -> Result<Chosen, Failure> {
    let kind = if arguments.optimise_poses { "optimised/sharp" } else { "sharp" };
    let renders = subject.renders(kind, "png")?;
    let chosen = Chosen { list: list(arguments), ..split(wanted, &renders) };
    check(arguments, subject, reference, &renders, &chosen)?;
    Ok(chosen)
}

/// The frames that protocol and list name; `None` for all.
fn demanded(
    arguments: &Eval,
    run: Option<&[RunFrame]>,
    reference: &Reference,
) -> Result<Option<Vec<usize>>, Failure> {
    let listed = |list: &str| lists::frames(list, reference);
    let frames = match arguments.protocol {
        Protocol::AllFrames | Protocol::I2slam => {
            list(arguments).as_deref().map(listed).transpose()?
        }
        Protocol::Splatam => Some(splatam(needed(run)?, arguments.every as usize)),
        Protocol::Monogs => Some(monogs(needed(run)?)),
        Protocol::HeldOut => Some(held_out(needed(run)?)?),
    };
    Ok(frames)
}

/// The list as typed; the paper's protocol finds the sharp frames itself where none is given.
fn list(arguments: &Eval) -> Option<String> {
    let own = (arguments.protocol == Protocol::I2slam).then(|| "auto".to_owned());
    arguments.list.clone().or(own)
}

fn needed(run: Option<&[RunFrame]>) -> Result<&[RunFrame], Failure> {
    run.ok_or_else(|| {
        let message = "this protocol needs a result folder with frames.csv";
        Failure::Usage(message.to_owned())
    })
}

/// The first and every n-th: places 0, n - 1, 2n - 1, …
fn splatam(run: &[RunFrame], every: usize) -> Vec<usize> {
    let judged = |place: &usize| *place == 0 || (place + 1).is_multiple_of(every);
    (0..run.len()).filter(judged).map(|place| run[place].index).collect()
}

/// Places 0, 5, 10, … before the last, no keyframes.
fn monogs(run: &[RunFrame]) -> Vec<usize> {
    let end = run.len().saturating_sub(1);
    let frames = run[..end].iter().step_by(MONOGS_INTERVAL).filter(|frame| !frame.keyframe);
    frames.map(|frame| frame.index).collect()
}

/// Frames that the map never saw.
fn held_out(run: &[RunFrame]) -> Result<Vec<usize>, Failure> {
    let frames: Vec<usize> = run.iter().filter(|f| f.held_out).map(|f| f.index).collect();
    if frames.is_empty() {
        let message = "this run held no frame out, its map has seen them all: run it again with \
                       --hold-out 8";
        return Err(Failure::Usage(message.to_owned()));
    }
    Ok(frames)
}

/// Why protocol and list name no frame of the run, and what to do.
fn nothing_demanded(arguments: &Eval, frames: &[usize], run: Option<&[RunFrame]>) -> Failure {
    let count = run.map_or_else(String::new, |run| format!(" {}", counted(run.len(), "frame")));
    let all = "--protocol all-frames judges every frame";
    let message = match (list(arguments), frames) {
        (Some(list), []) if list == "auto" => format!(
            "none of the frames of this dataset stands out as sharp (list `auto`: an eleven-frame \
             neighbourhood has at most one, 1.1 times as sharp as those around it): {all}, --list \
             FILE those that a file names"
        ),
        (Some(list), frames) => format!(
            "the list `{list}` holds {} ({}), none of the{count} of this run: {all}, --list FILE \
             those that a file names",
            counted(frames.len(), "frame"),
            shortened(frames)
        ),
        (None, _) => format!("the protocol judges none of the{count} of this run: {all}"),
    };
    Failure::Failed(message)
}

fn within_run(frames: &[usize], run: Option<&[RunFrame]>) -> Vec<usize> {
    let processed = |frame: &usize| run.is_none_or(|run| run.iter().any(|f| f.index == *frame));
    frames.iter().copied().filter(processed).collect()
}

fn split(judged: Vec<usize>, renders: &Pictures) -> Chosen {
    let (mut frames, mut missing) = (Vec::new(), Vec::new());
    for frame in judged {
        match renders.get(&frame) {
            Some(file) => frames.push((frame, file.clone())),
            None => missing.push(frame),
        }
    }
    Chosen { frames, missing, list: None }
}

/// A render that is missing must not make the mean better without a word.
fn check(
    arguments: &Eval,
    subject: &Subject,
    reference: &Reference,
    renders: &Pictures,
    chosen: &Chosen,
) -> Result<(), Failure> {
    let path = arguments.estimate.display();
    let pictures = matches!(subject, Subject::Pictures(_));
    let only_radiance = renders.is_empty() && pictures;
    if chosen.frames.is_empty() && !only_radiance && (pictures || chosen.missing.is_empty()) {
        return Err(Failure::Failed(format!(
            "no picture of {path} has a partner in {} that is to be judged (NNNNNN.png)",
            reference.path().display()
        )));
    }
    let partial = arguments.partial && !chosen.frames.is_empty();
    if chosen.missing.is_empty() || partial || only_radiance {
        return Ok(());
    }
    let (count, names) = (counted(chosen.missing.len(), "frame"), shortened(&chosen.missing));
    let remedy = match (chosen.frames.is_empty(), pictures) {
        (true, _) => format!("`i2slam render {path}` draws them"),
        (false, true) => "--partial judges the others".to_owned(),
        (false, false) => {
            format!("`i2slam render {path}` draws all, --partial judges those that are there")
        }
    };
    Err(Failure::Failed(format!(
        "{path} has no render of {count} to be judged ({names}): {remedy}"
    )))
}

/// The first of many numbers.
pub(super) fn shortened(frames: &[usize]) -> String {
    let first: Vec<String> = frames.iter().take(5).map(|f| format!("{f:06}")).collect();
    let more = if frames.len() > first.len() { ", …" } else { "" };
    first.join(", ") + more
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run(keyframes: &[usize]) -> Vec<RunFrame> {
        let frame = |place: usize| RunFrame {
            index: 100 + place,
            timestamp: place as f64,
            keyframe: keyframes.contains(&place),
            held_out: false,
        };
        (0..16).map(frame).collect()
    }

    #[test]
    fn splatam_judges_the_first_and_every_nth() {
        assert_eq!(splatam(&run(&[]), 5), [100, 104, 109, 114]);
        assert_eq!(splatam(&run(&[]), 500), [100]);
    }

    #[test]
    fn monogs_judges_every_fifth_that_is_no_keyframe_nor_the_last() {
        assert_eq!(monogs(&run(&[0, 10])), [105]);
        assert_eq!(monogs(&run(&[])), [100, 105, 110]);
        assert!(monogs(&[]).is_empty());
    }

    #[test]
    fn held_out_frames_are_those_of_the_run() {
        let mut frames = run(&[]);
        let message = held_out(&frames).expect_err("all were mapped");
        assert!(message.message().is_some_and(|m| m.contains("--hold-out")));
        frames[6].held_out = true;
        assert_eq!(held_out(&frames).ok(), Some(vec![106]));
    }
}

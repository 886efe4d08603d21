//! Selection of the evaluated frames: by protocol, by a list, or by sharpness.

use super::estimate::{Estimate, PictureFiles, RunFrame, picture_files};
use super::reference::Reference;
use super::{Eval, Protocol};
use crate::console::{counted, print};
use crate::failure::{Failure, failed};
use crate::image_files::read_png;
use i2slam::dataset::{OpenOptions, Sequence};
use i2slam::geometry::Image;
use i2slam_eval::frame_list;
use i2slam_eval::sharpness::{SharpnessRule, laplacian_variance, sharp_frames};
use i2slam_storage::write_file;
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Interval of the frames that MonoGS evaluates.
const MONOGS_INTERVAL: usize = 5;

/// Frames to evaluate, ascending.
#[derive(Debug)]
pub(super) struct FrameSelection {
    /// Frame number and render.
    pub(super) frames: Vec<(usize, PathBuf)>,
    /// Frames without a render.
    pub(super) missing: Vec<usize>,
    /// Name of the list that selected them.
    pub(super) list: Option<String>,
}

/// Frames selected by protocol and list that have a true picture, rendered or not.
pub(super) fn select(
    arguments: &Eval,
    estimate: &Estimate,
    reference: &Reference,
) -> Result<Vec<usize>, Failure> {
    let run = estimate.run_frames()?;
    let known = reference.frames();
    let named_frames = named_frames(arguments, run.as_deref(), reference)?;
    let wanted: Vec<usize> = match &named_frames {
        Some(frames) => {
            let within = within_run(frames, run.as_deref());
            if within.is_empty() {
                return Err(no_frame_error(arguments, frames, run.as_deref()));
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

/// Splits selected frames into rendered and missing ones.
pub(super) fn match_renders(
    arguments: &Eval,
    estimate: &Estimate,
    reference: &Reference,
    wanted: Vec<usize>,
) -> Result<FrameSelection, Failure> {
    let kind = if arguments.optimise_poses { "optimised/sharp" } else { "sharp" };
    let renders = estimate.renders(kind, "png")?;
    let chosen = FrameSelection { list: list(arguments), ..split(wanted, &renders) };
    check_missing(arguments, estimate, reference, &renders, &chosen)?;
    Ok(chosen)
}

/// Frames named by protocol or list; `None` for all.
fn named_frames(
    arguments: &Eval,
    run: Option<&[RunFrame]>,
    reference: &Reference,
) -> Result<Option<Vec<usize>>, Failure> {
    let listed = |list: &str| listed_frames(list, reference);
    let frames = match arguments.protocol {
        Protocol::AllFrames | Protocol::I2slam => {
            list(arguments).as_deref().map(listed).transpose()?
        }
        Protocol::Splatam => Some(splatam_frames(required_frames(run)?, arguments.every as usize)),
        Protocol::Monogs => Some(monogs_frames(required_frames(run)?)),
        Protocol::HeldOut => Some(held_out_frames(required_frames(run)?)?),
    };
    Ok(frames)
}

/// The given list; by default `auto` for the protocol of the paper.
fn list(arguments: &Eval) -> Option<String> {
    let own = (arguments.protocol == Protocol::I2slam).then(|| "auto".to_owned());
    arguments.list.clone().or(own)
}

fn required_frames(run: Option<&[RunFrame]>) -> Result<&[RunFrame], Failure> {
    run.ok_or_else(|| Failure::usage("this protocol needs a result folder with frames.csv"))
}

/// The first and every n-th frame, as SplaTAM: positions 0, n - 1, 2n - 1, …
fn splatam_frames(run: &[RunFrame], every: usize) -> Vec<usize> {
    let selected = |place: &usize| *place == 0 || (place + 1).is_multiple_of(every);
    (0..run.len()).filter(selected).map(|place| run[place].index).collect()
}

/// Positions 0, 5, 10, … without the last frame and keyframes, as MonoGS.
fn monogs_frames(run: &[RunFrame]) -> Vec<usize> {
    let end = run.len().saturating_sub(1);
    let frames = run[..end].iter().step_by(MONOGS_INTERVAL).filter(|frame| !frame.keyframe);
    frames.map(|frame| frame.index).collect()
}

/// Frames that the map never saw.
fn held_out_frames(run: &[RunFrame]) -> Result<Vec<usize>, Failure> {
    let frames: Vec<usize> = run.iter().filter(|f| f.held_out).map(|f| f.index).collect();
    if frames.is_empty() {
        return Err(Failure::usage(
            "this run held no frame out, its map has seen them all: run it again with \
                       --hold-out 8",
        ));
    }
    Ok(frames)
}

/// Error for a selection without a frame of the run.
fn no_frame_error(arguments: &Eval, frames: &[usize], run: Option<&[RunFrame]>) -> Failure {
    let count = run.map_or_else(String::new, |run| format!(" {}", counted(run.len(), "frame")));
    let all = "--protocol all-frames evaluates every frame";
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
        (None, _) => format!("the protocol evaluates none of the{count} of this run: {all}"),
    };
    Failure::Failed(message)
}

fn within_run(frames: &[usize], run: Option<&[RunFrame]>) -> Vec<usize> {
    let processed = |frame: &usize| run.is_none_or(|run| run.iter().any(|f| f.index == *frame));
    frames.iter().copied().filter(processed).collect()
}

fn split(selected: Vec<usize>, renders: &PictureFiles) -> FrameSelection {
    let (mut frames, mut missing) = (Vec::new(), Vec::new());
    for frame in selected {
        match renders.get(&frame) {
            Some(file) => frames.push((frame, file.clone())),
            None => missing.push(frame),
        }
    }
    FrameSelection { frames, missing, list: None }
}

/// Refuses missing renders unless `--partial`: they must not improve the mean unnoticed.
fn check_missing(
    arguments: &Eval,
    estimate: &Estimate,
    reference: &Reference,
    renders: &PictureFiles,
    chosen: &FrameSelection,
) -> Result<(), Failure> {
    let path = arguments.estimate.display();
    let pictures = matches!(estimate, Estimate::Pictures(_));
    let only_radiance = renders.is_empty() && pictures;
    if chosen.frames.is_empty() && !only_radiance && (pictures || chosen.missing.is_empty()) {
        return Err(Failure::Failed(format!(
            "no picture of {path} has a partner in {} that is to be evaluated (NNNNNN.png)",
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
        (false, true) => "--partial evaluates the others".to_owned(),
        (false, false) => {
            format!("`i2slam render {path}` draws all, --partial evaluates those that are there")
        }
    };
    Err(Failure::Failed(format!(
        "{path} has no render of {count} to be evaluated ({names}): {remedy}"
    )))
}

/// The first few frame numbers as text.
pub(super) fn shortened(frames: &[usize]) -> String {
    let first: Vec<String> = frames.iter().take(5).map(|f| format!("{f:06}")).collect();
    let more = if frames.len() > first.len() { ", …" } else { "" };
    first.join(", ") + more
}

/// Names of the published lists with their first lines.
pub(super) fn published_lists() -> Vec<String> {
    let line = |(name, text): &(&str, &str)| {
        let about = text.lines().next().unwrap_or_default().trim_start_matches("# ");
        format!("{name:<26}{about}")
    };
    frame_list::PUBLISHED.iter().map(line).collect()
}

/// Frames of a published list, of a file, or for `auto` the sharp ones.
fn listed_frames(list: &str, reference: &Reference) -> Result<Vec<usize>, Failure> {
    if list == "auto" {
        return match reference {
            Reference::Dataset { sequence, .. } => sharp_in_sequence(sequence),
            Reference::Folder { .. } => {
                Err(Failure::usage("--list auto needs the dataset as --reference, not pictures"))
            }
        };
    }
    let path = Path::new(list);
    let text = match frame_list::published(list) {
        Some(text) if !path.exists() => text.to_owned(),
        _ if path.exists() => i2slam_storage::read_text(path).map_err(|e| failed(path, e))?,
        _ => {
            let known: Vec<&str> = frame_list::PUBLISHED.iter().map(|(name, _)| *name).collect();
            let known = known.join(", ");
            return Err(Failure::Usage(format!(
                "`{list}` is neither a file nor a published list ({known})"
            )));
        }
    };
    let frames = frame_list::parse(&text);
    let frames = frames.map_err(|n| failed(path, format!("line {n} is no frame number")))?;
    if frames.is_empty() { Err(failed(path, "lists no frame")) } else { Ok(frames) }
}

/// First words of every list written by this program.
const ORIGIN: &str = "# Sharp frames of ";

/// Beginning of their last line.
const CHECKSUM: &str = "# CRC-32 of the lines above: ";

/// Writes the list of sharp frames of a dataset or a folder of pictures (`--write-list`).
pub(super) fn write_list(video: &Path, file: &Path, overwrite: bool) -> Result<(), Failure> {
    if !video.is_dir() {
        let reason = if video.exists() { "is no folder" } else { "no such folder" };
        return Err(Failure::Usage(format!("{}: {reason}", video.display())));
    }
    refuse_to_replace(file, overwrite)?;
    let files = picture_files(video, "png")?;
    let (count, frames) = if files.is_empty() {
        let sequence = Sequence::open(video, &OpenOptions::default())?;
        (sequence.len(), sharp_in_sequence(&sequence)?)
    } else {
        let (indices, paths): (Vec<_>, Vec<_>) = files.into_iter().unzip();
        (indices.len(), sharp(&indices, |place| read_png(&paths[place]))?)
    };
    let rule = SharpnessRule::default();
    let whole = video.canonicalize().unwrap_or_else(|_| video.to_owned());
    let name = whole.file_name().unwrap_or_default().to_string_lossy();
    let origin = format!(
        "Sharp frames of {name}, {} of {count}. Position in the associated stream, one per line.\n\
         Variance of the Laplacian at least {} times its median over {} frames, and the largest \
         of {} (i2slam {}).",
        frames.len(),
        rule.ratio,
        2 * rule.window + 1,
        2 * rule.apart + 1,
        env!("CARGO_PKG_VERSION"),
    );
    let list = frame_list::write(&origin, &frames);
    let list = format!("{list}{CHECKSUM}{:08x}\n", crc32fast::hash(list.as_bytes()));
    // It may have appeared meanwhile.
    refuse_to_replace(file, overwrite)?;
    write_file(file, |out| out.write_all(list.as_bytes()))?;
    let (of, file) = (counted(count, "frame"), file.display());
    print(&match frames.len() {
        0 => format!("none of {of} stands out as sharp: {file} lists none"),
        1 => format!("1 of {of} is sharp, listed in {file}"),
        sharp => format!("{sharp} of {of} are sharp, listed in {file}"),
    });
    Ok(())
}

/// Refuses to replace a list without `--overwrite`, and any other file.
fn refuse_to_replace(file: &Path, overwrite: bool) -> Result<(), Failure> {
    let shown = file.display();
    let message = match i2slam_storage::read_text(file) {
        Err(_) if file.symlink_metadata().is_err() => return Ok(()),
        Ok(text) if is_unchanged(&text) && overwrite => return Ok(()),
        Ok(text) if is_unchanged(&text) => {
            "is an earlier list: choose another name, or replace it with --overwrite"
        }
        Ok(text) if text.starts_with(ORIGIN) => {
            "is a list that was changed since it was written: choose another name"
        }
        _ => "is there already, and no list of this program: choose another name",
    };
    Err(Failure::Usage(format!("--write-list {shown} {message}")))
}

/// Whether a text is a list as it was written.
fn is_unchanged(text: &str) -> bool {
    let parts = text.rsplit_once(CHECKSUM).filter(|_| text.starts_with(ORIGIN));
    parts.is_some_and(|(list, sum)| {
        sum.trim_end() == format!("{:08x}", crc32fast::hash(list.as_bytes()))
    })
}

fn sharp_in_sequence(sequence: &Sequence) -> Result<Vec<usize>, Failure> {
    let indices: Vec<usize> = sequence.entries.iter().map(|entry| entry.index).collect();
    sharp(&indices, |place| Ok(Arc::unwrap_or_clone(sequence.load(place)?.colour)))
}

fn sharp(
    indices: &[usize],
    picture: impl Fn(usize) -> Result<Image<f32>, Failure> + Sync,
) -> Result<Vec<usize>, Failure> {
    let sharpness = |place: usize| Ok(laplacian_variance(&picture(place)?)?);
    let all: Result<Vec<f64>, Failure> =
        (0..indices.len()).into_par_iter().map(sharpness).collect();
    let places = sharp_frames(&all?, SharpnessRule::default())?;
    Ok(places.into_iter().map(|place| indices[place]).collect())
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
            exposure: None,
            white_balance: None,
        };
        (0..16).map(frame).collect()
    }

    #[test]
    fn splatam_evaluates_the_first_and_every_nth() {
        assert_eq!(splatam_frames(&run(&[]), 5), [100, 104, 109, 114]);
        assert_eq!(splatam_frames(&run(&[]), 500), [100]);
    }

    #[test]
    fn monogs_evaluates_every_fifth_that_is_no_keyframe_nor_the_last() {
        assert_eq!(monogs_frames(&run(&[0, 10])), [105]);
        assert_eq!(monogs_frames(&run(&[])), [100, 105, 110]);
        assert!(monogs_frames(&[]).is_empty());
    }

    #[test]
    fn held_out_frames_are_those_of_the_run() {
        let mut frames = run(&[]);
        let message = held_out_frames(&frames).expect_err("all were mapped");
        assert!(message.message().is_some_and(|m| m.contains("--hold-out")));
        frames[6].held_out = true;
        assert_eq!(held_out_frames(&frames).ok(), Some(vec![106]));
    }
}

//! A whole run: frames in, result folder out. Used by `run` and `demo`.

mod camera;
mod draw;
mod drive;
mod earlier;
mod estimate;
mod figures;
mod path;
mod posed;
mod refined;
mod summary;
mod track;
mod write;

use crate::arguments::Draw;
use crate::destination::{Destination, MadeFolders};
use crate::failure::Failure;
use crate::interrupt;
use crate::output::complain;
use crate::progress::Progress;
use crate::truth::Truth;
use i2slam::Config;
use i2slam::dataset::{OpenOptions, Recording, Sequence, is_stream, is_video};
use i2slam_result::{Layout, ResultFolder};
pub(crate) use posed::Keyframes;
use std::path::{Path, PathBuf};
use summary::summarise;
use write::{Finished, Written};

/// What to do.
pub(crate) struct Job {
    pub(crate) dataset: PathBuf,
    pub(crate) out: PathBuf,
    /// Keyframes with poses, in place of tracking.
    pub(crate) keyframes: Option<Keyframes>,
    pub(crate) config: Config,
    pub(crate) open: OpenOptions,
    pub(crate) draw: Draw,
    /// Whether an earlier result in `out` may be replaced.
    pub(crate) overwrite: bool,
    pub(crate) quiet: bool,
    /// Name for the report; the folder's if there is none.
    pub(crate) title: Option<&'static str>,
}

/// Reconstruct, write everything, print the summary; its last line is the report's path.
pub(crate) fn run(job: &Job) -> Result<(), Failure> {
    interrupt::listen();
    let stream = recorded(job)?;
    let recording = stream.as_ref().map(Recording::path);
    let dataset = recording.as_ref().unwrap_or(&job.dataset);
    if is_video(dataset) && !job.quiet {
        complain(&format!("looking through {}", job.dataset.display()));
    }
    let sequence = Sequence::open(dataset, &job.open)?;
    job.keyframes.iter().try_for_each(|keyframes| keyframes.check(&sequence))?;
    refuse_to_overwrite(job)?;
    let made = MadeFolders::for_path(&job.out);
    let folder = ResultFolder::create(&job.out)?;
    let warnings = stream.iter().flat_map(|stream| stream.warnings.clone()).collect();
    let ended = reconstruct(job, (dataset, &sequence), &folder, warnings);
    if ended.is_err() {
        made.remove_empty();
    }
    ended
}

/// The run itself, on a sequence that was opened; `warnings` have come of that.
fn reconstruct(
    job: &Job,
    (dataset, sequence): (&Path, &Sequence),
    folder: &ResultFolder,
    warnings: Vec<String>,
) -> Result<(), Failure> {
    let truth = Truth::of(dataset, sequence);
    let mut progress = Progress::new(sequence.len(), job.quiet);
    for warning in warnings.iter().chain(&sequence.warnings).chain(&truth.warnings) {
        progress.warn(warning.as_str());
    }
    let tracked = match &job.keyframes {
        None => track::track(&job.config, sequence, &mut progress),
        Some(keyframes) => posed::track(job, keyframes, sequence, &mut progress),
    };
    let written = tracked.and_then(|tracked| {
        let undistorted = tracked.undistorted.clone();
        // True pictures come through the same lens.
        let freed = undistorted.as_ref().map(|sequence| Truth::of(dataset, sequence));
        let truth = freed.as_ref().unwrap_or(&truth);
        let sequence = undistorted.as_ref().unwrap_or(sequence);
        Finished { job, folder, sequence, truth, tracked }.write(&mut progress)
    });
    progress.clear();
    let Written { metrics, map, folder, problems } = written?;
    summarise(&metrics, &map, &folder, job.config.input.optimise_rolling_shutter);
    end(problems)
}

/// What a stream gives, read before anything else, as nobody can read it twice.
fn recorded(job: &Job) -> Result<Option<Recording>, Failure> {
    if !is_stream(&job.dataset) {
        return Ok(None);
    }
    if let Some(Keyframes::Files { .. }) = job.keyframes {
        return Err(Failure::Usage(format!(
            "{} is a stream: --keyframes goes with a file or a folder",
            job.dataset.display()
        )));
    }
    refuse_to_overwrite(job)?;
    if !job.quiet {
        let name = job.dataset.display();
        complain(&format!(
            "reading the stream {name} (Ctrl-C ends it, and goes on with what came)"
        ));
    }
    let read = || Recording::of(&job.dataset, &interrupt::requested);
    Ok(Some(interrupt::reading(read)?))
}

/// The dataset is never written to (a result folder has a `camera.json` of its own), an earlier
/// result only where the user says so, and files of the user's own never.
fn refuse_to_overwrite(job: &Job) -> Result<(), Failure> {
    let out = job.out.display();
    let same_folder = match (job.out.canonicalize(), job.dataset.canonicalize()) {
        (Ok(folder), Ok(dataset)) => folder == dataset,
        _ => false,
    };
    if same_folder {
        return Err(Failure::Usage(format!(
            "--out {out} is the dataset itself: its camera.json would be overwritten, choose \
             another folder"
        )));
    }
    destination(job).check()
}

fn destination(job: &Job) -> Destination<'_> {
    let (layout, overwrite) = (Layout::of_result(), job.overwrite);
    Destination { path: &job.out, layout, command: "i2slam run", overwrite }
}

/// Failures first, then whether the user ended it.
fn end(problems: Vec<String>) -> Result<(), Failure> {
    match problems.split_last() {
        Some((last, others)) => {
            for problem in others {
                complain(&format!("error: {problem}"));
            }
            Err(Failure::Failed(last.clone()))
        }
        None if interrupt::requested() => Err(Failure::Interrupted),
        None => Ok(()),
    }
}

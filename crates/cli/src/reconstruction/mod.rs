//! A whole run from the dataset to the result folder, for `run` and `demo`.

mod pictures;
mod shortfall;
mod write;

use crate::console::{counted, print, print_status};
use crate::failure::Failure;
use crate::ground_truth::GroundTruth;
use crate::held_out_frames::listed_frames;
use crate::interrupt::Reading;
use crate::live_viewer::{LiveViewer, SequenceFrames};
use crate::pose_lines::PoseLines;
use crate::progress::Progress;
use crate::recording::Recording;
use crate::{interrupt, messages};
use i2slam::config::MappingConfig;
use i2slam::dataset::{DatasetError, LiveSequence, RecordedSequence, Sequence, is_video};
use i2slam::run::{TrackedStream, reconstruct_stream};
use i2slam::{PoseSource, RunError, RunOptions, Warning, reconstruct};
use i2slam_result::{FrameFiles, NAMES};
use i2slam_storage::{Claim, MANIFEST, OutputFolder};
pub(crate) use pictures::RenderSelection;
use shortfall::with_shortfall;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use write::{FinishedRun, WrittenRun};

/// Arguments of a run.
#[derive(Clone)]
pub(crate) struct Job<'a> {
    pub(crate) dataset: PathBuf,
    pub(crate) out: PathBuf,
    pub(crate) options: RunOptions,
    /// File that settings come from.
    pub(crate) settings_file: Option<&'a Path>,
    /// List of the frames that are held out.
    pub(crate) held_out_frames: Option<&'a Path>,
    /// Frames whose renders are written.
    pub(crate) renders: RenderSelection,
    /// True if colour alone was chosen for a folder because it has no depth.
    pub(crate) is_rgb_chosen: bool,
    /// Whether an earlier result in `out` may be replaced.
    pub(crate) overwrite: bool,
    pub(crate) quiet: bool,
    /// Receiver of poses while frames come.
    pub(crate) poses: Option<Arc<PoseLines>>,
    /// Page that follows the run.
    pub(crate) live: Option<Arc<LiveViewer>>,
    /// Recording of the finished run for another program.
    pub(crate) recording: Option<Recording>,
    /// Title of the report [default: name of the sequence].
    pub(crate) title: Option<&'static str>,
}

impl Job<'_> {
    /// Checks that the result may be written, before anything else is done.
    pub(crate) fn check_output(&self) -> Result<(), Failure> {
        check_output(&self.dataset, &self.out, self.overwrite)
    }

    /// Begins to show the run of a sequence in a browser, where that is asked for.
    fn show_live(&self, sequence: &Sequence) {
        let title = self.title.unwrap_or(&sequence.name);
        let config = &self.options.config;
        if let Some(live) = &self.live {
            let frames = SequenceFrames::of(sequence, &self.dataset);
            live.begin(title, config, (&sequence.camera, frames));
        }
    }
}

/// Checks that the result of a run may be written to `out`.
pub(crate) fn check_output(dataset: &Path, out: &Path, overwrite: bool) -> Result<(), Failure> {
    refuse_dataset(dataset, out)?;
    Ok(OutputFolder::check(out, claim(overwrite))?)
}

/// Refuses to write into the dataset, as a result has a `camera.json` of its own, or among its pictures.
fn refuse_dataset(dataset: &Path, out: &Path) -> Result<(), Failure> {
    let (Ok(folder), Ok(dataset)) = (out.canonicalize(), dataset.canonicalize()) else {
        return Ok(());
    };
    let is_new = || folder.read_dir().is_ok_and(|mut files| files.next().is_none());
    let which = match folder.strip_prefix(&dataset) {
        Ok(inner) if inner.as_os_str().is_empty() => "the dataset itself",
        Ok(_) if !is_new() && !folder.join(MANIFEST).exists() => "a folder of the dataset",
        _ => return Ok(()),
    };
    let out = out.display();
    Err(Failure::Usage(format!("--out {out} is {which}, choose another folder")))
}

fn claim(overwrite: bool) -> Claim<'static> {
    Claim { command: "i2slam run", names: NAMES, overwrite }
}

/// Reconstructs, writes everything, and prints a summary that ends with the path of the report.
pub(crate) fn run(job: &Job<'_>) -> Result<(), Failure> {
    interrupt::listen();
    let dataset = &job.dataset;
    if is_video(dataset) && !job.quiet {
        print_status(&format!("looking through {}", dataset.display()));
    }
    let sequence = job.options.open_sequence(dataset)?;
    if job.is_rgb_chosen && !job.quiet {
        let name = dataset.display();
        print_status(&format!(
            "{name} has pictures and no depth: run by colour alone, as with --rgb"
        ));
    }
    let mut job = job.clone();
    if let Some(list) = job.held_out_frames {
        job.options.config.mapping.hold_out_frames = listed_frames(list, &sequence)?;
    }
    job.options.validate(&sequence).map_err(|error| placed(error, &job))?;
    refuse_idle_hold_out(&job.options.config.mapping, sequence.len())?;
    refuse_dataset(&job.dataset, &job.out)?;
    reconstruct_into(output_folder(&job)?, &job, (dataset, &sequence), None)
}

/// Refuses to hold out each N-th of at most N frames, which is none.
fn refuse_idle_hold_out(mapping: &MappingConfig, frames: usize) -> Result<(), Failure> {
    let every = mapping.hold_out;
    match every > 0 && every >= frames && mapping.hold_out_frames.is_empty() {
        true => Err(Failure::Usage(format!(
            "--hold-out {every} (mapping.hold_out) holds out none of {}: expected a smaller number",
            counted(frames, "frame")
        ))),
        false => Ok(()),
    }
}

fn output_folder(job: &Job<'_>) -> Result<OutputFolder, Failure> {
    let folder = OutputFolder::replace(&job.out, claim(job.overwrite))?;
    messages::note_saved_parts(folder.saved_parts());
    Ok(folder)
}

/// Reconstructs an opened sequence, or a stream whose frames were `tracked`, and writes the result.
fn reconstruct_into(
    folder: OutputFolder,
    job: &Job<'_>,
    (dataset, sequence): (&Path, &Sequence),
    tracked: Option<(TrackedStream, Progress)>,
) -> Result<(), Failure> {
    let mut truth = GroundTruth::open(dataset, sequence);
    let is_truth_given = match &job.options.poses {
        PoseSource::Files { keyframes, .. } => truth.leave_out_poses_of(keyframes, sequence),
        _ => false,
    };
    let (tracked, mut progress) = match tracked {
        // Poses of a stream were written while it came.
        Some((tracked, progress)) => (Some(tracked), progress.with_poses(None)),
        None => (None, Progress::new(sequence.len(), job.quiet).with_poses(job.poses.clone())),
    };
    let files = FrameFiles::of(sequence, &job.dataset);
    progress = progress.with_live_viewer(job.live.clone()).with_files(files.clone());
    if job.title.is_some() {
        progress = progress.without_advice();
    }
    job.show_live(sequence);
    let warnings: Vec<String> = sequence.warnings.iter().chain(&truth.warnings).cloned().collect();
    warnings.iter().for_each(|warning| progress.warn(warning));
    if is_truth_given {
        progress
            .note("the keyframes are the ground truth of the path: no error against it is told");
    }
    if let PoseSource::FrontEnd { with_depth: false, .. } = job.options.poses {
        messages::input_lines(sequence).iter().for_each(|line| progress.note(line));
        if job.options.open.depth_scale.is_some() {
            progress.note("--depth-scale changes nothing: no depth is read");
        }
    }
    messages::assumed_rate_line(sequence).iter().for_each(|line| progress.note(line));
    let failure = |error: RunError| {
        if let RunError::Cancelled { .. } = error {
            // An interrupt has an exit code alone.
            progress.note(&error.to_string());
        }
        Failure::from(error)
    };
    let scratch_folder = folder.scratch_folder().to_owned();
    let options = RunOptions { scratch_folder, ..job.options.clone() };
    let outcome = match tracked {
        Some(tracked) => reconstruct_stream(sequence, tracked, &options, progress.clone()),
        None => reconstruct(sequence, &options, progress.clone()),
    };
    let written = outcome.map_err(failure).and_then(|outcome| {
        let outcome = outcome.with_frame_names(|index| files.name(index));
        let undistorted = outcome.undistorted.clone();
        // True pictures have the same lens distortion.
        let undistorted_truth =
            undistorted.as_ref().map(|sequence| GroundTruth::open(dataset, sequence));
        let truth = undistorted_truth.as_ref().unwrap_or(&truth);
        let sequence = undistorted.as_ref().unwrap_or(sequence);
        let warnings = warnings.into_iter().map(Warning::from).chain(outcome.warnings.clone());
        let warnings = warnings.collect();
        let shown = job.live.as_ref().map(|live| (live, outcome.reconstruction.clone()));
        let written =
            FinishedRun { job, folder, sequence, truth, outcome, warnings }.write(&progress);
        if let (Some((live, last)), Ok(written)) = (shown, &written) {
            live.end(&last, format!("The run has ended: {}", written.folder.display()));
        }
        written
    });
    progress.clear();
    let WrittenRun { metrics, map, folder, not_placed, problems } = written?;
    job.poses.iter().for_each(|poses| poses.report(metrics.frames));
    let interrupted = interrupt::requested();
    if interrupted && metrics.degraded {
        print_status(&format!("warning: degraded: {}", metrics.degraded_because.join("; ")));
    }
    let problems = if interrupted { problems } else { with_shortfall(&metrics, problems) };
    let ended = report_problems(&problems);
    let is_readout_estimated = job.options.config.input.optimise_rolling_shutter;
    let print = match &job.poses {
        Some(poses) if poses.is_standard_output() => print_status,
        _ => print,
    };
    messages::print_summary(print, &metrics, (&map, &not_placed), &folder, is_readout_estimated);
    let is_map_empty = metrics.gaussians == 0 && metrics.degraded;
    if interrupted && !is_map_empty && job.renders != RenderSelection::None {
        let folder = messages::quoted(&folder);
        print_status(&format!("interrupted before all renders: i2slam render {folder} makes them"));
    }
    ended
}

/// The error with the place of a setting in the file of settings.
fn placed(error: RunError, job: &Job<'_>) -> RunError {
    match (error, job.settings_file) {
        (RunError::Config(error), Some(file)) => error.in_file(file).into(),
        (error, _) => error,
    }
}

/// Tracks the frames of a stream while they come, and reconstructs it when it has ended.
pub(crate) fn run_stream(
    job: &Job<'_>,
    live: LiveSequence,
    reading: Reading,
) -> Result<(), Failure> {
    let progress = Progress::new(0, job.quiet)
        .with_poses(job.poses.clone())
        .with_live_viewer(job.live.clone());
    interrupt::set_recording(Some(live.recording()));
    let (tracked, recorded) = track_stream(job, live, &progress)?;
    drop(reading);
    let (path, sequence) = (recorded.path(), &recorded.sequence);
    let ended =
        reconstruct_into(output_folder(job)?, job, (&path, sequence), Some((tracked, progress)));
    interrupt::set_recording(None);
    ended
}

fn track_stream(
    job: &Job<'_>,
    live: LiveSequence,
    progress: &Progress,
) -> Result<(TrackedStream, RecordedSequence), Failure> {
    let live = job.options.reopen_stream(live).map_err(|error| match error {
        DatasetError::NoCamera { .. } => Failure::Usage(format!(
            "{} has depth, with which the camera must be known: give --intrinsics, --camera or --fov, \
             or --rgb for colour alone",
            job.dataset.display()
        )),
        error => error.into(),
    })?;
    job.options.validate(live.first()).map_err(|error| placed(error, job))?;
    job.show_live(live.first());
    let tracked = TrackedStream::track(&live, &job.options, progress.clone());
    if tracked.is_err() {
        progress.clear();
    }
    Ok((tracked?, live.finish()?))
}

/// Prints all problems.
fn report_problems(problems: &[String]) -> Result<(), Failure> {
    problems.iter().for_each(|problem| print_status(&format!("error: {problem}")));
    match problems {
        [] if interrupt::requested() => Err(Failure::Interrupted),
        [] => Ok(()),
        _ => Err(Failure::Reported),
    }
}

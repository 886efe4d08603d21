//! A whole run: frames in, result folder out. Used by `run` and `demo`.

mod camera;
mod draw;
mod drive;
mod figures;
mod posed;
mod track;

use crate::arguments::Draw;
use crate::destination::Destination;
use crate::failure::Failure;
use crate::interrupt;
use crate::output::{complain, counted, say};
use crate::progress::Progress;
use crate::truth::Truth;
use camera::FoundCamera;
use draw::Drawing;
use drive::Tracked;
use figures::Figures;
use i2slam::Config;
use i2slam::dataset::{OpenOptions, Recording, Sequence, is_stream, is_video};
use i2slam::export::report::Report;
use i2slam::export::{
    ExportError, Input, Layout, Metrics, ResultFolder, UnitOfLength, save, save_metrics,
};
pub(crate) use posed::Keyframes;
use std::path::{Path, PathBuf};

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
    let folder = ResultFolder::create(&job.out)?;
    let truth = Truth::of(dataset, &sequence);
    let mut progress = Progress::new(sequence.len(), job.quiet);
    let told = stream.iter().flat_map(|stream| &stream.warnings);
    for warning in told.chain(&sequence.warnings).chain(&truth.warnings) {
        progress.warn(warning);
    }
    let tracked = match &job.keyframes {
        None => track::track(&job.config, &sequence, &mut progress),
        Some(keyframes) => posed::track(job, keyframes, &sequence, &mut progress),
    };
    let written = tracked.and_then(|tracked| {
        let undistorted = tracked.undistorted.clone();
        // True pictures come through the same lens.
        let freed = undistorted.as_ref().map(|sequence| Truth::of(dataset, sequence));
        let truth = freed.as_ref().unwrap_or(&truth);
        let sequence = undistorted.as_ref().unwrap_or(&sequence);
        Finished { job, folder: &folder, sequence, truth, tracked }.write(&mut progress)
    });
    progress.clear();
    let Written { metrics, map, problems } = written?;
    summarise(&metrics, &map, folder.path(), job.config.input.optimise_rolling_shutter);
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

/// A run whose frames are done.
struct Finished<'a> {
    job: &'a Job,
    folder: &'a ResultFolder,
    sequence: &'a Sequence,
    truth: &'a Truth,
    tracked: Tracked,
}

/// What came of writing.
struct Written {
    metrics: Metrics,
    /// The map in words.
    map: String,
    problems: Vec<String>,
}

impl Finished<'_> {
    /// What opens the sequence as it was used.
    fn opened(&self) -> OpenOptions {
        let lens = self.tracked.camera.as_ref().and_then(FoundCamera::lens);
        let before = &self.job.open;
        OpenOptions {
            estimated_camera: lens.copied().or(before.estimated_camera),
            ..before.clone()
        }
    }

    /// What matters most first: poses and map, then figures, then pictures, then the page.
    fn write(self, progress: &mut Progress) -> Result<Written, Failure> {
        let reconstruction = &self.tracked.reconstruction;
        let mut problems: Vec<String> = self.tracked.problem.iter().cloned().collect();
        let mut note = |result: Result<(), ExportError>| {
            problems.extend(result.err().map(|error| error.to_string()));
        };
        if self.job.overwrite {
            note(Layout::of_result().remove(self.folder.path()));
        }
        save(self.folder, reconstruction).into_iter().for_each(|error| note(Err(error)));
        note(Input::new(&self.job.dataset, &self.opened()).save(self.folder));
        let mut figures = Figures::of(&self.tracked, self.truth);
        for warning in &figures.warnings {
            progress.warn(warning);
        }
        note(save_metrics(self.folder, &figures.metrics));
        let drawing = Drawing {
            sequence: self.sequence,
            truth: self.truth,
            reconstruction,
            draw: self.job.draw,
        };
        let drawn = drawing.run(self.folder, progress);
        drawn.failure.into_iter().for_each(|error| note(Err(error)));
        drawn.measures.fill(&mut figures.metrics);
        figures.metrics.peak_memory_bytes = figures::peak_memory();
        note(save_metrics(self.folder, &figures.metrics));
        let report = Report {
            title: self.job.title.unwrap_or(&self.sequence.name),
            reconstruction,
            metrics: &figures.metrics,
            ground_truth: &figures.truth_in_world,
            true_exposure: &self.truth.exposure,
            comparisons: &drawn.comparisons,
        };
        note(report.save(self.folder));
        let map = reconstruction.map.to_string();
        Ok(Written { metrics: figures.metrics, map, problems })
    }
}

/// The run in a few lines.
fn summarise(metrics: &Metrics, map: &str, folder: &Path, readout_searched: bool) {
    let frames = metrics.frames;
    let unfinished = if metrics.complete { "" } else { " (ended early)" };
    let frames = counted(frames, "frame");
    say(&format!("{} of {frames} tracked{unfinished}, {map}", metrics.tracked));
    if let Some(error) = metrics.ate_rmse_m {
        let centimetres = error * 100.0;
        let digits = if centimetres < 0.1 { 4 } else { 2 };
        say(&format!(
            "trajectory error {centimetres:.digits$} cm (ATE RMSE over {}{})",
            counted(metrics.ate_poses, "pose"),
            if metrics.ate_scale_aligned { ", scale aligned" } else { "" }
        ));
    }
    if let Some(psnr) = metrics.psnr_sharp_db {
        say(&format!("sharp renders {psnr:.2} dB against the true sharp pictures"));
    }
    if metrics.unit_of_length == UnitOfLength::Unknown {
        say("unit of length: unknown, pictures alone do not tell the scale");
    }
    if let Some(assumed) = metrics.focal_length_assumed_px {
        say(&format!(
            "camera: focal length {:.1} px, {:.1} degrees across, found in the pictures (assumed \
             {assumed:.1} px)",
            metrics.focal_length_px, metrics.horizontal_fov_deg
        ));
    }
    if let Some([k1, k2]) = metrics.lens_distortion {
        say(&format!("lens distortion: k1 {k1:.4}, k2 {k2:.4}, found in the pictures and removed"));
    }
    if metrics.rolling_shutter_readout_s != 0.0 {
        let milliseconds = 1e3 * metrics.rolling_shutter_readout_s;
        say(&format!("rolling shutter: rows read in {milliseconds:.1} ms"));
    } else if readout_searched {
        say("rolling shutter: none found, rows read at once (0.0 ms)");
    }
    let memory = metrics.peak_memory_bytes.map(|bytes| format!(", {} MB", bytes / 1_000_000));
    say(&format!(
        "{:.2} s per frame, {:.0} s in all{}",
        metrics.seconds_per_frame,
        metrics.seconds,
        memory.unwrap_or_default()
    ));
    let absolute = std::path::absolute(folder).unwrap_or_else(|_| folder.to_owned());
    say(&format!("results in {}", absolute.display()));
    let report = absolute.join("report.html");
    if report.is_file() {
        say(&report.display().to_string());
    }
}

//! One job: reconstruction and evaluation by the program `i2slam`, and the record of both.

use crate::console::Failure;
use crate::metrics::{self, Metrics, OFF_SURFACE, PINHOLES, SEE_THROUGH};
use crate::plan::{Job, Plan};
use crate::process::{Call, Stopped};
use crate::sequences::{FrameList, Source};
use crate::splats::{self, SplatFigures};
use i2slam_eval::frame_list;
use i2slam_result::remove_renders;
use i2slam_storage::{FolderLock, StorageError, first_entry, write_file};
use serde::{Deserialize, Serialize};
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// The file in a job's folder that holds its [`Record`].
pub(crate) const RECORD: &str = "job.json";

/// The file by which a benchmark's folder is known.
const MARK: &str = "bench.json";

/// Version of the layout of a benchmark's folder; the first had no number.
const FORMAT: u32 = 2;

/// `bench.json`: whose folder it is.
#[derive(Serialize, Deserialize)]
struct Mark {
    #[serde(default)]
    format: u32,
    /// Title of the suite.
    suite: String,
}

/// All that the jobs of a benchmark have in common.
pub(crate) struct Bench<'a> {
    pub(crate) plan: &'a Plan,
    pub(crate) out: &'a Path,
    /// The program `i2slam`.
    pub(crate) program: PathBuf,
    /// Version and checksum of the program.
    pub(crate) build: String,
    /// Threads of one job.
    pub(crate) threads: usize,
    /// Jobs at once.
    pub(crate) parallel: usize,
    pub(crate) timeout: Option<Duration>,
    pub(crate) keep_renders: bool,
}

/// `job.json`: what was run, and how it ended.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Record {
    #[serde(flatten)]
    pub(crate) work: Work,
    /// Version and checksum of the program.
    pub(crate) build: String,
    pub(crate) threads: usize,
    /// Jobs at once.
    pub(crate) parallel: usize,
    /// Wall time of the job, evaluation included [s].
    pub(crate) seconds: f64,
    /// Whether the reconstruction ended well.
    pub(crate) reconstructed: bool,
    /// Why the job failed.
    pub(crate) failure: Option<String>,
}

/// The work of a job, by whichever build of the program: a finished job is not run again while its
/// work stays the same.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Work {
    /// Folder of the sequence, or `synth: ` and its specification.
    sequence: String,
    /// Options of `i2slam run` beside the settings.
    arguments: Vec<String>,
    /// The file given as `--config`.
    settings: String,
    /// Frames whose pictures are judged, where there is a list.
    list: Option<String>,
    /// Protocol that judges pictures; without one the metrics of the run itself count.
    protocol: Option<String>,
    /// Whether poses are optimised before pictures are judged.
    optimise_poses: bool,
}

impl Record {
    fn write(&self, folder: &Path) -> Result<(), Stopped> {
        let text =
            serde_json::to_string_pretty(self).map_err(|e| Stopped::Failed(e.to_string()))?;
        Ok(write_text(&folder.join(RECORD), &(text + "\n"))?)
    }
}

impl Bench<'_> {
    /// Makes the folder that of the suite: an empty one, or the suite's own. It is locked until the
    /// result is dropped.
    pub(crate) fn claim_folder(&self) -> Result<FolderLock, Failure> {
        claim(self.out, &self.plan.suite.title)
    }

    pub(crate) fn folder(&self, job: &Job) -> PathBuf {
        self.out.join(self.plan.folder(job))
    }

    /// Folder of a sequence's frames.
    fn dataset(&self, sequence: usize) -> PathBuf {
        let sequence = &self.plan.sequences[sequence];
        match &sequence.source {
            Source::Folder(folder) => folder.clone(),
            Source::Synth(_) => self.out.join("sequences").join(&sequence.slug),
        }
    }

    /// The record that the job gets if all goes well.
    fn expected_record(&self, job: &Job) -> Record {
        let sequence = &self.plan.sequences[job.sequence];
        let configuration = &self.plan.configurations[job.configuration];
        let source = match &sequence.source {
            Source::Folder(folder) => {
                folder.canonicalize().unwrap_or_else(|_| folder.clone()).display().to_string()
            }
            Source::Synth(spec) => format!("synth: {spec}"),
        };
        let rgb = configuration.entry.rgb.then(|| "--rgb".to_owned());
        let (preset, seed) = (configuration.entry.preset(), job.seed);
        let work = Work {
            sequence: source,
            arguments: sequence.arguments.iter().cloned().chain(rgb).collect(),
            settings: format!("preset = \"{preset}\"\nseed = {seed}\n{}", configuration.overrides),
            list: sequence.list.as_ref().map(|list| match list {
                FrameList::Auto => "auto".to_owned(),
                FrameList::Frames(frames) => frame_list::write("Frames to be judged.", frames),
            }),
            protocol: self.plan.protocol(job.sequence).map(str::to_owned),
            optimise_poses: self.plan.suite.optimise_poses,
        };
        let (build, threads, parallel) = (self.build.clone(), self.threads, self.parallel);
        Record { work, build, threads, parallel, ..Record::default() }
    }

    /// The record of the job from an earlier run of the benchmark, if it is of the same work.
    pub(crate) fn earlier_record(&self, job: &Job) -> Option<Record> {
        let text = fs::read_to_string(self.folder(job).join(RECORD)).ok()?;
        let record: Option<Record> = serde_json::from_str(&text).ok();
        record.filter(|record| record.work == self.expected_record(job).work)
    }

    /// Runs the missing steps of a job; `started` gets the id of every process. Only an
    /// interruption leaves no record.
    pub(crate) fn run(&self, job: &Job, started: impl Fn(u32)) -> Result<Record, Stopped> {
        let folder = self.folder(job);
        let begun = Instant::now();
        let earlier = self.earlier_record(job).filter(|record| record.reconstructed);
        let mut record = self.expected_record(job);
        record.reconstructed = earlier.is_some();
        let ended = self.run_steps(job, &folder, &mut record, &started);
        let earlier_seconds = earlier.map_or(0.0, |earlier| earlier.seconds);
        record.seconds = earlier_seconds + begun.elapsed().as_secs_f64();
        match ended {
            Ok(()) => {}
            Err(Stopped::Failed(reason)) => record.failure = Some(reason),
            Err(Stopped::Interrupted) => return Err(Stopped::Interrupted),
        }
        match record.write(&folder) {
            Err(Stopped::Failed(reason)) if record.failure.is_none() => {
                record.failure = Some(format!("{}: {reason}", folder.display()));
            }
            _ => {}
        }
        Ok(record)
    }

    fn run_steps(
        &self,
        job: &Job,
        folder: &Path,
        record: &mut Record,
        started: &impl Fn(u32),
    ) -> Result<(), Stopped> {
        fs::create_dir_all(folder)?;
        let result = folder.join("result");
        if !record.reconstructed {
            remove_file(&folder.join(RECORD))?;
            remove_file(&folder.join("eval.json"))?;
            remove_file(&folder.join(metrics::OWN))?;
            self.reconstruct(job, folder, &record.work, started)?;
            record.reconstructed = true;
        }
        self.evaluate(job, folder, &record.work, started)?;
        measure_splats(folder)?;
        if !self.keep_renders {
            remove_renders(&result).map_err(|e| Stopped::Failed(e.to_string()))?;
        }
        Ok(())
    }

    fn reconstruct(
        &self,
        job: &Job,
        folder: &Path,
        work: &Work,
        started: &impl Fn(u32),
    ) -> Result<(), Stopped> {
        let settings = folder.join("settings.toml");
        write_text(&settings, &work.settings)?;
        let mut arguments: Vec<OsString> = vec!["run".into(), self.dataset(job.sequence).into()];
        arguments.extend(["--out".into(), folder.join("result").into()]);
        arguments.extend(["--config".into(), settings.into()]);
        arguments.extend(["--threads".into(), self.threads.to_string().into()]);
        // A result that an earlier call left is replaced when the new one is whole.
        arguments.extend(["--overwrite", "--quiet", "--render", "all"].map(OsString::from));
        arguments.extend(work.arguments.iter().map(OsString::from));
        self.call(arguments, &folder.join("run.log"), None).run(started)
    }

    /// Judges the pictures against the true ones, where there are such: `eval.json`.
    fn evaluate(
        &self,
        job: &Job,
        folder: &Path,
        work: &Work,
        started: &impl Fn(u32),
    ) -> Result<(), Stopped> {
        let dataset = self.dataset(job.sequence);
        if work.protocol.is_none() && !dataset.join("sharp").is_dir() {
            return Ok(());
        }
        let mut arguments: Vec<OsString> = vec!["eval".into(), folder.join("result").into()];
        arguments.extend(["--reference".into(), dataset.into(), "--json".into()]);
        if let Some(list) = &work.list {
            let file = folder.join("list.txt");
            let name: OsString = match list.as_str() {
                "auto" => "auto".into(),
                frames => {
                    write_text(&file, frames)?;
                    file.into()
                }
            };
            arguments.extend(["--list".into(), name]);
        }
        if let Some(protocol) = &work.protocol {
            arguments.extend(["--protocol".into(), protocol.into()]);
        }
        if work.optimise_poses {
            arguments.push("--optimise-poses".into());
        }
        let partial = folder.join(".eval.json.partial");
        let call = self.call(arguments, &folder.join("eval.log"), Some(&partial)).run(started);
        match call {
            Ok(()) => Ok(fs::rename(partial, folder.join("eval.json"))?),
            Err(Stopped::Failed(reason)) => Err(Stopped::Failed(format!("not judged: {reason}"))),
            Err(interrupted) => Err(interrupted),
        }
    }

    /// Renders a sequence that is given as a specification, once.
    pub(crate) fn render_sequence(&self, sequence: usize, threads: usize) -> Result<(), Stopped> {
        let Source::Synth(text) = &self.plan.sequences[sequence].source else { return Ok(()) };
        let folder = self.dataset(sequence);
        let spec = folder.with_extension("toml");
        if folder.is_dir() && fs::read_to_string(&spec).is_ok_and(|known| known == *text) {
            return Ok(());
        }
        let wanted = folder.with_extension("wanted.toml");
        write_text(&wanted, text)?;
        let mut arguments: Vec<OsString> = vec!["synth".into(), (&wanted).into(), "--out".into()];
        arguments.extend([(&folder).into(), "--threads".into(), threads.to_string().into()]);
        arguments.extend(["--overwrite", "--quiet"].map(OsString::from));
        let log = folder.with_extension("log");
        self.call(arguments, &log, None).run(|_| ())?;
        // The specification comes last: it says that the sequence is there.
        Ok(fs::rename(wanted, spec)?)
    }

    fn call<'a>(
        &'a self,
        arguments: Vec<OsString>,
        log: &'a Path,
        output: Option<&'a Path>,
    ) -> Call<'a> {
        let (program, threads, timeout) = (&self.program, self.threads, self.timeout);
        Call { program, arguments, threads, log, output, timeout }
    }
}

/// Measures a map of Gaussians as viewers draw it, once, where the sequence has depth.
fn measure_splats(folder: &Path) -> Result<(), Stopped> {
    let file = folder.join(metrics::OWN);
    if file.is_file() {
        return Ok(());
    }
    let figures = splats::of_result(&folder.join("result"));
    let figures = figures.map_err(|e| Stopped::Failed(format!("map.ply not measured: {e}")))?;
    let of = |figures: SplatFigures| {
        [
            (&PINHOLES, figures.pinholes),
            (&SEE_THROUGH, figures.see_through),
            (&OFF_SURFACE, figures.off_surface),
        ]
    };
    let metrics: Metrics =
        figures.map(of).into_iter().flatten().map(|(m, v)| (m.key.to_owned(), v)).collect();
    let text = serde_json::to_string(&metrics).map_err(|e| Stopped::Failed(e.to_string()))?;
    Ok(write_text(&file, &(text + "\n"))?)
}

fn remove_file(file: &Path) -> Result<(), Stopped> {
    if file.exists() { Ok(fs::remove_file(file)?) } else { Ok(()) }
}

fn write_text(file: &Path, text: &str) -> Result<(), StorageError> {
    write_file(file, |out| out.write_all(text.as_bytes()))
}

/// Marks a folder as that of a suite and locks it, or refuses one that holds anything else.
fn claim(out: &Path, title: &str) -> Result<FolderLock, Failure> {
    let shown = out.display();
    let refuse = |why: String| Err(Failure::Usage(format!("--out {shown} {why}")));
    if !out.is_dir() && out.symlink_metadata().is_ok() {
        return refuse("is a file: a folder is written, name another one".to_owned());
    }
    let mark = fs::read_to_string(out.join(MARK)).ok();
    match mark.and_then(|text| serde_json::from_str::<Mark>(&text).ok()) {
        Some(mark) if mark.format != FORMAT => {
            return refuse(
                "holds a benchmark of another version: choose another folder".to_owned(),
            );
        }
        Some(Mark { suite, .. }) if suite != title => {
            return refuse(format!(
                "holds the benchmark \"{suite}\", not \"{title}\": choose another folder"
            ));
        }
        Some(_) => {}
        None => {
            if let Some(name) = first_entry(out) {
                return refuse(format!(
                    "is not empty, it holds {name}, and is no benchmark's: choose another folder"
                ));
            }
        }
    }
    fs::create_dir_all(out).map_err(|e| StorageError::write(out, e))?;
    let lock = FolderLock::acquire(out, "i2slam-bench")?;
    let mark = serde_json::to_string_pretty(&Mark { format: FORMAT, suite: title.to_owned() });
    let mark = mark.map_err(|e| Failure::Failed(e.to_string()))?;
    write_text(&out.join(MARK), &(mark + "\n"))?;
    Ok(lock)
}

#[cfg(test)]
mod tests {
    use super::*;
    use i2slam_check::TemporaryFolder;

    #[test]
    fn a_suite_goes_on_in_its_own_folder_and_in_no_other() {
        let out = TemporaryFolder::new("claim");
        let refused = |title| {
            let failure = claim(&out.0, title).map(drop).expect_err("not its folder");
            failure.message().expect("a message").to_owned()
        };
        let lock = claim(&out.0, "mine").expect("a new folder");
        let busy = claim(&out.0, "mine").map(drop).expect_err("another benchmark writes there");
        assert!(busy.message().is_some_and(|m| m.contains("is being written")));
        drop(lock);
        drop(claim(&out.0, "mine").expect("the same suite"));
        assert!(refused("other").contains("\"mine\", not \"other\""));
        fs::write(out.0.join(MARK), "{\"suite\": \"mine\"}").expect("room");
        assert!(refused("mine").contains("of another version"));
        fs::remove_file(out.0.join(MARK)).expect("a mark");
        fs::write(out.0.join("results.md"), "# mine\n").expect("room");
        assert!(refused("mine").contains("results.md"));
    }
}

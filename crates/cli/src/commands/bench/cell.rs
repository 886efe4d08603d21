//! One cell: a run and its judgement, as children of this program, and what is kept of them.

use super::input::List;
use super::plan::{Cell, Plan, Source};
use super::process::{Call, Stopped};
use i2slam_eval::frame_list;
use i2slam_result::remove_renders;
use serde::{Deserialize, Serialize};
use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// What is the same for all cells of a benchmark.
pub(super) struct Bench<'a> {
    pub(super) plan: &'a Plan,
    pub(super) out: &'a Path,
    pub(super) program: &'a Path,
    /// Checksum of the program.
    pub(super) build: &'a str,
    /// Threads of one cell.
    pub(super) threads: usize,
    /// Cells at once.
    pub(super) jobs: usize,
    pub(super) timeout: Option<Duration>,
    pub(super) keep_renders: bool,
}

/// `cell.json`: what was run, and how it ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Record {
    /// Flags of `i2slam run` that decide the result.
    pub(super) arguments: Vec<String>,
    /// The file given as `--config`.
    pub(super) settings: String,
    /// Frames whose pictures are judged, where there is a list.
    pub(super) list: Option<String>,
    /// How pictures are judged, if not by the figures of the run.
    #[serde(default)]
    pub(super) judgement: Option<String>,
    /// Version and checksum of the program.
    pub(super) build: String,
    pub(super) threads: usize,
    pub(super) jobs: usize,
    /// Wall time of the cell, judgement included [s].
    pub(super) seconds: f64,
    /// Whether the run itself ended well.
    pub(super) ran: bool,
    /// Why the cell failed.
    pub(super) failure: Option<String>,
}

impl Record {
    /// What was written at the end of the cell in this folder.
    pub(super) fn read(folder: &Path) -> Option<Self> {
        serde_json::from_str(&fs::read_to_string(folder.join("cell.json")).ok()?).ok()
    }

    /// Whether another record is of the same work, whichever build did it.
    pub(super) fn same_work(&self, other: &Self) -> bool {
        self.arguments == other.arguments
            && self.settings == other.settings
            && self.list == other.list
            && self.judgement == other.judgement
    }

    fn write(&self, folder: &Path) -> Result<(), Stopped> {
        let text =
            serde_json::to_string_pretty(self).map_err(|e| Stopped::Failed(e.to_string()))?;
        let (partial, file) = (folder.join(".cell.json.partial"), folder.join("cell.json"));
        fs::write(&partial, text + "\n")?;
        Ok(fs::rename(partial, file)?)
    }
}

impl Bench<'_> {
    pub(super) fn folder(&self, cell: &Cell) -> PathBuf {
        self.out.join(self.plan.folder(cell))
    }

    /// Where the frames of a sequence are.
    pub(super) fn dataset(&self, sequence: usize) -> PathBuf {
        let sequence = &self.plan.sequences[sequence];
        match &sequence.source {
            Source::Folder(folder) => folder.clone(),
            Source::Synth(_) => self.out.join("sequences").join(&sequence.slug),
        }
    }

    /// The record that this cell will have if all goes well.
    pub(super) fn due(&self, cell: &Cell) -> Record {
        let sequence = &self.plan.sequences[cell.sequence];
        let setting = &self.plan.settings[cell.setting];
        let source = match &sequence.source {
            Source::Folder(folder) => {
                folder.canonicalize().unwrap_or_else(|_| folder.clone()).display().to_string()
            }
            Source::Synth(spec) => format!("synth: {spec}"),
        };
        let mut arguments = vec![source, "--preset".to_owned(), setting.entry.preset.clone()];
        arguments.extend(["--seed".to_owned(), cell.seed.to_string()]);
        arguments.extend(sequence.flags.iter().chain(&setting.entry.flags).cloned());
        let list = sequence.list.as_ref().map(|list| match list {
            List::Auto => "auto".to_owned(),
            List::Frames(frames) => frame_list::write("Frames to be judged.", frames),
        });
        Record {
            arguments,
            settings: setting.overrides.clone(),
            list,
            judgement: self.plan.judgement(cell.sequence),
            build: self.build.to_owned(),
            threads: self.threads,
            jobs: self.jobs,
            seconds: 0.0,
            ran: false,
            failure: None,
        }
    }

    /// What is known of a cell that ended before, if it is of the same work.
    pub(super) fn known(&self, cell: &Cell) -> Option<Record> {
        Record::read(&self.folder(cell)).filter(|record| record.same_work(&self.due(cell)))
    }

    /// Runs what is missing of a cell; `started` is told every process. Only an interruption
    /// leaves no record.
    pub(super) fn run(&self, cell: &Cell, started: impl Fn(u32)) -> Result<Record, Stopped> {
        let folder = self.folder(cell);
        let begun = Instant::now();
        let before = self.known(cell).filter(|record| record.ran);
        let mut record = self.due(cell);
        record.ran = before.is_some();
        let ended = self.work(cell, &folder, &mut record, &started);
        let earlier = before.map_or(0.0, |before| before.seconds);
        record.seconds = earlier + begun.elapsed().as_secs_f64();
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

    fn work(
        &self,
        cell: &Cell,
        folder: &Path,
        record: &mut Record,
        started: &impl Fn(u32),
    ) -> Result<(), Stopped> {
        fs::create_dir_all(folder)?;
        let result = folder.join("result");
        if !record.ran {
            remove(&folder.join("cell.json"))?;
            remove(&folder.join("eval.json"))?;
            if result.exists() {
                fs::remove_dir_all(&result)?;
            }
            self.reconstruct(cell, folder, &result, started)?;
            record.ran = true;
        }
        self.judge(cell, folder, &result, started)?;
        if !self.keep_renders {
            remove_renders(&result).map_err(|e| Stopped::Failed(e.to_string()))?;
        }
        Ok(())
    }

    fn reconstruct(
        &self,
        cell: &Cell,
        folder: &Path,
        result: &Path,
        started: &impl Fn(u32),
    ) -> Result<(), Stopped> {
        let setting = &self.plan.settings[cell.setting];
        let overrides = folder.join("settings.toml");
        fs::write(&overrides, &setting.overrides)?;
        let mut arguments: Vec<OsString> = vec!["run".into(), self.dataset(cell.sequence).into()];
        arguments.extend(["--out".into(), result.into()]);
        arguments.extend(["--preset".into(), (&setting.entry.preset).into()]);
        arguments.extend(["--config".into(), overrides.into()]);
        arguments.extend(["--seed".into(), cell.seed.to_string().into()]);
        arguments.extend(["--threads".into(), self.threads.to_string().into()]);
        arguments.extend(["--quiet", "--render", "all"].map(OsString::from));
        let flags = self.plan.sequences[cell.sequence].flags.iter().chain(&setting.entry.flags);
        arguments.extend(flags.map(OsString::from));
        self.call(arguments, &folder.join("run.log"), None).run(started)
    }

    /// Pictures against the true ones, where there are such: `eval.json`.
    fn judge(
        &self,
        cell: &Cell,
        folder: &Path,
        result: &Path,
        started: &impl Fn(u32),
    ) -> Result<(), Stopped> {
        let dataset = self.dataset(cell.sequence);
        let list = &self.plan.sequences[cell.sequence].list;
        let judgement = self.plan.judgement(cell.sequence);
        if judgement.is_none() && !dataset.join("sharp").is_dir() {
            return Ok(());
        }
        let mut arguments: Vec<OsString> = vec!["eval".into(), result.into()];
        arguments.extend(["--reference".into(), dataset.into(), "--json".into()]);
        if let Some(list) = list {
            let file = folder.join("list.txt");
            let name = match list {
                List::Auto => "auto".into(),
                List::Frames(frames) => {
                    fs::write(&file, frame_list::write("Frames to be judged.", frames))?;
                    file.into()
                }
            };
            arguments.extend(["--list".into(), name]);
        }
        if let Some(protocol) = judgement.as_deref().and_then(|j| j.split(',').next()) {
            arguments.extend(["--protocol".into(), protocol.into()]);
        }
        if self.plan.suite.optimise_poses {
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
    pub(super) fn synthesise(&self, sequence: usize, threads: usize) -> Result<(), Stopped> {
        let entry = &self.plan.sequences[sequence];
        let Source::Synth(text) = &entry.source else { return Ok(()) };
        let folder = self.dataset(sequence);
        let spec = folder.with_extension("toml");
        if folder.is_dir() && fs::read_to_string(&spec).is_ok_and(|known| known == *text) {
            return Ok(());
        }
        let partial = folder.with_extension("partial");
        for stale in [&folder, &partial].into_iter().filter(|stale| stale.exists()) {
            fs::remove_dir_all(stale)?;
        }
        fs::create_dir_all(&partial)?;
        fs::write(&spec, text)?;
        let mut arguments: Vec<OsString> = vec!["synth".into(), (&spec).into(), "--out".into()];
        arguments.extend([(&partial).into(), "--threads".into(), threads.to_string().into()]);
        arguments.push("--quiet".into());
        let log = folder.with_extension("log");
        self.call(arguments, &log, None).run(|_| ())?;
        Ok(fs::rename(partial, folder)?)
    }

    fn call<'a>(
        &'a self,
        arguments: Vec<OsString>,
        log: &'a Path,
        output: Option<&'a Path>,
    ) -> Call<'a> {
        let (program, threads, timeout) = (self.program, self.threads, self.timeout);
        Call { program, arguments, threads, log, output, timeout }
    }
}

fn remove(file: &Path) -> Result<(), Stopped> {
    if file.exists() { Ok(fs::remove_file(file)?) } else { Ok(()) }
}

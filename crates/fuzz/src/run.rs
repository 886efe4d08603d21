//! A run: seeds as they are, then cases of all readers in turn, on several workers.

use crate::arguments::Arguments;
use crate::case::CaseId;
use crate::corpus::{self, Seed};
use crate::mutate;
use crate::protocol::Request;
use crate::readers::{self, READERS, Reader};
use crate::report::Report;
use crate::worker_process::WorkerProcess;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread::ScopedJoinHandle;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Cases of a run without `--seconds` and `--cases`.
const DEFAULT_CASES: u64 = 1000;
/// Workers at most.
const MAX_JOBS: usize = 8;

/// A reader with its seeds.
type Subject = (&'static Reader, Vec<Seed>);

/// Runs the cases that the arguments ask for; whether nothing failed.
pub(crate) fn run(arguments: &Arguments) -> Result<bool, String> {
    let subjects = subjects(arguments)?;
    let seed = arguments.seed.unwrap_or_else(seed_of_the_time);
    if let Some(number) = arguments.case {
        return run_one(arguments, &subjects[0], seed, number);
    }
    let queue = Queue::new(arguments, &subjects);
    let jobs = std::thread::available_parallelism().map_or(1, usize::from).min(MAX_JOBS);
    let jobs = arguments.jobs.unwrap_or(jobs).max(1);
    let names: Vec<&str> = subjects.iter().map(|(reader, _)| reader.name).collect();
    println!("seed {seed}, {jobs} workers, readers: {}", names.join(" "));
    let report = Mutex::new(Report::default());
    let work = |job: usize| -> Result<(), String> {
        let mut worker = WorkerProcess::new(arguments, seed, &job.to_string());
        while let Some(((reader, seeds), id)) = queue.next() {
            let answer = worker.ask(Request { reader: reader.name, id })?;
            let mut report = report.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
            if let Some(failure) = report.add(reader.name, seeds, (seed, id), answer) {
                println!("{failure}");
            }
        }
        Ok(())
    };
    let ended: Result<Vec<()>, String> = std::thread::scope(|scope| {
        let work = &work;
        let threads: Vec<_> = (0..jobs).map(|job| scope.spawn(move || work(job))).collect();
        let join = |thread: ScopedJoinHandle<'_, Result<(), String>>| {
            thread.join().unwrap_or_else(|_| Err("a thread of this program panicked".into()))
        };
        threads.into_iter().map(join).collect()
    });
    ended?;
    let report = report.into_inner().unwrap_or_else(|poisoned| poisoned.into_inner());
    println!("{}", report.table());
    Ok(report.is_clean())
}

/// The readers that were named, or all, with their seeds.
fn subjects(arguments: &Arguments) -> Result<Vec<Subject>, String> {
    let named = |name: &String| {
        readers::find(name).ok_or_else(|| {
            let known: Vec<&str> = READERS.iter().map(|reader| reader.name).collect();
            format!("no reader is called `{name}`: choose of {}", known.join(", "))
        })
    };
    let readers: Vec<&Reader> = match arguments.readers.is_empty() {
        true => READERS.iter().collect(),
        false => arguments.readers.iter().map(named).collect::<Result<_, _>>()?,
    };
    let with_seeds =
        |reader: &'static Reader| Ok((reader, corpus::read(&arguments.corpus, reader.name)?));
    readers.into_iter().map(with_seeds).collect()
}

fn seed_of_the_time() -> u64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH);
    now.map_or(0, |now| now.as_nanos() as u64 % 1_000_000_000)
}

/// Runs one case, shows its outcome, and writes its files if asked for.
fn run_one(
    arguments: &Arguments,
    (reader, seeds): &Subject,
    seed: u64,
    number: u64,
) -> Result<bool, String> {
    let id = CaseId::Number(number);
    if let Some(folder) = &arguments.write {
        let case = mutate::case(seeds, reader.name, seed, id);
        if folder.exists() {
            return Err(format!("{} is there already", folder.display()));
        }
        let written = case.write(folder);
        written.map_err(|e| format!("cannot write {}: {e}", folder.display()))?;
        println!("written to {}", folder.display());
    }
    let mut worker = WorkerProcess::new(arguments, seed, "one");
    let answer = worker.ask(Request { reader: reader.name, id })?;
    println!("{:.3} s, {} MB: {:?}", answer.seconds, answer.memory / 1_000_000, answer.outcome);
    let mut report = Report::default();
    if let Some(failure) = report.add(reader.name, seeds, (seed, id), answer) {
        println!("{failure}");
    }
    Ok(report.is_clean())
}

/// The cases of a run, in order.
struct Queue<'a> {
    subjects: &'a [Subject],
    /// Seeds of all subjects: place of the subject and of the seed.
    seeds: Vec<(usize, usize)>,
    next: AtomicU64,
    cases: u64,
    end: Option<Instant>,
}

impl<'a> Queue<'a> {
    fn new(arguments: &Arguments, subjects: &'a [Subject]) -> Self {
        let indexed = subjects.iter().enumerate();
        let seeds =
            indexed.flat_map(|(s, (_, seeds))| (0..seeds.len()).map(move |i| (s, i))).collect();
        let end = arguments.seconds.map(|seconds| Instant::now() + Duration::from_secs(seconds));
        let unbounded = if end.is_some() { u64::MAX } else { DEFAULT_CASES };
        let cases = arguments.cases.unwrap_or(unbounded);
        Self { subjects, seeds, next: AtomicU64::new(0), cases, end }
    }

    fn next(&self) -> Option<(&'a Subject, CaseId)> {
        let place = self.next.fetch_add(1, Ordering::Relaxed);
        if let Some(&(subject, seed)) = usize::try_from(place).ok().and_then(|p| self.seeds.get(p))
        {
            return Some((&self.subjects[subject], CaseId::Seed(seed)));
        }
        let case = place - self.seeds.len() as u64;
        if case >= self.cases || self.end.is_some_and(|end| Instant::now() >= end) {
            return None;
        }
        let readers = self.subjects.len() as u64;
        let subject = &self.subjects[(case % readers) as usize];
        Some((subject, CaseId::Number(case / readers)))
    }
}

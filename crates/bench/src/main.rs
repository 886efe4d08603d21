//! `i2slam-bench`: runs sequences × configurations × seeds with the program `i2slam`, each job in
//! a process of its own, and makes the paper's tables of the results.

#[path = "../../cli/src/console.rs"]
mod console;
mod interrupt;
mod job;
mod metrics;
mod plan;
mod process;
mod queue;
mod report;
mod sequences;
mod splats;
mod suite;
mod summary;
mod table;
mod tables;

use clap::Parser;
use console::{
    Failure, check_output_is_whole, counted, parse_arguments, print, print_status, print_text,
};
use interrupt::interrupted;
use job::{Bench, Record};
use metrics::Metrics;
use plan::{Plan, Selection};
use queue::Outcome;
use std::collections::HashMap;
use std::env::consts::EXE_SUFFIX;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use summary::Results;

/// Runs sequences × configurations × seeds with the program i2slam, and tabulates the results
#[derive(Parser, Debug)]
#[command(name = "i2slam-bench", version, max_term_width = 100)]
struct Arguments {
    /// Suite: a TOML file, or the name of one that comes with the program (see --list)
    #[arg(value_name = "SUITE", required_unless_present = "list")]
    suite: Option<PathBuf>,
    /// Folder for jobs and tables; finished jobs in it are not run again
    #[arg(long, value_name = "DIR", required_unless_present_any = ["list", "print", "dry_run"])]
    out: Option<PathBuf>,
    /// The program i2slam [default: the one beside this program, else on PATH]
    #[arg(long, value_name = "PATH")]
    program: Option<PathBuf>,
    #[command(flatten)]
    selection: Selection,
    /// Jobs at once, each with its share of the threads [default: the suite's, else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// End a job that takes longer; it counts as failed
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u64).range(1..))]
    timeout: Option<u64>,
    /// Run finished jobs again
    #[arg(long)]
    fresh: bool,
    /// Keep the pictures of every job, which take much space
    #[arg(long)]
    keep_renders: bool,
    /// Print the jobs and whether they are finished, and end
    #[arg(long)]
    dry_run: bool,
    /// Print the suites that come with the program, and end
    #[arg(long)]
    list: bool,
    /// Print the suite's file, and end
    #[arg(long)]
    print: bool,
    /// Threads of all jobs together [default: all cores]; results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print the summary only
    #[arg(long)]
    quiet: bool,
}

fn main() -> ExitCode {
    match run(&parse_arguments()).and_then(|()| check_output_is_whole()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => ExitCode::from(failure.report()),
    }
}

fn run(arguments: &Arguments) -> Result<(), Failure> {
    let Some(name) = arguments.suite.as_deref().filter(|_| !arguments.list) else {
        return list();
    };
    let file = suite::open(name)?;
    if arguments.print {
        print_text(file.text.trim_end());
        return Ok(());
    }
    let plan = Plan::new(file, &arguments.selection)?;
    let out = arguments.out.clone().unwrap_or_default();
    let parallel = arguments.jobs.map(usize::from).or(plan.suite.jobs).unwrap_or(1).max(1);
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = arguments.threads.map_or_else(cores, usize::from);
    let mut bench = Bench {
        plan: &plan,
        out: &out,
        program: PathBuf::new(),
        build: String::new(),
        threads: (threads / parallel).max(1),
        parallel,
        timeout: arguments.timeout.map(Duration::from_secs),
        keep_renders: arguments.keep_renders,
    };
    if arguments.dry_run {
        dry_run(&bench, arguments.fresh);
        return Ok(());
    }
    bench.program = find_program(arguments.program.as_deref())?;
    bench.build = build(&bench.program)?;
    run_jobs(&bench, threads, arguments)
}

fn list() -> Result<(), Failure> {
    for (name, text) in suite::SHIPPED {
        let suite = suite::parse(text, name)?;
        print(&format!("{name:<20}{}", suite.title));
    }
    Ok(())
}

/// The program `i2slam`: as given, beside this program, or on `PATH`.
fn find_program(given: Option<&Path>) -> Result<PathBuf, Failure> {
    if let Some(path) = given {
        let missing = || Failure::Usage(format!("--program {}: no such file", path.display()));
        return path.is_file().then(|| path.to_owned()).ok_or_else(missing);
    }
    let name = format!("i2slam{EXE_SUFFIX}");
    let beside = std::env::current_exe().ok().and_then(|own| Some(own.parent()?.to_owned()));
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = beside.into_iter().chain(std::env::split_paths(&path));
    folders.map(|folder| folder.join(&name)).find(|file| file.is_file()).ok_or_else(|| {
        Failure::Failed(format!(
            "the program {name} is neither beside i2slam-bench nor on PATH: name it with --program"
        ))
    })
}

/// Version and checksum of the program, by which metrics of two builds are told apart.
fn build(program: &Path) -> Result<String, Failure> {
    let bytes = std::fs::read(program)
        .map_err(|e| Failure::Failed(format!("{}: {e}", program.display())))?;
    Ok(format!("{} {:08x}", env!("CARGO_PKG_VERSION"), crc32fast::hash(&bytes)))
}

fn dry_run(bench: &Bench<'_>, fresh: bool) {
    for note in &bench.plan.notes {
        print_status(&format!("note: {note}"));
    }
    let mut left = 0;
    for job in &bench.plan.jobs {
        let record = bench.earlier_record(job).filter(|_| !fresh);
        let state = match record.map(|record| record.failure) {
            Some(None) => "finished",
            Some(Some(_)) => "failed",
            None => "to do",
        };
        left += usize::from(state != "finished");
        print(&format!("{state:<10}{}", bench.plan.title(job)));
    }
    let (jobs, threads) = (counted(bench.plan.jobs.len(), "job"), counted(bench.threads, "thread"));
    print(&format!("{left} of {jobs} to run, {} at once, {threads} each", bench.parallel));
}

/// Runs the jobs that are not finished, then writes tables and report.
fn run_jobs(bench: &Bench<'_>, threads: usize, arguments: &Arguments) -> Result<(), Failure> {
    let _lock = bench.claim_folder()?;
    interrupt::listen();
    let quiet = arguments.quiet;
    for note in bench.plan.notes.iter().filter(|_| !quiet) {
        print_status(&format!("note: {note}"));
    }
    let mut outcomes = earlier_outcomes(bench, arguments.fresh);
    let waiting: Vec<usize> = (0..outcomes.len())
        .filter(|&place| !matches!(outcomes[place], Outcome::Ended(_)))
        .collect();
    let total = waiting.len();
    if !quiet && total < outcomes.len() {
        print_status(&match outcomes.len() - total {
            1 => "1 job is finished already".to_owned(),
            finished => format!("{finished} jobs are finished already"),
        });
    }
    let (ready, without_sequence) = queue::render_sequences(bench, waiting, threads);
    let count = AtomicUsize::new(without_sequence.len());
    let records: HashMap<usize, Record> = queue::run(bench, ready, |place, record| {
        let number = count.fetch_add(1, Ordering::SeqCst) + 1;
        if !quiet {
            print_status(&format!("{number}/{total}  {}", progress(bench, place, record)));
        }
    });
    for (place, record) in records {
        outcomes[place] = Outcome::Ended(record);
    }
    for (place, reason) in without_sequence {
        outcomes[place] = Outcome::Unstarted(reason);
    }
    finish(bench, outcomes)
}

/// The jobs that finished before; with `fresh` none, and their records are removed.
fn earlier_outcomes(bench: &Bench<'_>, fresh: bool) -> Vec<Outcome> {
    let outcome = |job| match bench.earlier_record(job) {
        Some(record) if !fresh && record.failure.is_none() => Outcome::Ended(record),
        Some(_) if fresh => {
            std::fs::remove_file(bench.folder(job).join(job::RECORD)).ok();
            Outcome::NotRun
        }
        _ => Outcome::NotRun,
    };
    bench.plan.jobs.iter().map(outcome).collect()
}

/// One line about a job that ended.
fn progress(bench: &Bench<'_>, place: usize, record: &Record) -> String {
    let title = bench.plan.title(&bench.plan.jobs[place]);
    if let Some(reason) = &record.failure {
        return format!("{title}: failed: {reason}");
    }
    let metrics = metrics_of(bench, place);
    let shown = [&metrics::SECONDS, &metrics::ATE, &metrics::PSNR].into_iter().filter_map(|m| {
        let value = metrics.get(m.key)?;
        Some(format!("{} {} {}", m.label, m.text(*value), m.unit))
    });
    format!("{title}: {} ({:.0} s)", shown.collect::<Vec<_>>().join(", "), record.seconds)
}

fn metrics_of(bench: &Bench<'_>, place: usize) -> Metrics {
    let job = &bench.plan.jobs[place];
    let protocol = bench.plan.protocol(job.sequence).is_some();
    metrics::of_job(&bench.folder(job), protocol).unwrap_or_default()
}

/// Writes tables and report; the result is that of the program.
fn finish(bench: &Bench<'_>, outcomes: Vec<Outcome>) -> Result<(), Failure> {
    let finished = |place: usize| matches!(&outcomes[place], Outcome::Ended(record) if record.failure.is_none());
    let metrics = (0..outcomes.len())
        .map(|place| if finished(place) { metrics_of(bench, place) } else { Metrics::new() })
        .collect();
    let results = Results { plan: bench.plan, outcomes, metrics };
    report::write(&results, bench.out)?;
    let [_, failed, left] = report::counts(&results);
    match failed {
        0 => {}
        1 => print_status("error: one job failed; the tables say why"),
        _ => print_status(&format!("error: {failed} jobs failed; the tables say why")),
    }
    print(&report::state(&results));
    let absolute = std::path::absolute(bench.out).unwrap_or_else(|_| bench.out.to_owned());
    print(&format!("tables in {}", absolute.join("results.md").display()));
    print(&absolute.join("results.html").display().to_string());
    if left > 0 && interrupted() {
        return Err(Failure::Interrupted);
    }
    if failed > 0 { Err(Failure::Reported) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn arguments_are_consistent() {
        Arguments::command().debug_assert();
    }

    #[test]
    fn a_given_program_must_exist() {
        let own = std::env::current_exe().expect("this test");
        assert!(find_program(Some(&own)).is_ok_and(|path| path == own));
        let failure = find_program(Some(Path::new("/nowhere/i2slam"))).expect_err("no file");
        assert!(failure.message().is_some_and(|m| m.contains("--program /nowhere/i2slam")));
    }
}

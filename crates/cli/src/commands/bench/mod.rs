//! `i2slam bench`: sequences x configurations x seeds, each a run in a process of its own, and
//! the paper's tables of what came out.

mod cell;
mod figures;
mod folder;
mod input;
mod layouts;
mod memory;
mod notes;
mod page;
mod plan;
mod plot;
mod plots;
mod process;
mod queue;
mod sequences;
mod suite;
mod summary;
mod table;

use crate::arguments::Machine;
use crate::failure::Failure;
use crate::interrupt;
use crate::output::{counted, print, print_status};
use cell::{Bench as Work, Record};
use clap::Args;
use figures::Figures;
use plan::{Plan, Wanted};
use queue::Outcome;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Duration;
use summary::Results;

#[derive(Args, Debug)]
pub(crate) struct Bench {
    /// Suite: a TOML file, or the name of one that comes with the program (see --list)
    #[arg(value_name = "SUITE", required_unless_present = "list")]
    pub(crate) suite: Option<PathBuf>,
    /// Folder for cells and tables; what is finished there is not run again
    #[arg(long, value_name = "DIR", required_unless_present_any = ["list", "print", "dry_run"])]
    pub(crate) out: Option<PathBuf>,
    /// Folder of the data sets that the suite names [default: that of the suite's file]
    #[arg(long, value_name = "DIR")]
    pub(crate) data: Option<PathBuf>,
    /// Cells at once, each with its share of the threads [default: the suite's, else 1]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub(crate) jobs: Option<u16>,
    /// Only these sequences: names separated by commas; may repeat
    #[arg(long, value_name = "NAMES")]
    pub(crate) sequences: Vec<String>,
    /// Only these configurations: names separated by commas; may repeat
    #[arg(long, value_name = "NAMES")]
    pub(crate) configurations: Vec<String>,
    /// These seeds instead of the suite's
    #[arg(long, value_name = "SEEDS", value_delimiter = ',')]
    pub(crate) seeds: Option<Vec<u64>>,
    /// End a cell that takes longer; it counts as failed
    #[arg(long, value_name = "SECONDS", value_parser = clap::value_parser!(u64).range(1..))]
    pub(crate) timeout: Option<u64>,
    /// Run finished cells again
    #[arg(long)]
    pub(crate) fresh: bool,
    /// Keep the pictures of every cell, which need much room
    #[arg(long)]
    pub(crate) keep_renders: bool,
    /// Print the cells and whether they are finished, and end
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Print the suites that come with the program, and end
    #[arg(long)]
    pub(crate) list: bool,
    /// Print the suite's file, and end
    #[arg(long)]
    pub(crate) print: bool,
    #[command(flatten)]
    pub(crate) machine: Machine,
}

pub(crate) fn bench(arguments: &Bench) -> Result<(), Failure> {
    let Some(name) = arguments.suite.as_deref().filter(|_| !arguments.list) else {
        return list();
    };
    let origin = suite::open(name)?;
    if arguments.print {
        return print_suite(name);
    }
    let plan = Plan::new(origin, &wanted(arguments))?;
    let out = arguments.out.clone().unwrap_or_default();
    let program = std::env::current_exe()
        .map_err(|e| Failure::Failed(format!("this program is not found: {e}")))?;
    let build = build(&program)?;
    let jobs = arguments.jobs.map(usize::from).or(plan.suite.jobs).unwrap_or(1).max(1);
    let threads = cores(arguments);
    let work = Work {
        plan: &plan,
        out: &out,
        program: &program,
        build: &build,
        threads: (threads / jobs).max(1),
        jobs,
        timeout: arguments.timeout.map(Duration::from_secs),
        keep_renders: arguments.keep_renders,
    };
    if arguments.dry_run {
        dry_run(&work, arguments.fresh);
        return Ok(());
    }
    run(&work, threads, arguments)
}

fn list() -> Result<(), Failure> {
    for (name, text) in suite::SHIPPED {
        let suite = suite::parse(text, name)?;
        print(&format!("{name:<20}{}", suite.title));
    }
    Ok(())
}

fn print_suite(name: &Path) -> Result<(), Failure> {
    let text = match suite::shipped(&name.to_string_lossy()) {
        Some(text) if !name.is_file() => text.to_owned(),
        _ => std::fs::read_to_string(name)
            .map_err(|e| Failure::Failed(format!("{}: {e}", name.display())))?,
    };
    print(text.trim_end());
    Ok(())
}

fn wanted(arguments: &Bench) -> Wanted {
    Wanted {
        data: arguments.data.clone(),
        sequences: arguments.sequences.clone(),
        configurations: arguments.configurations.clone(),
        seeds: arguments.seeds.clone(),
    }
}

/// Threads for all cells together.
fn cores(arguments: &Bench) -> usize {
    let all = || std::thread::available_parallelism().map_or(1, usize::from);
    arguments.machine.threads.map_or_else(all, usize::from)
}

/// Version and checksum of the program, so that figures of two builds are told apart.
fn build(program: &Path) -> Result<String, Failure> {
    let bytes = std::fs::read(program)
        .map_err(|e| Failure::Failed(format!("{}: {e}", program.display())))?;
    Ok(format!("{} {:08x}", env!("CARGO_PKG_VERSION"), crc32fast::hash(&bytes)))
}

fn dry_run(work: &Work<'_>, fresh: bool) {
    for note in &work.plan.notes {
        print_status(&format!("note: {note}"));
    }
    let mut left = 0;
    for cell in &work.plan.cells {
        let known = work.known(cell).filter(|_| !fresh);
        let state = match known.map(|record| record.failure) {
            Some(None) => "finished",
            Some(Some(_)) => "failed",
            None => "to do",
        };
        left += usize::from(state != "finished");
        print(&format!("{state:<10}{}", work.plan.title(cell)));
    }
    let (count, jobs, threads) = (work.plan.cells.len(), work.jobs, work.threads);
    let (cells, threads) = (counted(count, "cell"), counted(threads, "thread"));
    print(&format!("{left} of {cells} to run, {jobs} at once, {threads} each"));
}

fn run(work: &Work<'_>, threads: usize, arguments: &Bench) -> Result<(), Failure> {
    folder::claim(work.out, &work.plan.suite.title)?;
    interrupt::listen();
    let quiet = arguments.machine.quiet;
    for note in work.plan.notes.iter().filter(|_| !quiet) {
        print_status(&format!("note: {note}"));
    }
    let mut outcomes = known(work, arguments.fresh);
    let waiting: Vec<usize> = (0..outcomes.len())
        .filter(|&place| !matches!(outcomes[place], Outcome::Ended(_)))
        .collect();
    let total = waiting.len();
    if !quiet && total < outcomes.len() {
        print_status(&match outcomes.len() - total {
            1 => "1 cell is finished already".to_owned(),
            finished => format!("{finished} cells are finished already"),
        });
    }
    let (ready, unmade) = queue::prepare(work, waiting, threads);
    let count = AtomicUsize::new(unmade.len());
    let records = queue::run(work, ready, |place, record| {
        let number = count.fetch_add(1, Ordering::SeqCst) + 1;
        if !quiet {
            print_status(&format!("{number}/{total}  {}", progress(work, place, record)));
        }
    });
    place(&mut outcomes, records, unmade);
    finish(work, outcomes)
}

/// What ended well before; the rest is to be run.
fn known(work: &Work<'_>, fresh: bool) -> Vec<Outcome> {
    let outcome = |cell| match work.known(cell) {
        Some(record) if !fresh && record.failure.is_none() => Outcome::Ended(record),
        Some(_) if fresh => {
            std::fs::remove_file(work.folder(cell).join("cell.json")).ok();
            Outcome::NotRun
        }
        _ => Outcome::NotRun,
    };
    work.plan.cells.iter().map(outcome).collect()
}

fn place(
    outcomes: &mut [Outcome],
    records: HashMap<usize, Record>,
    unmade: HashMap<usize, String>,
) {
    for (place, record) in records {
        outcomes[place] = Outcome::Ended(record);
    }
    for (place, reason) in unmade {
        outcomes[place] = Outcome::Unstarted(reason);
    }
}

/// One line about a cell that ended.
fn progress(work: &Work<'_>, place: usize, record: &Record) -> String {
    let cell = &work.plan.cells[place];
    let title = work.plan.title(cell);
    if let Some(reason) = &record.failure {
        return format!("{title}: failed: {reason}");
    }
    let figures = figures_of(work, place);
    let shown = [&figures::SECONDS, &figures::ATE, &figures::PSNR].into_iter().filter_map(|f| {
        let value = figures.get(f.key)?;
        Some(format!("{} {} {}", f.label, f.text(*value), f.unit))
    });
    format!("{title}: {} ({:.0} s)", shown.collect::<Vec<_>>().join(", "), record.seconds)
}

fn figures_of(work: &Work<'_>, place: usize) -> Figures {
    let cell = &work.plan.cells[place];
    let judged = work.plan.judgement(cell.sequence).is_some();
    figures::of_cell(&work.folder(cell), judged).unwrap_or_default()
}

/// Tables, then how it ended.
fn finish(work: &Work<'_>, outcomes: Vec<Outcome>) -> Result<(), Failure> {
    let finished = |place: usize| matches!(&outcomes[place], Outcome::Ended(record) if record.failure.is_none());
    let figures = (0..outcomes.len())
        .map(|place| if finished(place) { figures_of(work, place) } else { Figures::new() })
        .collect();
    let results = Results { plan: work.plan, outcomes, figures };
    page::write(&results, work.out)?;
    print(&page::state(&results));
    let absolute = std::path::absolute(work.out).unwrap_or_else(|_| work.out.to_owned());
    print(&format!("tables in {}", absolute.join("results.md").display()));
    print(&absolute.join("results.html").display().to_string());
    let [_, failed, left] = page::counts(&results);
    if left > 0 && interrupt::requested() {
        return Err(Failure::Interrupted);
    }
    match failed {
        0 => Ok(()),
        1 => Err(Failure::Failed("one cell failed; the tables say why".to_owned())),
        _ => Err(Failure::Failed(format!("{failed} cells failed; the tables say why"))),
    }
}

//! The job queue: jobs side by side, as many as threads and memory allow.

use crate::interrupt::interrupted;
use crate::job::{Bench, Record};
use crate::plan::Job;
use crate::process::Stopped;
use std::collections::HashMap;
use std::fs;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// Expected memory of a job before any other has run [bytes].
const INITIAL_MEMORY: u64 = 1 << 30;

/// Interval at which free memory is polled.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// State of a job of the plan.
#[derive(Clone, Debug)]
pub(crate) enum Outcome {
    /// It ran, now or before.
    Ended(Record),
    /// It could not begin.
    Unstarted(String),
    /// The benchmark ended before it.
    NotRun,
}

/// Waiting and running jobs.
struct State {
    waiting: std::vec::IntoIter<usize>,
    running: HashMap<usize, Running>,
    /// Peak memory of finished jobs by sequence [bytes].
    peaks: HashMap<usize, u64>,
}

#[derive(Clone, Copy)]
struct Running {
    expected: u64,
    process: Option<u32>,
}

/// Runs jobs of the plan by their indices; `done` is called for each that ended.
pub(crate) fn run(
    bench: &Bench<'_>,
    places: Vec<usize>,
    done: impl Fn(usize, &Record) + Sync,
) -> HashMap<usize, Record> {
    let workers = bench.parallel.min(places.len());
    let mut peaks = HashMap::new();
    bench.plan.jobs.iter().for_each(|job| add_peak(&mut peaks, bench, job));
    let state = State { waiting: places.into_iter(), running: HashMap::new(), peaks };
    let (state, records) = (Mutex::new(state), Mutex::new(HashMap::new()));
    std::thread::scope(|scope| {
        for _ in 0..workers {
            scope.spawn(|| {
                while let Some(place) = next(bench, &state) {
                    let job = &bench.plan.jobs[place];
                    let ended = bench.run(job, |process| set_process(&state, place, process));
                    let mut queue = lock(&state);
                    queue.running.remove(&place);
                    add_peak(&mut queue.peaks, bench, job);
                    drop(queue);
                    let Ok(record) = ended else { break };
                    done(place, &record);
                    lock(&records).insert(place, record);
                }
            });
        }
    });
    records.into_inner().unwrap_or_else(PoisonError::into_inner)
}

/// Waits until the next job fits into memory; `None` at the end of the queue and on interruption.
fn next(bench: &Bench<'_>, state: &Mutex<State>) -> Option<usize> {
    loop {
        if interrupted() {
            return None;
        }
        let mut state = lock(state);
        let place = *state.waiting.as_slice().first()?;
        let sequence = bench.plan.jobs[place].sequence;
        let any = state.peaks.values().copied().max().unwrap_or(INITIAL_MEMORY);
        let expected = state.peaks.get(&sequence).copied().unwrap_or(any);
        let running: Vec<Load> = state.running.values().map(load).collect();
        if fits(available_memory(), expected, &running) {
            state.waiting.next();
            state.running.insert(place, Running { expected, process: None });
            return Some(place);
        }
        drop(state);
        std::thread::sleep(POLL_INTERVAL);
    }
}

fn load(running: &Running) -> Load {
    let held = running.process.map_or(0, held_memory);
    Load { expected: running.expected, held }
}

fn set_process(state: &Mutex<State>, place: usize, process: u32) {
    if let Some(running) = lock(state).running.get_mut(&place) {
        running.process = Some(process);
    }
}

/// Adds the peak memory of a job that ran, now or before, to those by sequence.
fn add_peak(peaks: &mut HashMap<usize, u64>, bench: &Bench<'_>, job: &Job) {
    let metrics = crate::metrics::read(&bench.folder(job).join("result/metrics.json"));
    if let Some(bytes) = metrics.and_then(|metrics| metrics.get("peak_memory_bytes").copied()) {
        let known = peaks.entry(job.sequence).or_default();
        *known = (*known).max(bytes as u64);
    }
}

/// Locks also after a panic: the list of jobs stays valid.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Renders the synthetic sequences of the jobs `places`. Returns the jobs whose sequence is there,
/// and for the others why it is not.
pub(crate) fn render_sequences(
    bench: &Bench<'_>,
    places: Vec<usize>,
    threads: usize,
) -> (Vec<usize>, HashMap<usize, String>) {
    let mut state: HashMap<usize, Option<String>> = HashMap::new();
    let (mut ready, mut failed) = (Vec::new(), HashMap::new());
    for place in places {
        let sequence = bench.plan.jobs[place].sequence;
        let problem = state.entry(sequence).or_insert_with(|| {
            if interrupted() {
                return None;
            }
            match bench.render_sequence(sequence, threads) {
                Ok(()) | Err(Stopped::Interrupted) => None,
                Err(Stopped::Failed(reason)) => Some(format!("sequence not made: {reason}")),
            }
        });
        match problem {
            None => ready.push(place),
            Some(reason) => {
                failed.insert(place, reason.clone());
            }
        }
    }
    (ready, failed)
}

/// Memory that can still be taken [bytes]: that of the system, or of its control group; unknown
/// except on Linux.
fn available_memory() -> Option<u64> {
    let system = in_kilobytes(&fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:");
    match (system, control_group_memory()) {
        (Some(system), Some(group)) => Some(system.min(group)),
        (system, group) => system.or(group),
    }
}

/// Resident memory of a process [bytes]; 0 where it is not known.
fn held_memory(process: u32) -> u64 {
    let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    in_kilobytes(&status, "VmRSS:").unwrap_or(0)
}

fn control_group_memory() -> Option<u64> {
    let number = |file: &str| -> Option<u64> {
        fs::read_to_string(format!("/sys/fs/cgroup/{file}")).ok()?.trim().parse().ok()
    };
    Some(number("memory.max")?.saturating_sub(number("memory.current")?))
}

/// The value of a line `NAME 123 kB` [bytes].
fn in_kilobytes(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kilobytes: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kilobytes * 1024)
}

/// Memory of a running job.
#[derive(Clone, Copy, Debug)]
struct Load {
    /// Expected peak [bytes].
    expected: u64,
    /// Held now [bytes].
    held: u64,
}

/// Whether a job of `expected` bytes fits beside others that may still grow. A quarter more is
/// asked for, because the next seed may need more than the last.
fn fits(available: Option<u64>, expected: u64, running: &[Load]) -> bool {
    if running.is_empty() {
        return true;
    }
    let growth: u64 = running.iter().map(|load| load.expected.saturating_sub(load.held)).sum();
    available.is_none_or(|free| free.saturating_sub(growth) >= expected + expected / 4)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_are_read_from_the_system_s_text() {
        let text = "MemTotal:  9 kB\nMemAvailable:    2048 kB\n";
        assert_eq!(in_kilobytes(text, "MemAvailable:"), Some(2 << 20));
        assert_eq!(in_kilobytes(text, "VmRSS:"), None);
    }

    #[test]
    fn a_job_waits_for_what_others_will_still_take() {
        let load = Load { expected: 100, held: 20 };
        assert!(fits(Some(0), 100, &[]), "one always runs");
        assert!(fits(Some(300), 100, &[load]) && fits(None, 100, &[load]));
        assert!(!fits(Some(200), 100, &[load]), "80 are promised, 125 are needed");
    }
}

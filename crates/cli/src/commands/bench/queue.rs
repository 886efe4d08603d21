//! Cells side by side, as many as cores and memory allow.

use super::cell::{Bench, Record};
use super::memory::{self, Load};
use super::plan::Cell;
use super::process::Stopped;
use crate::interrupt;
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// What a cell is expected to hold before one of its sequence has run [bytes].
const GUESS: u64 = 1 << 30;

/// Time between two looks at the memory.
const PAUSE: Duration = Duration::from_millis(100);

/// How a cell of the plan stands.
#[derive(Clone, Debug)]
pub(super) enum Outcome {
    /// It ran, now or before.
    Ended(Record),
    /// It could not begin.
    Unstarted(String),
    /// The benchmark ended before it.
    NotRun,
}

/// Cells that wait and cells that run.
struct State {
    waiting: std::vec::IntoIter<usize>,
    running: HashMap<usize, Running>,
    /// Most memory that a finished cell of a sequence held [bytes].
    peaks: HashMap<usize, u64>,
}

#[derive(Clone, Copy)]
struct Running {
    expected: u64,
    process: Option<u32>,
}

/// Runs cells of the plan by their places; `done` is told each that ended.
pub(super) fn run(
    bench: &Bench<'_>,
    places: Vec<usize>,
    done: impl Fn(usize, &Record) + Sync,
) -> HashMap<usize, Record> {
    let jobs = bench.jobs.min(places.len());
    let state = State { waiting: places.into_iter(), running: HashMap::new(), peaks: peaks(bench) };
    let (state, records) = (Mutex::new(state), Mutex::new(HashMap::new()));
    std::thread::scope(|scope| {
        for _ in 0..jobs {
            scope.spawn(|| {
                while let Some(place) = next(bench, &state) {
                    let cell = &bench.plan.cells[place];
                    let ended = bench.run(cell, |process| note(&state, place, process));
                    end(bench, &state, place, cell);
                    let Ok(record) = ended else { break };
                    done(place, &record);
                    lock(&records).insert(place, record);
                }
            });
        }
    });
    records.into_inner().unwrap_or_else(PoisonError::into_inner)
}

/// The next cell, once there is room for it; `None` when all are given out or the user ends.
fn next(bench: &Bench<'_>, state: &Mutex<State>) -> Option<usize> {
    loop {
        if interrupt::requested() {
            return None;
        }
        let mut state = lock(state);
        let place = *state.waiting.as_slice().first()?;
        let sequence = bench.plan.cells[place].sequence;
        let any = state.peaks.values().copied().max().unwrap_or(GUESS);
        let expected = state.peaks.get(&sequence).copied().unwrap_or(any);
        let running: Vec<Load> = state.running.values().map(load).collect();
        if memory::fits(memory::available(), expected, &running) {
            state.waiting.next();
            state.running.insert(place, Running { expected, process: None });
            return Some(place);
        }
        drop(state);
        std::thread::sleep(PAUSE);
    }
}

fn load(running: &Running) -> Load {
    let held = running.process.map_or(0, memory::held_by);
    Load { expected: running.expected, held }
}

fn note(state: &Mutex<State>, place: usize, process: u32) {
    if let Some(running) = lock(state).running.get_mut(&place) {
        running.process = Some(process);
    }
}

fn end(bench: &Bench<'_>, state: &Mutex<State>, place: usize, cell: &Cell) {
    let peak = peak(bench, cell);
    let mut state = lock(state);
    state.running.remove(&place);
    if let Some(peak) = peak {
        let known = state.peaks.entry(cell.sequence).or_default();
        *known = peak.max(*known);
    }
}

/// Of the cells that ran before.
fn peaks(bench: &Bench<'_>) -> HashMap<usize, u64> {
    let mut peaks = HashMap::new();
    for cell in &bench.plan.cells {
        if let Some(peak) = peak(bench, cell) {
            let known = peaks.entry(cell.sequence).or_default();
            *known = peak.max(*known);
        }
    }
    peaks
}

fn peak(bench: &Bench<'_>, cell: &Cell) -> Option<u64> {
    super::figures::read(&bench.folder(cell).join("result/metrics.json"))?
        .get("peak_memory_bytes")
        .map(|bytes| *bytes as u64)
}

/// What a thread that panicked left is still a list of cells.
fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Renders the sequences that `places` need; the places that have theirs, and why others do not.
pub(super) fn prepare(
    bench: &Bench<'_>,
    places: Vec<usize>,
    threads: usize,
) -> (Vec<usize>, HashMap<usize, String>) {
    let mut state: HashMap<usize, Option<String>> = HashMap::new();
    let (mut ready, mut failed) = (Vec::new(), HashMap::new());
    for place in places {
        let sequence = bench.plan.cells[place].sequence;
        let problem = state.entry(sequence).or_insert_with(|| {
            if interrupt::requested() {
                return None;
            }
            match bench.synthesise(sequence, threads) {
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

//! How the numbers of a table came about, in words.

use super::queue::Outcome;
use super::summary::Results;
use crate::output::counted;

/// How the numbers of a table came about.
pub(super) fn about(results: &Results<'_>, what: &str) -> String {
    let plan = results.plan;
    let seeds: Vec<String> = plan.suite.seeds.iter().map(u64::to_string).collect();
    let seeds = match seeds.len() {
        1 => format!("One seed: {}", seeds[0]),
        count => {
            let list = seeds.join(", ");
            format!("Mean ± standard deviation over {count} seeds ({list})")
        }
    };
    let lost = |sequence: &usize| {
        let mut cells = plan.cells.iter().enumerate();
        !cells.any(|(place, cell)| cell.sequence == *sequence && results.finished(place))
    };
    let lost: Vec<&str> = (0..plan.sequences.len())
        .filter(lost)
        .map(|sequence| plan.sequences[sequence].name.as_str())
        .collect();
    match lost.is_empty() {
        true => format!("{what} {seeds}."),
        false => {
            format!("{what} {seeds}; no cell of {} finished: it is in no mean.", lost.join(", "))
        }
    }
}

/// The same for means over sequences.
pub(super) fn over_sequences(results: &Results<'_>, what: &str) -> String {
    let text = match results.plan.sequences.len() {
        1 => format!("{what} On {}.", results.plan.sequences[0].name),
        count => {
            format!("{what} Means over the {count} sequences, of those with the truth for it.")
        }
    };
    about(results, &text)
}

/// Threads of a cell and cells at once, as the records say.
pub(super) fn machine(results: &Results<'_>) -> String {
    let both = results.outcomes.iter().filter_map(|outcome| match outcome {
        Outcome::Ended(record) => Some((record.threads, record.jobs)),
        _ => None,
    });
    let mut both: Vec<(usize, usize)> = both.collect();
    both.sort_unstable();
    both.dedup();
    let words: Vec<String> = both
        .iter()
        .map(|&(threads, jobs)| {
            format!("{} a cell, {} at once", counted(threads, "thread"), counted(jobs, "cell"))
        })
        .collect();
    match words.len() {
        0 => String::new(),
        1 => format!("Measured with {}.", words[0]),
        _ => format!(
            "Cells were run in different ways, so that their times cannot be compared: {}.",
            words.join("; ")
        ),
    }
}

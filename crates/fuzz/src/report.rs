//! Counts per reader, and the failures.

use crate::case::CaseId;
use crate::corpus::Seed;
use crate::failure::{Failure, Outcome};
use crate::protocol::Answer;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Failures of one reader and kind that are shown.
const SHOWN: usize = 5;

/// Characters of a failure that are shown.
const SHOWN_LENGTH: usize = 500;

/// Counts of one reader.
#[derive(Default)]
struct Row {
    cases: usize,
    accepted: usize,
    refused: usize,
    failures: usize,
    slowest: f64,
    memory: u64,
}

/// Outcome of a run.
#[derive(Default)]
pub(crate) struct Report {
    rows: BTreeMap<&'static str, Row>,
    kinds: BTreeMap<(&'static str, &'static str), usize>,
}

impl Report {
    /// Adds a case. A failure that is worth showing is returned as text.
    pub(crate) fn add(
        &mut self,
        reader: &'static str,
        seeds: &[Seed],
        (seed, id): (u64, CaseId),
        mut answer: Answer,
    ) -> Option<String> {
        if let (CaseId::Seed(index), Outcome::Refused(message)) = (id, &answer.outcome)
            && seeds[index].is_valid()
        {
            answer.outcome = Outcome::Failed(Failure::SeedRefused(message.clone()));
        }
        let row = self.rows.entry(reader).or_default();
        row.cases += 1;
        row.slowest = row.slowest.max(answer.seconds);
        row.memory = row.memory.max(answer.memory);
        let failure = match answer.outcome {
            Outcome::Accepted => {
                row.accepted += 1;
                return None;
            }
            Outcome::Refused(_) => {
                row.refused += 1;
                return None;
            }
            Outcome::Failed(failure) => failure,
        };
        row.failures += 1;
        let count = self.kinds.entry((reader, failure.kind())).or_default();
        *count += 1;
        let place = match id {
            CaseId::Seed(index) => format!("seed {}", seeds[index].name),
            CaseId::Number(number) => format!("--seed {seed} --case {number}"),
        };
        let shown: String = failure.to_string().chars().take(SHOWN_LENGTH).collect();
        (*count <= SHOWN).then(|| format!("FAILURE {reader} {place}: {shown}"))
    }

    /// Whether nothing failed.
    pub(crate) fn is_clean(&self) -> bool {
        self.kinds.is_empty()
    }

    /// The table, and the number of failures of every kind.
    pub(crate) fn table(&self) -> String {
        let head = ["cases", "accepted", "refused", "failures", "slowest [s]", "memory [MB]"];
        let mut text = format!("| {:<17} |", "reader");
        let mut rule = format!("|{:-<19}|", "");
        for name in head {
            // Writing to a string cannot fail.
            let _ = write!(text, " {name} |");
            let _ = write!(rule, "{:->1$}:|", "", name.len() + 1);
        }
        let mut sum = Row::default();
        let mut lines = vec![text, rule];
        for (reader, row) in &self.rows {
            lines.push(line(reader, row));
            sum.cases += row.cases;
            sum.accepted += row.accepted;
            sum.refused += row.refused;
            sum.failures += row.failures;
            sum.slowest = sum.slowest.max(row.slowest);
            sum.memory = sum.memory.max(row.memory);
        }
        lines.push(line("all", &sum));
        let kinds = self.kinds.iter().map(|((reader, kind), n)| format!("{reader}: {n} x {kind}"));
        lines.extend(kinds);
        lines.join("\n")
    }
}

fn line(name: &str, row: &Row) -> String {
    format!(
        "| {name:<17} | {:5} | {:8} | {:7} | {:8} | {:11.2} | {:11} |",
        row.cases,
        row.accepted,
        row.refused,
        row.failures,
        row.slowest,
        row.memory / 1_000_000
    )
}

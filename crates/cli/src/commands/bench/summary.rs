//! Means and spreads over seeds; what is missing stays visible.

use super::figures::{Figure, Figures};
use super::plan::Plan;
use super::queue::Outcome;

/// A plan with what came of it, cell by cell.
pub(super) struct Results<'a> {
    pub(super) plan: &'a Plan,
    /// As [`Plan::cells`].
    pub(super) outcomes: Vec<Outcome>,
    /// As [`Plan::cells`]; empty for a cell that is not finished.
    pub(super) figures: Vec<Figures>,
}

/// One number of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Value {
    /// Over some of the seeds.
    Measured(Measured),
    /// Nothing to measure it with: no truth.
    Unknown,
    /// No seed finished, and some failed.
    Failed,
    /// No seed finished, and some did not begin.
    NotRun,
}

/// A mean over seeds, in the unit of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measured {
    pub(super) mean: f64,
    /// Standard deviation of one seed, from two seeds on.
    pub(super) spread: Option<f64>,
    /// Seeds that have the figure.
    pub(super) seeds: usize,
    /// Seeds that should have it.
    pub(super) planned: usize,
}

impl Value {
    pub(super) fn measured(&self) -> Option<&Measured> {
        match self {
            Self::Measured(measured) => Some(measured),
            _ => None,
        }
    }
}

impl Results<'_> {
    /// Whether a cell has figures.
    pub(super) fn finished(&self, place: usize) -> bool {
        matches!(&self.outcomes[place], Outcome::Ended(record) if record.failure.is_none())
    }

    /// Why a cell has none.
    pub(super) fn failure(&self, place: usize) -> Option<&str> {
        match &self.outcomes[place] {
            Outcome::Ended(record) => record.failure.as_deref(),
            Outcome::Unstarted(reason) => Some(reason),
            Outcome::NotRun => None,
        }
    }

    fn places(&self, sequence: usize, setting: usize) -> impl Iterator<Item = usize> + '_ {
        let cells = self.plan.cells.iter().enumerate();
        cells
            .filter(move |(_, cell)| cell.sequence == sequence && cell.setting == setting)
            .map(|(place, _)| place)
    }

    fn number(&self, place: usize, figure: &Figure) -> Option<f64> {
        self.figures[place].get(figure.key).copied()
    }

    /// One sequence, one configuration.
    pub(super) fn of(&self, sequence: usize, setting: usize, figure: &Figure) -> Value {
        let places: Vec<usize> = self.places(sequence, setting).collect();
        let numbers = places.iter().map(|&place| self.number(place, figure)).collect();
        self.value(numbers, &places)
    }

    /// The mean over all sequences that have the figure at all. A seed counts where every one of
    /// them has it, so that no row is better for a sequence that it lost.
    pub(super) fn over_sequences(&self, setting: usize, figure: &Figure) -> Value {
        let sequences = self.sequences_with(figure);
        let by_sequence: Vec<Vec<usize>> =
            sequences.iter().map(|&s| self.places(s, setting).collect()).collect();
        let seeds = self.plan.suite.seeds.len();
        let mean = |seed: usize| {
            let numbers = by_sequence.iter().map(|p| self.number(*p.get(seed)?, figure));
            let numbers: Option<Vec<f64>> = numbers.collect();
            numbers.filter(|n| !n.is_empty()).map(|n| n.iter().sum::<f64>() / n.len() as f64)
        };
        let places: Vec<usize> = by_sequence.iter().flatten().copied().collect();
        self.value((0..seeds).map(mean).collect(), &places)
    }

    /// Sequences for which some cell has the figure.
    pub(super) fn sequences_with(&self, figure: &Figure) -> Vec<usize> {
        let known = |sequence: &usize| {
            let cells = self.plan.cells.iter().enumerate();
            let mut own = cells.filter(|(_, cell)| cell.sequence == *sequence);
            own.any(|(place, _)| self.number(place, figure).is_some())
        };
        (0..self.plan.sequences.len()).filter(known).collect()
    }

    fn value(&self, numbers: Vec<Option<f64>>, places: &[usize]) -> Value {
        let planned = numbers.len();
        let known: Vec<f64> = numbers.into_iter().flatten().collect();
        if let Some((mean, spread)) = mean_and_spread(&known) {
            return Value::Measured(Measured { mean, spread, seeds: known.len(), planned });
        }
        let any = |test: &dyn Fn(usize) -> bool| places.iter().any(|&place| test(place));
        if any(&|place| self.failure(place).is_some()) {
            Value::Failed
        } else if any(&|place| matches!(self.outcomes[place], Outcome::NotRun)) {
            Value::NotRun
        } else {
            Value::Unknown
        }
    }
}

/// Mean and sample standard deviation (n - 1).
fn mean_and_spread(values: &[f64]) -> Option<(f64, Option<f64>)> {
    if values.is_empty() {
        return None;
    }
    let count = values.len() as f64;
    let mean = values.iter().sum::<f64>() / count;
    let square: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
    let spread = (values.len() > 1).then(|| (square / (count - 1.0)).sqrt());
    Some((mean, spread))
}

#[cfg(test)]
pub(super) mod tests {
    use super::super::figures::{ATE, PSNR};
    use super::super::plan::Wanted;
    use super::super::suite::{Origin, parse};
    use super::*;
    use std::path::PathBuf;

    /// Two sequences, two configurations, two seeds.
    pub(in super::super) fn plan() -> Plan {
        let text = "title = \"t <1>\"\nseeds = [0, 1]\n\
                    tables = [\"rendering\", \"tracking\", \"ablation\", \"runtime\", \"virtual-cameras\"]\n\
                    [[sequence]]\npath = \"a\"\ngroup = \"G\"\n[[sequence]]\npath = \"b\"\n\
                    [[configuration]]\nname = \"on\"\n\
                    [[configuration]]\nname = \"off | <x>\"\nflags = [\"--no-blur\"]\n";
        let suite = parse(text, "t").expect("a suite");
        let origin =
            Origin { suite, text: String::new(), name: "t".to_owned(), folder: PathBuf::new() };
        Plan::new(origin, &Wanted::default()).expect("a plan")
    }

    /// Cell (sequence, setting, seed) has an ATE of 1 + 10 sequence + 100 setting + seed [m]; the
    /// cells of `failed` failed.
    pub(in super::super) fn results<'a>(
        plan: &'a Plan,
        failed: &[(usize, usize, u64)],
    ) -> Results<'a> {
        let (mut outcomes, mut figures) = (Vec::new(), Vec::new());
        for cell in &plan.cells {
            if failed.contains(&(cell.sequence, cell.setting, cell.seed)) {
                outcomes.push(Outcome::Unstarted("no | room".to_owned()));
                figures.push(Figures::new());
                continue;
            }
            let ate =
                1.0 + 10.0 * cell.sequence as f64 + 100.0 * cell.setting as f64 + cell.seed as f64;
            outcomes.push(Outcome::Ended(record()));
            let seconds = ("seconds_per_frame".to_owned(), 0.5 + cell.setting as f64);
            figures.push([(ATE.key.to_owned(), ate), seconds].into());
        }
        Results { plan, outcomes, figures }
    }

    fn record() -> super::super::cell::Record {
        super::super::cell::Record {
            arguments: Vec::new(),
            settings: String::new(),
            list: None,
            judgement: None,
            build: "1".to_owned(),
            threads: 1,
            jobs: 1,
            seconds: 2.0,
            ran: true,
            failure: None,
        }
    }

    #[test]
    fn means_and_spreads_are_over_seeds() {
        let plan = plan();
        let all = results(&plan, &[]);
        let spread = Some(0.5_f64.sqrt());
        let due = |mean| Value::Measured(Measured { mean, spread, seeds: 2, planned: 2 });
        assert_eq!(all.of(1, 1, &ATE), due(111.5));
        assert_eq!(all.over_sequences(1, &ATE), due(106.5));
        assert_eq!(all.of(0, 0, &PSNR), Value::Unknown);
        assert_eq!(all.over_sequences(0, &PSNR), Value::Unknown);
    }

    #[test]
    fn a_lost_cell_makes_no_mean_better() {
        let plan = plan();
        let some = results(&plan, &[(1, 0, 0)]);
        let due = Measured { mean: 7.0, spread: None, seeds: 1, planned: 2 };
        assert_eq!(some.over_sequences(0, &ATE), Value::Measured(due), "seed 1 alone is complete");
        let one = Measured { mean: 12.0, spread: None, seeds: 1, planned: 2 };
        assert_eq!(some.of(1, 0, &ATE), Value::Measured(one));
        let both = results(&plan, &[(1, 0, 0), (1, 0, 1)]);
        assert_eq!(both.of(1, 0, &ATE), Value::Failed);
        assert_eq!(both.over_sequences(0, &ATE), Value::Failed);
        assert!(both.over_sequences(1, &ATE).measured().is_some());
    }
}

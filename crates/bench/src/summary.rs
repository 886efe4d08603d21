//! Means and standard deviations over seeds.

use crate::job::Record;
use crate::metrics::{Metric, Metrics};
use crate::plan::Plan;
use crate::queue::Outcome;

/// A plan with the outcomes and metrics of its jobs.
pub(crate) struct Results<'a> {
    pub(crate) plan: &'a Plan,
    /// In the order of [`Plan::jobs`].
    pub(crate) outcomes: Vec<Outcome>,
    /// In the order of [`Plan::jobs`]; empty for a job that is not finished.
    pub(crate) metrics: Vec<Metrics>,
}

/// One number of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Value {
    /// Mean over seeds.
    SeedMean(SeedMean),
    /// Not measurable, for want of ground truth.
    Unknown,
    /// No seed finished, and some failed.
    Failed,
    /// No seed finished or failed.
    NotRun,
}

/// A mean over seeds, in the unit of the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct SeedMean {
    pub(crate) mean: f64,
    /// Standard deviation of one seed, from two seeds on.
    pub(crate) spread: Option<f64>,
    /// Seeds that have the metric.
    pub(crate) seeds: usize,
    /// Seeds that should have it.
    pub(crate) planned: usize,
}

impl Value {
    pub(crate) fn measured(&self) -> Option<&SeedMean> {
        match self {
            Self::SeedMean(measured) => Some(measured),
            _ => None,
        }
    }
}

impl Results<'_> {
    /// Whether a job has metrics.
    pub(crate) fn finished(&self, place: usize) -> bool {
        matches!(&self.outcomes[place], Outcome::Ended(record) if record.failure.is_none())
    }

    /// The records of jobs that ended, well or not.
    pub(crate) fn records(&self) -> impl Iterator<Item = &Record> {
        self.outcomes.iter().filter_map(|outcome| match outcome {
            Outcome::Ended(record) => Some(record),
            _ => None,
        })
    }

    /// The reason of a failure.
    pub(crate) fn failure(&self, place: usize) -> Option<&str> {
        match &self.outcomes[place] {
            Outcome::Ended(record) => record.failure.as_deref(),
            Outcome::Unstarted(reason) => Some(reason),
            Outcome::NotRun => None,
        }
    }

    fn places(&self, sequence: usize, configuration: usize) -> impl Iterator<Item = usize> + '_ {
        let jobs = self.plan.jobs.iter().enumerate();
        jobs.filter(move |(_, job)| job.sequence == sequence && job.configuration == configuration)
            .map(|(place, _)| place)
    }

    fn number(&self, place: usize, metric: &Metric) -> Option<f64> {
        self.metrics[place].get(metric.key).copied()
    }

    /// A metric of one configuration on one sequence.
    pub(crate) fn of(&self, sequence: usize, configuration: usize, metric: &Metric) -> Value {
        let places: Vec<usize> = self.places(sequence, configuration).collect();
        let numbers = places.iter().map(|&place| self.number(place, metric)).collect();
        self.value(numbers, &places)
    }

    /// The mean over all sequences that have the metric. A seed counts only if all of them have it:
    /// a lost sequence must not improve a mean.
    pub(crate) fn over_sequences(&self, configuration: usize, metric: &Metric) -> Value {
        let sequences = self.sequences_with(metric);
        let by_sequence: Vec<Vec<usize>> =
            sequences.iter().map(|&s| self.places(s, configuration).collect()).collect();
        let seeds = self.plan.suite.seeds.len();
        let mean = |seed: usize| {
            let numbers = by_sequence.iter().map(|p| self.number(*p.get(seed)?, metric));
            let numbers: Option<Vec<f64>> = numbers.collect();
            numbers.filter(|n| !n.is_empty()).map(|n| n.iter().sum::<f64>() / n.len() as f64)
        };
        let places: Vec<usize> = by_sequence.iter().flatten().copied().collect();
        self.value((0..seeds).map(mean).collect(), &places)
    }

    /// Sequences for which some job has the metric.
    pub(crate) fn sequences_with(&self, metric: &Metric) -> Vec<usize> {
        let known = |sequence: &usize| {
            let jobs = self.plan.jobs.iter().enumerate();
            let mut own = jobs.filter(|(_, job)| job.sequence == *sequence);
            own.any(|(place, _)| self.number(place, metric).is_some())
        };
        (0..self.plan.sequences.len()).filter(known).collect()
    }

    fn value(&self, numbers: Vec<Option<f64>>, places: &[usize]) -> Value {
        let planned = numbers.len();
        let known: Vec<f64> = numbers.into_iter().flatten().collect();
        if let Some((mean, spread)) = mean_and_spread(&known) {
            return Value::SeedMean(SeedMean { mean, spread, seeds: known.len(), planned });
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
pub(crate) mod tests {
    use super::*;
    use crate::metrics::{ATE, PSNR};

    /// Two sequences, two configurations, two seeds.
    pub(crate) fn plan() -> Plan {
        let text = "title = \"t <1>\"\nseeds = [0, 1]\n\
                    tables = [\"rendering\", \"tracking\", \"ablation\", \"runtime\", \"virtual-cameras\"]\n\
                    [[sequence]]\npath = \"a\"\ngroup = \"G\"\n[[sequence]]\npath = \"b\"\n\
                    [[configuration]]\nname = \"on\"\n\
                    [[configuration]]\nname = \"off | <x>\"\nconfig.formation.blur = false\n";
        crate::plan::tests::plan(text).expect("a plan")
    }

    /// Job (sequence, configuration, seed) has an ATE of 1 + 10 sequence + 100 configuration + seed [m]; the
    /// jobs of `failed` failed.
    pub(crate) fn results<'a>(plan: &'a Plan, failed: &[(usize, usize, u64)]) -> Results<'a> {
        let record = Record {
            build: "1".to_owned(),
            threads: 1,
            parallel: 1,
            seconds: 2.0,
            reconstructed: true,
            ..Record::default()
        };
        let (mut outcomes, mut metrics) = (Vec::new(), Vec::new());
        for job in &plan.jobs {
            if failed.contains(&(job.sequence, job.configuration, job.seed)) {
                outcomes.push(Outcome::Unstarted("no | room".to_owned()));
                metrics.push(Metrics::new());
                continue;
            }
            let ate = 1.0
                + 10.0 * job.sequence as f64
                + 100.0 * job.configuration as f64
                + job.seed as f64;
            outcomes.push(Outcome::Ended(record.clone()));
            let seconds = ("seconds_per_frame".to_owned(), 0.5 + job.configuration as f64);
            metrics.push([(ATE.key.to_owned(), ate), seconds].into());
        }
        Results { plan, outcomes, metrics }
    }

    #[test]
    fn means_and_spreads_are_over_seeds() {
        let plan = plan();
        let all = results(&plan, &[]);
        let spread = Some(0.5_f64.sqrt());
        let due = |mean| Value::SeedMean(SeedMean { mean, spread, seeds: 2, planned: 2 });
        assert_eq!(all.of(1, 1, &ATE), due(111.5));
        assert_eq!(all.over_sequences(1, &ATE), due(106.5));
        assert_eq!(all.of(0, 0, &PSNR), Value::Unknown);
        assert_eq!(all.over_sequences(0, &PSNR), Value::Unknown);
    }

    #[test]
    fn a_lost_job_makes_no_mean_better() {
        let plan = plan();
        let some = results(&plan, &[(1, 0, 0)]);
        let due = SeedMean { mean: 7.0, spread: None, seeds: 1, planned: 2 };
        assert_eq!(some.over_sequences(0, &ATE), Value::SeedMean(due), "seed 1 alone is complete");
        let one = SeedMean { mean: 12.0, spread: None, seeds: 1, planned: 2 };
        assert_eq!(some.of(1, 0, &ATE), Value::SeedMean(one));
        let both = results(&plan, &[(1, 0, 0), (1, 0, 1)]);
        assert_eq!(both.of(1, 0, &ATE), Value::Failed);
        assert_eq!(both.over_sequences(0, &ATE), Value::Failed);
        assert!(both.over_sequences(1, &ATE).measured().is_some());
    }
}
